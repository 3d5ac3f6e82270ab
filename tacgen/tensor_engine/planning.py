"""Scenes before they are solved, and their division among processes. Without PyTorch, which takes seconds to import."""

import heapq
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from tacgen.geometry.exact_edges import SharpField
from tacgen.mechanics import mesh
from tacgen.mechanics.problem import points_along
from tacgen.mechanics.scene import Scene
from tacgen.tensor_engine import grids
from tacgen.tensor_engine.grids import GridPattern

MIN_PART_SCENES = 12  # scenes of a part: fewer take about as long, as their longest one does


class PoolKind(NamedTuple):
    """Contact points along a facet's side, terms of the longest Prony series, and whether gels have inertia."""

    points: int = 0
    prony_terms: int = 0
    inert: bool = False


def lacks(scene: Scene) -> str | None:
    """The first thing in a scene that the batch engine does not do, in words; None: it solves the scene."""
    wanted = {
        "a mesh of tets": scene.element != "hex",
        # it would solve them, at 3 frames a second on an H100 where six scenes are all there is: cores are faster
        "exact edges": isinstance(scene.shape, SharpField),
    }
    return next((what for what, is_so in wanted.items() if is_so), None)


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
        if (why := lacks(scene)) is not None:
            return cls(number, why=why)
        axes = grids.axes_of(scene)
        if (pattern := grids.smallest(axes)) is None:
            return cls(number, why="a contact larger than all patterns")
        return cls(number, scene, axes, pattern)

    @cached_property
    def kind(self) -> PoolKind:
        """Properties that scenes solved together have in common, beside their pattern."""
        if (scene := self.scene) is None:
            return PoolKind()
        return PoolKind(points_along(scene), scene.prony_terms, scene.dynamics is not None)


def pools(plans: Sequence[Planned], share: bool = True) -> dict[tuple[GridPattern, PoolKind], list[int]]:
    """Places in the list of the scenes that are solved together: by their pattern and kind. share: whether scenes of
    some patterns are put into a larger one."""
    out: dict[tuple[GridPattern, PoolKind], list[int]] = {}
    for kind in sorted({plan.kind for plan in plans if plan.pattern}):
        wanted = Counter(plan.pattern for plan in plans if plan.pattern and plan.kind == kind)
        found = grids.merged(wanted) if share else {pattern: pattern for pattern in wanted}
        for k, plan in enumerate(plans):
            if plan.pattern and plan.kind == kind:
                out.setdefault((found[plan.pattern], kind), []).append(k)
    return out


def divided(plans: Sequence[Planned], processes: int) -> list[list[int]]:
    """Places in the list of scenes in parts for so many processes that share a GPU, those that take longest first:
    scenes of a pool together, in several parts if they are many. Those without a pattern go with the last.

    Of all bounds on the time of a part, that is taken with which the last process ends soonest, each taking the
    longest part that is left as soon as it can (Graham 1969).
    """
    groups = [(pattern, group) for (pattern, _), group in pools(plans).items()]
    each = [_parts(pattern, group, processes) for pattern, group in groups]
    bounds = sorted({time for parts in each for time, _ in parts}, reverse=True)
    chosen = [[next((part for part in parts if part[0] <= bound), parts[-1]) for parts in each] for bound in bounds]
    best = min(chosen, key=lambda parts: _ends(parts, processes), default=[])
    out = [
        (time, group[k::count]) for (time, count), (_, group) in zip(best, groups, strict=True) for k in range(count)
    ]
    found = [group for _, group in sorted(out, key=lambda part: -part[0])] or [[]]
    found[-1] += [k for k, plan in enumerate(plans) if plan.pattern is None]
    return [part for part in found if part]


def _parts(pattern: GridPattern, group: Sequence[int], processes: int) -> list[tuple[float, int]]:
    """The time of a part and how many there are, for a pool in one and more parts, as many as there are processes or
    fewer, and of no fewer than MIN_PART_SCENES scenes."""
    most = min(processes, math.ceil(len(group) / MIN_PART_SCENES))
    return [(grids.time_of(pattern, len(group) / count), count) for count in range(1, most + 1)]


def _ends(parts: Sequence[tuple[float, int]], processes: int) -> float:
    """When the last process ends so many parts of some times, if each takes the longest that is left when it can."""
    free = [0.0] * processes
    for time, count in sorted(parts, reverse=True):
        for _ in range(count):
            heapq.heapreplace(free, free[0] + time)
    return max(free)
