"""The bulk: all forces except contact and friction, and their tangent."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from tacgen.fem.assembly import Pattern
from tacgen.fem.elasticity import Elastic, Point
from tacgen.fem.folding_barrier import FoldingBarrier, FoldingPoint
from tacgen.fem.projection import Projection
from tacgen.mechanics.condensation import Condensation
from tacgen.mechanics.linear_solvers import NotPositiveDefinite

if TYPE_CHECKING:
    from tacgen.fem.inertia import BodyStep

Array = np.ndarray


@dataclass(frozen=True)
class BulkPoint:
    """The bulk evaluated at x (n, 3)."""

    elastic: tuple[Elastic, ...]
    inertia: "BodyStep | None"
    x: Array
    points: tuple[Point, ...]
    folding: tuple[FoldingPoint, ...]

    @cached_property
    def energy(self) -> float:
        """[N mm]"""
        elastic, folding = sum(p.energy for p in self.points), sum(p.energy for p in self.folding)
        return elastic + folding + (self.inertia.value(self.x) if self.inertia else 0.0)

    @property
    def inertial_forces(self) -> Array:
        """Their gradient (n, 3) [N]."""
        return np.zeros_like(self.x) if self.inertia is None else np.asarray(self.inertia.gradient(self.x))

    def other_forces(self) -> Array:
        """Nodal forces (n, 3) [N] of all but elasticity."""
        out = self.inertial_forces
        for folding in self.folding:
            folding.add_forces(out)
        return out

    @cached_property
    def gradient(self) -> Array:
        """(n, 3) [N]"""
        out = self.other_forces()
        for part, point in zip(self.elastic, self.points, strict=True):
            out += part.forces(point, len(self.x))
        return out

    @property
    def J(self) -> tuple[Array, ...]:
        """At the integration points, law by law."""
        return tuple(p.J for p in self.points)

    @property
    def least_J(self) -> float:
        """Smallest J at the integration points."""
        return min(float(part.min()) for part in self.J)

    def stiffness(
        self, pattern: Pattern, projection: Projection = Projection.NONE, J: tuple[Array, ...] | None = None
    ) -> Array:
        """d2E/dx2, the entries of the pattern [N/mm]; with pressures at the predicted J if given."""
        data = np.zeros(len(pattern.indices))
        if self.inertia is not None:
            self.inertia.add_hessian(self.x, data, projection)
        for folding in self.folding:
            folding.add_tangent(data, projection)
        for k, (part, point) in enumerate(zip(self.elastic, self.points, strict=True)):
            part.add_tangent(point, data, projection, None if J is None else J[k])
        return data


@dataclass(frozen=True)
class Bulk:
    """Elasticity, the barrier against inversion, and inertia in a load step."""

    elastic: tuple[Elastic, ...]
    folding: tuple[FoldingBarrier, ...]
    inertia: "BodyStep | None" = None

    def at(self, x: Array) -> BulkPoint:
        points = tuple(part.evaluate(x) for part in self.elastic)
        folding = tuple(barrier.evaluate(x) for barrier in self.folding)
        return BulkPoint(self.elastic, self.inertia, x, points, folding)


class Tangent:
    """A factorised tangent of the bulk, condensed to the contact, with the deformation at which it was computed."""

    def __init__(self, pattern: Pattern, at_rest: Callable[[], Array]) -> None:
        self.condensation = Condensation(pattern, at_rest)
        self.taken: tuple[Array, ...] = ()  # F (e, q, 3, 3), law by law
        self.exact_at: Array | None = None  # the x (n, 3) whose exact tangent it is
        self.projected = 0  # number of tangents that were projected

    @property
    def usable(self) -> bool:
        return self.condensation.usable

    def take(self, at: BulkPoint, J: tuple[Array, ...] | None) -> None:
        """Factorise the exact tangent; if it is not positive definite, the projected one.

        Raises:
            NotPositiveDefinite: the projected one is not positive definite either.
        """
        for projection in Projection:
            try:
                self.condensation.factor(at.stiffness(self.condensation.whole, projection, J))
                break
            except NotPositiveDefinite:
                self.projected += 1
                if projection is Projection.FULL:
                    raise
        self.taken = tuple(point.F for point in at.points)
        self.exact_at = at.x if J is None and projection is Projection.NONE else None

    def unbalanced(self, at: BulkPoint, J: tuple[Array, ...]) -> Array:
        """Right-hand side (n, 3) [N] of a step with this tangent, with the pressure as an independent unknown."""
        out = at.other_forces()
        for part, point, j, taken in zip(at.elastic, at.points, J, self.taken, strict=True):
            out += part.mixed_forces(point, j, taken, len(at.x))
        return out

    def predicted(self, at: BulkPoint, there: BulkPoint) -> tuple[Array, ...]:
        """J (e, q) at `there`, for each law, as predicted by a step from `at` with this tangent."""
        each = zip(at.elastic, at.points, there.points, self.taken, strict=True)
        return tuple(part.predicted(a, b, taken) for part, a, b, taken in each)
