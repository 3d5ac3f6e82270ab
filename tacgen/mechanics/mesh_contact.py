"""A load step with contact between meshes (ipctk): Newton's method on the energy, friction's normal forces lagged.

The Toolkit's friction has an energy only with normal forces, directions and pairs that are frozen. They are renewed
from the answer until both agree (Li et al. 2020, "Incremental Potential Contact", section 5).
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, cast

import numpy as np

from tacgen.fem.potential import Potential, Total
from tacgen.geometry.pose import Pose
from tacgen.mechanics.admission import imbalance
from tacgen.mechanics.coupled import ContactForces, onset
from tacgen.mechanics.failures import Failure, NotConverged
from tacgen.mechanics.load_step import STIFFER
from tacgen.mechanics.newton import Solution, Status, minimise
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.solve_state import Found
from tacgen.mechanics.state import History

if TYPE_CHECKING:
    from tacgen.mechanics.ipctk import MeshContact, MeshFriction

Array = np.ndarray
OPPOSED = 0.8  # minus the cosine between two errors of lagged forces, above which the updates cancel each other [-]
TRIES = 4  # most solves, each with smaller tolerances


@dataclass(frozen=True)
class LaggedContact:
    """The contact as a frame records it, with the interface of CoupledContact."""

    contact: "MeshContact"
    friction: float
    anchor: Array
    eps: float
    lagged: "MeshFriction | None"

    def forces(self, x: Array) -> ContactForces:
        """Forces at nodes x (n, 3), without tangents."""
        N, normal, gap = self.contact.pressure(x)
        force, none = N[..., None] * normal, np.zeros((0, 0, 3, 3))
        if self.lagged is not None:
            force = force + self.lagged.force(x)
        return ContactForces(gap, self.contact.faces.at(x), normal, N, force, none, none)


class Lag:
    """Fixed-point iteration of lagged normal forces, with Anderson acceleration.

    If two updates in a row cancel each other, the mixture with the smallest error is used: Anderson (1965),
    "Iterative procedures for nonlinear integral equations", with a memory of one. Keeps the last positions
    x (n, 3), the forces there, and their difference from the lagged ones.
    """

    def __init__(self) -> None:
        self._last: tuple[Array, Array, Array] | None = None

    def next(self, x: Array, force: Array, lagged: Array) -> tuple[Array, Array]:
        """The next positions and forces to lag, if `lagged` led to x and `force`."""
        error, last = force - lagged, self._last
        self._last = x, force, error
        if last is None:
            return x, force
        before = last[2]
        size = float(np.linalg.norm(error) * np.linalg.norm(before))
        if float((error * before).sum()) >= -OPPOSED * size:
            return x, force
        change = error - before
        part = float(np.clip(-(before * change).sum() / (change * change).sum(), 0.0, 1.0))
        return last[0] + part * (x - last[0]), np.maximum(last[1] + part * (force - last[1]), 0.0)


class MeshLoadStep:
    """The contact and the bulk at one pose; what is lagged is the mean gap and, with friction, the normal forces."""

    def __init__(self, problem: Problem, history: History, pose: Pose, duration: float) -> None:
        self.problem, self.history, self.duration, self.prediction = problem, history, duration, None
        self.folding = problem.folding
        options, dhat = problem.options, problem.contact.dhat
        self.xtol, self.eps = options.step_tol * dhat, options.slip * dhat
        contact = cast("MeshContact", problem.contact)
        self.contact = replace(contact.moved(pose, history.offset), kappa=history.kappa)
        inert: tuple[Potential, ...] = ()
        ahead, self.gap_tol = 2 * history.x - history.before, self.xtol
        if problem.body is not None:
            assert history.velocity is not None
            inertia = problem.body.step(history.x, history.velocity, duration)
            inert, ahead, self.gap_tol = (inertia,), inertia.coasting, self.xtol / 10
        self.inert = Total(inert)
        self.elastic = problem.during(history, duration)
        self.bulk: tuple[Potential, ...] = (*self.elastic, *self.folding, *inert)
        self.lag = Lag()
        self.friction: MeshFriction | None = None
        self.anchor = pose.world(self._anchors())
        if problem.friction > 0:
            self.friction = self._lagged_friction(pose.world(history.pose.local(history.x)), history.normal_force)
        self.starts = self.contact.starts(history.x, ahead, history.pose)

    def _lagged_friction(self, x: Array, normal_force: Array) -> "MeshFriction":
        return self.contact.friction(self.problem.friction, x, normal_force, self.anchor, self.eps)

    def _anchors(self) -> Array:
        """Anchors in the indenter's frame; that of a new point is where it first touches if the gel stays."""
        history, contact = self.history, self.contact
        ahead, gap_ahead = contact.pose.local(contact.faces.at(history.x)), contact.gaps(history.x)[0]
        touch = onset(history.anchor, ahead, history.gap - contact.offset, gap_ahead - contact.offset)
        return np.where(history.normal_force[..., None] > 0, history.anchor, touch)

    @property
    def total(self) -> Total:
        friction: tuple[Potential, ...] = () if self.friction is None else (self.friction,)
        return Total((*self.bulk, self.contact, *friction))

    def start(self, near: Array | None) -> Array | None:
        """The start of lower energy; None: too far."""
        starts = [*self.starts]
        if near is not None:
            starts.append(self.contact.starts(self.history.x, near, self.history.pose)[1])
        x = min(starts, key=self.total.value)
        return x if np.isfinite(self.total.value(x)) else None

    def _renew(self, x: Array) -> Total | None:
        """Renew the lagged quantities from x, if they are off by more than the tolerances."""
        force = self.contact.pressure(x)[0]
        gap = self.contact.mean_gap(x)
        self.force = float(force.sum())
        scale, off = max(self.force, self.history.least_force), 0.0
        if self.friction is not None:
            error = np.abs(force - self.friction.normal_force)
            most = max(float(force.max()), self.history.least_force / len(force))
            off = max(float(error.sum()), float(error.max()) / most * scale / 2)
        if abs(gap - self.contact.offset) <= self.gap_tol and off <= self.problem.options.lag_tol * scale:
            return None
        if self.friction is not None:
            there, force = self.lag.next(x, force, self.friction.normal_force)
            self.friction = self._lagged_friction(there, force)
        self.contact = self.contact.grown(gap, x)
        return self.total

    def solve(self, x: Array) -> Found | NotConverged:
        """Solves with decreasing tolerances until forces balance: steps that are cut by collisions look converged."""
        steps, most = 0, self.problem.options.residual_max
        for _ in range(TRIES):
            minimum = self._minimum(x)
            x, more = minimum.x, len(minimum.steps)
            if minimum.status != Status.converged:
                return NotConverged(Failure.minimiser, status=minimum.status, steps=more)
            contact = LaggedContact(self.contact, self.problem.friction, self.anchor, self.eps, self.friction)
            solution = Found(x, contact, contact.forces(x), contact.contact.least(x), steps := steps + more)
            if max(imbalance(self, solution)) <= most:
                break
            self.xtol /= 30
        return solution

    def stiffened(self, solution: Found, contact: bool, folding: bool) -> "MeshLoadStep | None":
        """See LoadStep; against folding there is nothing stiffer."""
        if folding:
            return None
        self.contact = replace(self.contact, kappa=STIFFER * self.contact.kappa)
        return self

    def wrong(self, solution: Found) -> NotConverged | None:
        """None: the gel cannot be inside the indenter."""
        return None

    def _minimum(self, x: Array) -> Solution:
        problem, dhat = self.problem, self.problem.contact.dhat
        self.force = 0.0

        def negligible(g: Array) -> bool:
            force = max(self.force, self.history.least_force)
            return float(np.linalg.norm(g.ravel()[problem.pattern.free])) <= problem.options.residual_tol / 2 * force

        return minimise(
            self.total, x, problem.pattern, problem.linear, xtol=self.xtol, near=dhat, refresh=self._renew,
            negligible=negligible,
        )  # fmt: skip
