"""Loads the compiled loops, once a process: this takes as long as several frames."""

from functools import cache

import numpy as np

from tacgen.fem.materials import NeoHooke
from tacgen.geometry.analytic_sdf import SphereSdf
from tacgen.geometry.gel import GelBody, GelLayer
from tacgen.mechanics import mesh
from tacgen.mechanics.frames import states
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.scene import Scene


@cache
def warm() -> None:
    """Press and rub a ball on a gel of a few cells."""
    gel = GelBody(3.0, 3.0, layers=(GelLayer(1.0, NeoHooke(0.05, 1.0), 0.15),))
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, :3, 3] = [(0.0, 0.0, -0.1), (0.05, 0.0, -0.1)]
    start = np.eye(4)
    scene = Scene(gel, SphereSdf(1.5), poses, start, np.zeros(2, int), 0.5, 0.7, 0.05)
    for _ in states(scene, Problem.of(scene, mesh.build(gel, (-0.7, 0.7, -0.7, 0.7), 0.7))):
        pass
