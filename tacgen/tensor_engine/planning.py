"""Scenes before they are solved, and their division among processes. Without PyTorch, which takes seconds to import."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from tacgen.mechanics import mesh
from tacgen.mechanics.scene import Scene
from tacgen.tensor_engine import grids, scope
from tacgen.tensor_engine.grids import GridPattern

LEAST = 12  # scenes of a part: fewer take about as long, as their longest one does


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


def pools(plans: Sequence[Planned], share: bool = True) -> dict[tuple[GridPattern, bool], list[int]]:
    """Places in the list of the scenes that are solved together: by their pattern, and whether they are thin. share:
    whether scenes of some patterns are put into a larger one."""
    out: dict[tuple[GridPattern, bool], list[int]] = {}
    for thin in (False, True):
        wanted = Counter(plan.pattern for plan in plans if plan.pattern and plan.thin is thin)
        found = grids.merged(wanted) if share else {pattern: pattern for pattern in wanted}
        for k, plan in enumerate(plans):
            if plan.pattern and plan.thin is thin:
                out.setdefault((found[plan.pattern], thin), []).append(k)
    return out


def divided(plans: Sequence[Planned], parts: int) -> list[list[int]]:
    """Places in the list of scenes in parts for so many processes that share a GPU, those that take longest first:
    scenes of a pool together, in several parts if they are many. Those without a pattern go with the last."""
    each = [(grids.time_of(pattern, len(group)), group) for (pattern, _), group in pools(plans).items()]
    whole, out = sum(time for time, _ in each), list[tuple[float, list[int]]]()
    for time, group in each:
        # a part takes no longer than a process's share, unless it would have fewer than LEAST scenes
        count = min(math.ceil(parts * time / whole), math.ceil(len(group) / LEAST))
        out += [(time / count, group[k::count]) for k in range(count)]
    found = [group for _, group in sorted(out, key=lambda part: -part[0])] or [[]]
    found[-1] += [k for k, plan in enumerate(plans) if plan.pattern is None]
    return [part for part in found if part]
