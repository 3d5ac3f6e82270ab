"""From one pose to the next: which potentials are in the sum, and the gel at equilibrium under the indenter there.

What is lagged, the mean gap by which the indenter is shrunk and, with friction, the normal forces, is renewed on the
way until it agrees with the answer.
"""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from tacgen.fem import friction as fr
from tacgen.fem.assembly import Pattern
from tacgen.fem.condensed import MOST, STEPS, settle
from tacgen.fem.contact import Contact, Pose
from tacgen.fem.newton import Solution, Status, Step, minimise
from tacgen.fem.passage import blocked, sunk
from tacgen.fem.potentials import Potential, Total
from tacgen.fem.renewal import Renewal
from tacgen.step.carried import carried
from tacgen.step.problem import AnyContact, Memory, Problem

Array = np.ndarray
XTOL = 1 / 100  # of dhat: no node moves by more in the last step, nor does the mean gap between passes
NEAR = 1  # of dhat: longer steps use the projected stiffness
RESIDUAL = 1e-3  # of the contact force
LAG = 2e-4  # normal forces may be this far from the ones friction used, as a part of their sum
NEGLIGIBLE = 1e-3  # of the largest contact force so far
SUNK = 0.45  # of the indenter's reach: how deep matter may be inside it, between the points where contact acts
CRUSHED = 0.2  # of its volume: nine of ten random scenes that found no answer had gel folded to .14 of it and less
TRIES = 8  # at a pose, each with a smaller tolerance or a stiffer barrier than the last
STIFFER = 4
EPS = 1 / 8  # of dhat: slip over which friction builds up


class NotConverged(ArithmeticError):
    """A frame has no solution that meets the tolerances; the message says why."""


class TooFar(NotConverged):
    """A step in which the indenter might pass through the gel unseen."""


@dataclass(frozen=True)
class State:
    """The gel at one frame.

    x (n, 3) nodal positions [mm]; normal_force (f, q) [N] pressing on the gel's quadrature points, normal (f, q, 3)
    outward from the indenter, friction (f, q, 3) [N] on the gel or None without friction; sliding (f, q) bool.
    """

    index: int
    pose: Array
    x: Array
    normal_force: Array
    normal: Array
    friction: Array | None
    sliding: Array | None
    iterations: int
    substeps: int
    offset: float  # by which the indenter was shrunk [mm]
    mean_gap: float  # [mm], to the shrunk indenter; equal to offset within XTOL dhat
    min_gap: float  # [mm], to the shrunk indenter
    residual: float  # of the free nodes' forces, as a part of the contact force
    balance: float  # |indenter force + base reaction| / indenter force
    rounded: float = 0.0  # friction at points that one step brought round an edge, as a part of the contact force

    @property
    def traction_force(self) -> Array:
        """Force of the indenter on each quadrature point of the gel (f, q, 3) [N]."""
        push = self.normal_force[..., None] * self.normal
        return np.asarray(push if self.friction is None else push + self.friction)


class _Lagged:
    """The potentials at one pose, with what is lagged in them: the mean gap and, with friction, the normal forces.

    Newton asks `refresh` on its way to the answer and ends only when both agree with it.
    """

    def __init__(
        self, problem: Problem, memory: Memory, pose: Pose, duration: float, near: State | None = None
    ) -> None:
        self.problem, self.memory, self.duration = problem, memory, duration
        self.xtol, self.near, self.eps = (part * problem.contact.dhat for part in (XTOL, NEAR, EPS))
        if isinstance(problem.contact, Contact):  # between meshes collisions cut steps far shorter than they were meant
            for part in problem.elastic:
                part.hold(memory.x)
        offset = memory.offset if near is None else max(memory.offset, near.offset)
        self.contact: AnyContact = replace(problem.contact.moved(pose, offset), kappa=memory.kappa)
        self.contact_force = 0.0
        self.renewal = Renewal()
        self.friction, self.carried = None, None
        if problem.friction > 0:  # lagged from the last pose, turned with the indenter
            normal, anchor = memory.normal @ pose.rotation.T, pose.world(memory.anchor)
            x = pose.world(memory.pose.local(memory.x))
            self.friction = self.contact.friction(problem.friction, x, memory.normal_force, normal, anchor, self.eps)
            if isinstance(problem.contact, Contact):  # between sharp meshes no way is found from there
                self.carried = carried(problem, memory, pose)
        ahead, self.inertia, self.near_enough = 2 * memory.x - memory.before, None, self.xtol
        if problem.body is not None:
            assert memory.velocity is not None
            self.inertia = problem.body.step(memory.x, memory.velocity, duration)
            ahead, self.near_enough = self.inertia.coasting, self.xtol / 10  # else the indenter is felt to tremble
        self.starts = self.contact.starts(memory.x, ahead, memory.pose)

    def start(self, near: State | None) -> Array:
        """Where Newton starts: that one of lowest energy to which the indenter lets the gel come."""
        memory, contact = self.memory, self.contact
        starts = list(self.starts)
        starts += [contact.starts(memory.x, other.x, memory.pose)[1] for other in (self.carried, near) if other]
        if isinstance(contact, Contact):  # between meshes, collisions are detected on the way
            starts = [x for x in starts if not blocked(contact, memory.pose, memory.x, memory.gap, x)]
        if not starts:
            raise TooFar("the indenter would pass through the gel")
        x = min(starts, key=self.total.value)
        if not np.isfinite(self.total.value(x)):
            raise TooFar("the gel cannot follow the indenter that far at once")
        return x

    @property
    def loads(self) -> tuple[Potential, ...]:
        return (self.contact,) if self.friction is None else (self.contact, self.friction)

    @property
    def inert(self) -> tuple[Potential, ...]:
        return () if self.inertia is None else (self.inertia,)

    @property
    def total(self) -> Total:
        return Total((*self.problem.elastic, *self.loads, *self.inert))

    def refresh(self, x: Array, loose: float = 1.0) -> Total | None:
        """Take gap and normal forces from x if they are off by more than `loose` times the tolerances."""
        force, normal, _ = self.contact.pressure(x)
        gap = self.contact.mean_gap(x)
        self.contact_force = float(force.sum())
        scale = max(self.contact_force, self.memory.scale)
        lag = 0.0
        if self.friction is not None:  # in sum, and half as strictly at every point, since Coulomb's law holds at each
            off = np.abs(force - self.friction.normal_force)
            most = max(float(force.max()), self.memory.scale / len(force))  # after a release no point bears anything
            lag = max(float(off.sum()), float(off.max()) / most * scale / 2)
        if abs(gap - self.contact.offset) <= loose * self.near_enough and lag <= loose * LAG * scale:
            return None
        if self.friction is not None:
            anchor = self.contact.pose.world(self._anchors())
            meshes = not isinstance(self.contact, Contact)  # which, where positions are carried on, might meet
            there, force = self.renewal.next(x, force, self.friction.normal_force, between=meshes)
            self.friction = self.contact.friction(self.problem.friction, there, force, normal, anchor, self.eps)
        self.contact = self.contact.grown(gap, x)
        return self.total

    def lower(self, x: Array, xtol: float, expect: float) -> Solution:
        """Newton's method from x; `expect`: how far that may be from the answer [mm]."""
        problem, condensed = self.problem, self.problem.condensed
        bulk, steps = Total((*problem.elastic, *self.inert)), list[Step]()
        while condensed is not None and len(steps) < 4 * STEPS and isinstance(self.contact, Contact):
            if not (touching := self._touching(x)).any():
                break
            conn = self.contact.faces.conn
            if (touching & ~condensed.nodes[conn].all(1)).any():
                facets = conn[np.isin(conn, conn[touching]).any(1)]  # and those around
                if 3 * len(np.unique(facets)) > MOST:
                    break
                condensed.cover(facets)
            which = np.flatnonzero(condensed.nodes[conn].all(1))
            part = self._on(self.contact, which, condensed.pattern)
            found = settle(
                bulk, part._felt, x, condensed, xtol=xtol, near=self.near, refresh=part.refresh,
                negligible=part.negligible,
            )  # fmt: skip
            self._take(part, which, found.x)
            x, steps = found.x, [*steps, *found.steps]
            if found.status != Status.converged:
                break
            if not np.delete(self._touching(x), which).any():
                return replace(found, steps=tuple(steps))
        found = minimise(
            self.total, x, problem.pattern, problem.linear, xtol=xtol, expect=expect, near=self.near,
            refresh=self.refresh, negligible=self.negligible,
        )  # fmt: skip
        return replace(found, steps=(*steps, *found.steps))

    def _touching(self, x: Array) -> Array:
        """Which facets the indenter acts on; if none, where it acted last."""
        now = (self.contact.gaps(x)[0] < self.contact.dhat).any(1)
        return np.asarray(now if now.any() else (self.memory.normal_force > 0).any(1))

    def _felt(self) -> Total:
        return Total(self.loads)

    def _on(self, contact: Contact, which: Array, pattern: Pattern) -> "_Lagged":
        """The same on some facets (k,) alone, with the entries of another pattern."""
        part, memory, faces = copy(self), self.memory, contact.faces.only(which, pattern)
        part.renewal = Renewal()
        part.contact = replace(contact, faces=faces)
        names = ("normal_force", "normal", "anchor")
        kept = {name: getattr(memory, name)[which] for name in (*names, "gap")}
        part.memory = replace(memory, **kept)
        if self.friction is not None:
            kept = {name: getattr(self.friction, name)[which] for name in names}
            part.friction = replace(self.friction, faces=faces, **kept)
        return part

    def _take(self, part: "_Lagged", which: Array, x: Array) -> None:
        """Take over what is lagged from `part`, beside whose facets nothing touches."""
        self.contact = replace(self.contact, offset=part.contact.offset)
        self.contact_force = part.contact_force
        self.renewal = Renewal()
        if self.friction is not None and part.friction is not None:
            force, normal, _ = self.contact.pressure(x)
            force, normal, anchor = np.zeros_like(force), normal.copy(), self.contact.faces.at(x)
            new = part.friction
            force[which], normal[which], anchor[which] = new.normal_force, new.normal, new.anchor
            self.friction = replace(self.friction, normal_force=force, normal=normal, anchor=anchor)

    def stiffened(self, x: Array) -> bool:
        """Whether a point of the gel is inside the shrunk indenter, so that the barrier was made stiffer."""
        inside = self.contact.least(x) <= 0
        if inside:
            self.contact = replace(self.contact, kappa=STIFFER * self.contact.kappa)
        return inside

    def negligible(self, g: Array) -> bool:
        """Whether a gradient (n, 3) is a tenth of what a frame may leave unbalanced."""
        force = max(self.contact_force, self.memory.scale)
        return float(np.linalg.norm(g.ravel()[self.problem.pattern.free])) <= RESIDUAL / 10 * force

    def _anchors(self) -> Array:
        """Anchors in the indenter's frame; a new point gets one where it will touch, as the gel is carried."""
        memory, contact = self.memory, self.contact
        x = memory.x if self.carried is None else self.carried.x
        ahead, gap_ahead = contact.pose.local(contact.faces.at(x)), contact.gaps(x)[0]
        touch = fr.onset(memory.anchor, ahead, memory.gap - contact.offset, gap_ahead - contact.offset)
        return np.where(memory.normal_force[..., None] > 0, memory.anchor, touch)

    def imbalance(self, x: Array) -> tuple[float, float]:
        """Residual on the free dofs and |indenter + inertia + base|, as parts of the contact force."""
        inner, outer = Total(self.problem.elastic).gradient(x), Total(self.loads).gradient(x)
        inert = Total(self.inert).gradient(x)
        held = np.ones(x.size, bool)
        held[self.problem.pattern.free] = False
        reaction = np.where(held.reshape(x.shape), inner, 0.0).sum(0)
        residual = float(np.linalg.norm((inner + outer + inert).ravel()[~held]))
        force = max(float(np.linalg.norm(outer.sum(0))), self.memory.scale)
        out = float(np.linalg.norm((outer + inert).sum(0) - reaction))
        return residual / force, out / force


def advance(
    problem: Problem, memory: Memory, matrix: Array, index: int, duration: float = 0.0, near: State | None = None
) -> tuple[Memory, State]:
    """One pose on, from the last positions or those carried on by the last increment: the ones of lower energy.

    `duration` [s] is what it takes, where inertia matters.

    `near` is another answer to the same memory, at a pose close by: Newton starts there, and inherits nothing of it.
    """
    lagged = _Lagged(problem, memory, Pose.of(matrix), duration, near)
    x, expect, iterations, xtol = lagged.start(near), np.inf, 0, lagged.xtol
    for _ in range(TRIES):
        found = lagged.lower(x, xtol, expect)
        x, expect, iterations = found.x, lagged.xtol, iterations + len(found.steps)
        if found.status != Status.converged:
            raise NotConverged(
                f"Newton {found.status} after {iterations} iterations{_crushed(problem, x)}: less depth or friction or"
                " a finer mesh may help"
            )
        residual, balance = lagged.imbalance(x)
        if residual > RESIDUAL or balance > RESIDUAL:
            xtol /= 30
        elif not lagged.stiffened(x):
            if isinstance(lagged.contact, Contact):
                _check_sunk(problem, lagged.contact, x)
            return _record(lagged, x, index, matrix, iterations, residual, balance)
    least = lagged.contact.least(x)
    raise NotConverged(
        f"after {iterations} iterations residual {residual:.1e} and balance {balance:.1e} of the contact force,"
        f" smallest gap {least:.1e} mm"
    )


def _crushed(problem: Problem, x: Array) -> str:
    """What there is to say of a gel squeezed as none can be: all that is known of why no answer was found."""
    least = min(float(part.at(x).J.min()) for part in problem.elastic)
    return f" with gel squeezed to {least:.1%} of its volume" if least < CRUSHED else ""


def _check_sunk(problem: Problem, contact: Contact, x: Array) -> None:
    reach = contact.shape.reach
    if (deep := sunk(contact, problem.elastic, x)) > SUNK * reach:
        raise NotConverged(
            f"the indenter, {2 * reach:.3g} mm thin, slips {deep:.3g} mm into the gel between the points of a mesh of"
            f" edge {problem.edge:g} mm: a finer one or less depth is needed"
        )


def _record(
    lagged: _Lagged, x: Array, index: int, matrix: Array, iterations: int, residual: float, balance: float
) -> tuple[Memory, State]:
    contact, friction, memory = lagged.contact, lagged.friction, lagged.memory
    force, normal, gap = contact.pressure(x)
    rub = sliding = None
    anchor = memory.anchor
    if friction is not None:
        rub, at = friction.force(x), contact.faces.at(x)
        sliding = (np.linalg.norm(friction.slip(x), axis=-1) >= friction.eps) & (friction.normal_force > 0)
        anchor = fr.dragged(friction.anchor, at, friction.normal, friction.normal_force, friction.eps, contact.pose)
    scale = max(memory.scale, NEGLIGIBLE * float(force.sum()))
    after = Memory(
        contact.pose,
        x,
        memory.x,
        contact.offset,
        force,
        normal @ contact.pose.rotation,
        anchor,
        gap,
        contact.kappa,
        scale,
        None if memory.velocity is None else (x - memory.x) / lagged.duration,
        None if lagged.carried is None else lagged.carried.missed(x),
    )
    mean, least = contact.mean_gap(x), contact.least(x)
    return after, State(
        index, matrix, x, force, normal, rub, sliding, iterations, 1, contact.offset, mean, least, residual, balance
    )
