"""Scenes before they are solved, and their division among processes. Without PyTorch, which takes seconds to import."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from tacgen.mechanics import mesh
from tacgen.mechanics.scene import Scene
from tacgen.tensor_engine import grids, scope
from tacgen.tensor_engine.grids import GridPattern

LEAST_SHARED = 64  # scenes of a pattern below which it is merged with others: smaller batches do not fill a GPU


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
    """Numbers of scenes in parts for so many processes that share a GPU, those that take longest first: scenes that
    share a pattern together, in several parts if they are many. Those without a pattern go with the last."""
    shared, groups = grids.merged(Counter(filter(None, patterns)), LEAST_SHARED), dict[GridPattern | None, list[int]]()
    for number, pattern in enumerate(patterns):
        groups.setdefault(pattern and shared[pattern], []).append(number)
    others = groups.pop(None, [])
    each = [(pattern.size**2 * len(group), group) for pattern, group in groups.items() if pattern]  # time, about
    whole, out = sum(time for time, _ in each), list[tuple[float, list[int]]]()
    for time, group in each:
        count = max(1, min(round(parts * time / whole), len(group)))
        out += [(time / count, group[k::count]) for k in range(count)]
    found = [group for _, group in sorted(out, key=lambda part: -part[0])] or [[]]
    found[-1] += others
    return [part for part in found if part]
