"""Blocks on a graded grid with planes of symmetry, for answers that are known of a half space or a bonded layer."""

from dataclasses import replace

import numpy as np

from helpers.presses import Run
from helpers.small import hexes
from tacgen import mechanics
from tacgen.mechanics.mesh import GelMesh, graded
from tacgen.mechanics.scene import Scene

Array = np.ndarray


def block(x: Array, y: Array, z: Array) -> GelMesh:
    """Hexes on a tensor grid, z upwards and ending at 0."""
    points, cells = hexes(x, y, z)
    layers = cells.reshape(-1, len(z) - 1, 8)
    facets = {"bonded": layers[:, 0][:, [0, 3, 2, 1]], "coated": layers[:, -1][:, [4, 5, 6, 7]]}
    return GelMesh(points, cells, np.zeros(len(cells), np.int32), facets)


def ticks(fine: float, end: float, edge: float, both: bool = False, growth: float = 1.6) -> Array:
    """Coordinates from 0, or from -end if `both`, to end: `edge` apart up to `fine`, and growing."""
    return graded(-end if both else 0.0, end, (-fine if both else 0.0, fine), edge, growth, end)


def run(made: Scene, grid: GelMesh, mirrors: tuple[int, ...] = ()) -> Run:
    """All frames, the normal displacement held at 0 on the plane x = 0 (0 in `mirrors`) and y = 0 (1)."""
    held = np.zeros(grid.points.shape, bool)
    held[np.unique(grid.facets["bonded"])] = True
    for axis in mirrors:
        held[grid.points[:, axis] < 1e-9, axis] = True
    problem = mechanics.Problem.of(made, grid, held=held)
    return Run(made, problem, list(mechanics.states(made, problem)))


def rounded(grid: GelMesh, radius: float) -> GelMesh:
    """The grid with its square rings about z bent to circles, fully from `radius` on: a round rim lies on its lines."""
    points = grid.points.copy()
    square, round_ = np.abs(points[:, :2]).max(1), np.hypot(points[:, 0], points[:, 1])
    bent = square / np.maximum(round_, 1e-12)
    part = np.minimum(square / radius, 1.0)
    points[:, :2] *= (1 + part * (bent - 1))[:, None]
    return replace(grid, points=points)
