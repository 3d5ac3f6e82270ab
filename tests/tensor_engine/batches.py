"""Batches of small scenes, and the CPU engine's answer to the same scenes."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from helpers.presses import gel, poses, scene

from tacgen.geometry.analytic_sdf import Shape
from tacgen.geometry.pose import about
from tacgen.mechanics import DEFAULT_OPTIONS, Problem, SolverOptions, mesh, states
from tacgen.mechanics.phases import FINAL_PHASES, Phase
from tacgen.mechanics.scene import Scene
from tacgen.tensor_engine import engine, grids
from tacgen.tensor_engine.elements import Topology
from tacgen.tensor_engine.engine import ManyScenes, Solved
from tacgen.tensor_engine.grids import GridPattern, Place
from tensor_engine.dense import Dense

Array = np.ndarray
EDGE = 1.0
Change = Callable[[Any], Any]


def small(shape: Shape, path: Array, friction: float = 0.0, E: float = 0.15) -> Scene:
    """A pad of 6 x 6 x 2 mm; E [MPa]."""
    return scene(shape, path, pad=gel(6, 6, 2.0, E=E), friction=friction, edge=EDGE)


def path(*positions: tuple[float, float, float], turns: Sequence[tuple[float, float, float]] = ()) -> Array:
    """Poses at positions [mm], each turned further by a rotation vector [rad]."""
    out, R = poses(list(positions)), np.eye(3)
    for k, turn in enumerate(turns):
        R = about(np.array(turn), 1.0) @ R
        out[k, :3, :3] = R
    return out


def problem(made: Scene, options: SolverOptions = DEFAULT_OPTIONS) -> Problem:
    """All have 6 x 6 cells, of which 3 x 3 or 4 x 4 are fine."""
    return Problem.of(made, mesh.build(made.gel, (-1.5, 1.5, -1.5, 1.5), EDGE), options)


def embedded(made: Scene, pattern: GridPattern | None = None) -> tuple[GridPattern, Place]:
    """The scene's mesh in this pattern, or in the smallest."""
    axes = grids.axes_of(made)
    held = pattern or grids.smallest(axes)
    assert held is not None
    return held, grids.placed(axes, made, held)


def batch(scenes: Sequence[Scene], options: SolverOptions = DEFAULT_OPTIONS) -> ManyScenes:
    """Scenes on equal grids, with dense factors."""
    problems = [problem(made, options) for made in scenes]
    grid = problems[0].mesh
    n, facets = len(grid.points), grid.facets["coated"]
    topology = Topology.shared(grid.cells, facets, n)
    free = torch.ones(n, dtype=torch.bool)
    free[np.unique(grid.facets["bonded"])] = False
    numbers = np.arange(n), np.arange(len(grid.cells)), np.arange(len(facets))
    places = [Place(*numbers, one.mesh.points) for one in problems]
    return ManyScenes.of(problems, places, topology, Dense(topology.conn, free), np.unique(facets))


def solve(b: ManyScenes, scenes: Sequence[Scene]) -> list[Solved]:
    """The frames of all scenes, in each slot one. The kernel for which most scenes wait is called next."""
    paths = [engine.frames(b, row, one) for row, one in enumerate(scenes)]
    going = {row for row, frames in enumerate(paths) if next(frames, None) is not None}
    while going:
        waiting: dict[Phase, list[int]] = {}
        for row in sorted(going):
            waiting.setdefault(b.courses[row].phase, []).append(row)
        phase, rows = max(waiting.items(), key=lambda each: len(each[1]))
        engine.advance(b, phase, rows)
        for row in rows:
            if b.courses[row].phase in FINAL_PHASES and next(paths[row], None) is None:
                going.discard(row)
    return [Solved(scene.states, scene.why) for scene in b.scenes]


def alone(made: Scene, options: SolverOptions = DEFAULT_OPTIONS) -> list[Any]:
    """The states of the CPU engine."""
    return list(states(made, problem(made, options)))
