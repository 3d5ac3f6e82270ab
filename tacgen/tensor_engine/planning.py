"""Scenes before they are solved, and their division among processes. Without PyTorch, which takes seconds to import."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacgen.mechanics import mesh
from tacgen.mechanics.scene import Scene
from tacgen.tensor_engine import grids, scope
from tacgen.tensor_engine.grids import GridPattern


@dataclass(frozen=True)
class Planned:
    """A scene's number; the scene, the grid of its mesh and the pattern for it, or why the engine does not solve it."""

    number: int
    scene: Scene | None = None
    axes: mesh.Axes | None = None
    pattern: GridPattern | None = None
    why: str = ""

    @classmethod
    def of(cls, numbered: tuple[int, Scene]) -> "Planned":
        """With the smallest pattern."""
        number, scene = numbered
        if (why := scope.lacks(scene)) is not None:
            return cls(number, why=why)
        axes = grids.axes_of(scene)
        if (pattern := grids.smallest(axes)) is None:
            return cls(number, why="a contact larger than all patterns")
        return cls(number, scene, axes, pattern)

    @property
    def thin(self) -> bool:
        """Whether facets have more contact points; see problem.POINTS_IF_THIN."""
        return self.scene is not None and 2 * self.scene.shape.reach < self.scene.edge


def divided(patterns: Sequence[GridPattern | None], parts: int) -> list[list[int]]:
    """Numbers of scenes in at most so many parts that take about equally long, for processes that share a GPU: scenes
    of one pattern together, those of large ones first and those without one last."""

    def key(number: int) -> tuple[bool, int, tuple[int, ...]]:
        pattern = patterns[number]
        return (True, 0, ()) if pattern is None else (False, -pattern.size, pattern.cells)

    order = sorted(range(len(patterns)), key=key)
    nodes = np.array([0.0 if (pattern := patterns[k]) is None else pattern.size for k in order])
    times = nodes + nodes.mean() + 1 if order else nodes  # about half of a frame's time is that of launches
    part = ((np.cumsum(times) - times / 2) / times.sum() * parts).astype(int)
    return [some for n in range(parts) if (some := [k for k, m in zip(order, part, strict=True) if m == n])]
