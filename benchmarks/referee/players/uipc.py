"""libuipc: the pad as tetrahedra of its implicit FEM, an affine body led along the path by SoftTransformConstraint, and
incremental potential contact, as in its examples, in metres, on a CUDA GPU. Forces are gradients of contact's energy at
the pad's points, over the squared step by which it multiplies energies: in motion after a slide or turn, since friction
is smoothed over speeds and creeps to 0 at rest."""

import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.referee.case import Array, Case
from benchmarks.referee.player import Answer, NotPlayed
from benchmarks.referee.players.uipc_parts import metres
from benchmarks.referee.players.uipc_scene import STEP_S, scene_of
from benchmarks.referee.playing import OnCuda, Settings, answer, steps

OWN = {"d_hat_mm": 0.1, "velocity_tol": 5e-4, "eps_velocity": 1e-4, "resistance": 1e9, "semi_implicit": 1}  # libuipc's
# defaults, lengths and speeds [m/s] over 100, which are for scenes of metres; TacEx, too, gives its gels .1 mm
DEFAULT = OWN | {"young_factor": 1.0, "cell_mm": 1.0}
EXACT = DEFAULT | {"velocity_tol": 1e-5, "eps_velocity": 1e-5, "semi_implicit": 0}
LOW, HIGH = (0.3, -2.0, 6.0), (1.3, -0.3, 10.0)  # of the search
MOVING, RESTING = 10, 10  # steps from frame to frame, and at rest in it
KINDS = ("PP", "PE", "PT", "EE")  # of contact, each with a normal part and one of friction


def settings_at(x: Sequence[float]) -> dict[str, Any]:
    """Settings of a point of the search: factor of E, log of d_hat [mm], log of contact's resistance [Pa]."""
    return EXACT | {"young_factor": x[0], "d_hat_mm": 10 ** x[1], "resistance": 10 ** x[2]}


def run(case: Case, how: Settings) -> Answer:
    """Play with a factor of E, cells, and libuipc's settings of contact and of tolerances."""
    if case.mass_kg:
        raise NotPlayed("a free body between two soft pads was not set up")
    from uipc import Logger, core

    Logger.set_level(Logger.Level.Critical)
    path = list(steps(case, MOVING, RESTING, creeping=True))
    aim, found, start = metres(path[0][0]), [], 0.0
    with tempfile.TemporaryDirectory() as folder:
        engine = core.Engine("cuda", folder)  # which the world does not hold
        world = core.World(engine)
        scene, pad = scene_of(case, how, aim)
        world.init(scene)
        contact = world.features().find(core.ContactSystemFeature)
        for _, pose, judged in path:
            aim[:] = metres(pose)
            world.advance()
            world.retrieve()
            if not world.is_valid():
                raise NotPlayed("its world is not valid")
            start = start or time.perf_counter()  # after what is set up in the first step
            if judged:
                found.append(on_pad(contact, pad.geometry()))
    return replace(answer(found, (time.perf_counter() - start) / len(case.poses), how), on_gpu=True)


def on_pad(contact: Any, pad: Any) -> tuple[Array, Array]:
    """Points (n, 3) [mm] of the pad and forces (n, 3) [N] of contact there."""
    from uipc import builtin, geometry

    points = 1000 * pad.positions().view().reshape(-1, 3)
    forces, first = np.zeros_like(points), int(pad.meta().find(builtin.global_vertex_offset).view().ravel()[0])
    for kind in (f"{kind}+{part}" for kind in KINDS for part in "NF"):
        seen = geometry.Geometry()
        contact.contact_gradient(kind, seen)
        if (at := seen.instances().find("i")) is not None:
            index = at.view().ravel() - first
            part = seen.instances().find("grad").view().reshape(-1, 3)
            mine = (index >= 0) & (index < len(points))  # others are the shape's
            np.add.at(forces, index[mine], -part[mine] / STEP_S**2)
    return points, forces


# The best of 24 trials of the presses, at EXACT: mean error from 150 % to 12 %. Tuned cases are played as usual.
TUNED = DEFAULT | {"young_factor": 0.445, "d_hat_mm": 0.0403, "resistance": 2.77e6}
PLAYERS = (OnCuda("libuipc", ("uipc",), ("pyuipc",), {"default": DEFAULT, "tuned": TUNED}, run),)
