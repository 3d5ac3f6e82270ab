"""Sensitivity of the equilibria along a path to parameters: direct differentiation, no second solve.

    R(x, o, a; p) = 0    forces on the free dofs,        K dx + R_o do + R_a da + R_p dp = 0
    o = m(x, o; p)       mean gap, the shrunk offset,    do = m_x dx + m_o do + m_p dp
    a = r(x, a'; p)      anchors of friction,            from the last load step's a'

Friction makes a frame depend on all before it: Michaleris, Tortorelli & Vidal (1994), "Tangent operators and design
sensitivity formulations for transient non-linear coupled problems".
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from tacgen.fem.materials import Law
from tacgen.mechanics.barrier import Faces
from tacgen.mechanics.bulk import Bulk
from tacgen.mechanics.contact_slopes import ContactSlopes, dot
from tacgen.mechanics.coupled import CoupledContact
from tacgen.mechanics.exact_tangent import everywhere, free_columns, solver
from tacgen.mechanics.linear_solvers import NotPositiveDefinite
from tacgen.mechanics.measures import onset
from tacgen.mechanics.one_scene import with_neighbours
from tacgen.mechanics.predictor import STICKING_SPRING_STIFFNESS, tied
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.state import History, State

Array = np.ndarray
PARAMETER_DIFFERENCE = 1e-3  # difference of a parameter over its scale, for derivatives of the laws' forces [-]
POSITION_DIFFERENCE = 1e-5  # largest difference of positions over the edge, for derivatives of forces [-]


@dataclass(frozen=True)
class Parameter:
    """A parameter p: the layers' laws at p, or the change of friction or of the depth of all poses [mm] per unit of p;
    `scale`: changes of p are small compared with it."""

    scale: float
    laws: Callable[[float], tuple[Law, ...]] | None = None
    friction: float = 0.0
    depth: float = 0.0


@dataclass(frozen=True)
class Slopes:
    """Derivatives by k parameters at the end of a load step.

    Of normal forces (k, f, q) and normals (k, f, q, 3) at the contact's points and forces there on the gel (k, f, q, 3)
    [N]; of anchors (k, f, q, 3) in the indenter's frame; of positions x (k, n, 3) and of the predictor's error in
    them.
    """

    normal_force: Array
    normal: Array
    force: Array
    anchor: Array
    x: Array
    predictor_error: Array


class Sensitivity:
    """Derivatives at the frames of one scene, which is differentiable, in order."""

    def __init__(self, problem: Problem, parameters: Sequence[Parameter]) -> None:
        self._problem, self._contact, self._parameters = problem, problem.contact, tuple(parameters)
        self._lower = -np.array([p.depth for p in parameters])[:, None] * np.eye(3)[2]  # of the pose (k, 3)
        assert problem.differentiable
        self._tangent = problem.new_tangent()
        self._before = problem.rest(problem.contact.pose)
        self._slopes = self._without_contact(self._before)

    def frame(self, state: State) -> Slopes:
        """Derivatives at the next frame; called in their order.

        Raises NotConverged: the tangent is singular, as where the gel snaps.
        """
        assert state.after is not None
        for after in (*state.passed, state.after):
            on = np.flatnonzero((after.normal_force > 0).any(1))
            self._slopes = self._in_contact(after, on) if on.size else self._without_contact(after)
            self._before = after
        return self._slopes

    def _take(self, at: History, on: Array) -> None:
        """Factorise the exact tangent at an equilibrium with the facets `on` in contact."""
        tangent, conn = self._tangent, self._contact.faces.conn
        if not self._problem.condensed:
            return
        if not tangent.condensation.covers(conn[on]):
            tangent.condensation.cover(with_neighbours(conn, np.asarray((at.normal_force > 0).any(1))))
        with suppress(NotPositiveDefinite):
            tangent.take(Bulk(self._problem.elastic, self._problem.folding).at(at.x), None)

    def _without_contact(self, at: History) -> Slopes:
        k = len(self._parameters)
        none, still = np.zeros((k, *at.gap.shape, 3)), np.zeros((k, *at.x.shape))
        return Slopes(none[..., 0], none, none, self._local(none, at), *(still,) * 2)

    def _relative(self, motion: Array) -> Array:
        """Motions (k, f, q, 3) relative to the indenter."""
        return np.asarray(motion - self._lower[:, None, None])

    def _local(self, motion: Array, at: History) -> Array:
        return np.asarray(self._relative(motion) @ at.pose.rotation)

    def _in_contact(self, after: History, on: Array) -> Slopes:
        """With facets `on` in contact."""
        was, faces, nodes = self._slopes, self._contact.faces.only(on), len(after.x)
        first_order = was.x
        if after.predicted is not None and self._problem.friction:
            first_order = was.x + self._predictor_slopes(after)
        self._take(after, on)
        trial, anchors = self._trial_anchors(after, on, first_order + self._extrapolated(after) * was.predictor_error)
        contact = replace(self._contact.moved(after.pose, after.offset), kappa=after.kappa, faces=faces)
        eps = self._problem.options.slip * contact.dhat
        coupled = CoupledContact(contact, self._problem.friction, trial, eps)
        here = ContactSlopes(coupled, after.x)
        by_law = np.stack([self._by_law(parameter, after.x) for parameter in self._parameters])

        stronger = np.array([p.friction for p in self._parameters]) / max(self._problem.friction, 1e-300)
        rub = stronger[:, None, None, None] * here.friction
        load = _scatter(faces, here.force(self._relative(np.zeros_like(anchors)), anchors) + rub, nodes) - by_law
        solve = solver(self._problem, self._tangent, after.x, here.forces.tangent, on)
        *columns, x_by_offset = solve(np.concatenate([load, _scatter(faces, here.by_offset[None], nodes)]))
        x, fixed = np.stack(columns), np.zeros(len(columns))
        excess = here.gap_excess(self._relative(_at(faces, x)), fixed)
        offset = -excess / here.gap_excess(faces.at(x_by_offset)[None], np.ones(1))
        x = x + offset[:, None, None] * x_by_offset

        motion, everywhere = self._relative(_at(faces, x)), _at(self._contact.faces, x)
        force = here.force(motion, anchors) + rub + offset[:, None, None, None] * here.by_offset
        dragged = here.dragged(motion, anchors) @ after.pose.rotation
        anchor, wide = self._local(everywhere, after), np.zeros_like(everywhere)
        anchor[:, on] = np.where((after.normal_force[on] > 0)[..., None], dragged, anchor[:, on])
        parts = here.normal_force(motion, offset), here.normal(motion), force
        normal_force, normal, force = (_placed(part, on, wide) for part in parts)
        return Slopes(normal_force, normal, force, anchor, x, x - first_order)

    def _predictor_slopes(self, after: History) -> Array:
        """Derivatives (k, n, 3) of the step that the predictor takes along its tangent."""
        before, was = self._before, self._slopes
        if not self._tangent.usable or (springs := tied(self._contact, self._tangent, before)) is None:
            return np.zeros_like(was.x)
        on = np.flatnonzero((before.normal_force > 0).any(1))
        faces, ties = self._contact.faces.only(on), STICKING_SPRING_STIFFNESS / self._contact.dhat
        assert after.predictor_error is not None
        error, motion = after.predictor_error
        step = after.x - error - before.x
        lag = motion[on] - faces.at(step)
        turn = after.pose.rotation @ before.pose.rotation.T - np.eye(3)
        pull = was.normal_force[:, on, :, None] * lag
        pull += before.normal_force[on, :, None] * (self._relative(_at(faces, was.x)) @ turn.T)
        b = _scatter(faces, ties * pull, len(after.x)) - self._stiffer(step)
        return everywhere(self._problem, springs.solve(free_columns(self._problem, b)))

    def _stiffer(self, u: Array) -> Array:
        """How the tangent before the step, times u (n, 3), changes with the parameters (k, n, 3) [N]: a mixed second
        difference of the bulk's forces."""
        problem, x, slopes = self._problem, self._before.x, []
        far = POSITION_DIFFERENCE * problem.edge / max(float(np.abs(u).max()), 1e-300)
        folds = any(barrier.evaluate(x).cells.size for barrier in problem.folding)

        def times(laws: Sequence[Law], x: Array) -> Array:
            elastic = tuple(replace(part, law=law) for part, law in zip(problem.elastic, laws, strict=True))
            bulk = Bulk(elastic, problem.folding if folds else ())
            return np.asarray((bulk.at(x + far * u).gradient - bulk.at(x).gradient) / far)

        laws = [part.law for part in problem.elastic]
        here = times(laws, x)
        for parameter, slope in zip(self._parameters, self._slopes.x, strict=True):
            small = PARAMETER_DIFFERENCE / 10 * parameter.scale
            changed = laws if parameter.laws is None else parameter.laws(small)
            slopes.append((times(changed, x + small * slope) - here) / small)
        return np.stack(slopes)

    def _extrapolated(self, after: History) -> float:
        """The fraction of its last first-order error that the predictor added in this step."""
        if after.predicted is None or self._before.predictor_error is None:
            return 0.0
        assert after.predictor_error is not None
        first_order, error = after.x - after.predictor_error[0], self._before.predictor_error[0]
        return float(((after.predicted - first_order) * error).sum() / (error**2).sum())

    def _trial_anchors(self, after: History, on: Array, predicted: Array) -> tuple[Array, Array]:
        """Anchors that the step's friction started from (f, q, 3) [mm], and their slopes (k, f, q, 3), relative to the
        indenter; of new points as measures.onset has them, where the predicted x has slopes `predicted` (k, n, 3)."""
        before, was, faces = self._before, self._slopes.anchor[:, on], self._contact.faces.only(on)
        start, held = before.anchor[on], (before.normal_force[on] > 0)[..., None]
        ahead = after.pose.local(faces.at(before.x if after.predicted is None else after.predicted))
        gap, normal = self._contact.shape.gradient(ahead.reshape(-1, 3))
        room, gap, normal = before.gap[on] - before.offset, gap.reshape(ahead.shape[:2]), normal.reshape(ahead.shape)
        trial = np.where(held, start, onset(start, ahead, room, gap))
        gone, closing = self._local(_at(faces, predicted), after), np.maximum(room - gap, 1e-12)
        part = np.where(gap < 0, np.clip(room / closing, 0.0, 1.0), 1.0)
        closer = dot(before.normal[on], was) * (1 - part) + part * dot(normal, gone)
        longer = np.where((part > 0) & (part < 1), closer / closing, 0.0)[..., None] * (ahead - start)
        new = was + part[..., None] * (gone - was) + longer
        return after.pose.world(trial), np.where(held, was, new) @ after.pose.rotation.T

    def _by_law(self, parameter: Parameter, x: Array) -> Array:
        """How the bulk's forces at x (n, 3) change with its laws [N]."""
        if (laws := parameter.laws) is None:
            return np.zeros_like(x)

        def forces(p: float) -> Array:
            parts = zip(self._problem.elastic, laws(p), strict=True)
            return np.asarray(sum(replace(part, law=law).gradient(x) for part, law in parts))

        small = PARAMETER_DIFFERENCE * parameter.scale
        return np.asarray((forces(small) - forces(-small)) / (2 * small))


def _at(faces: Faces, x: Array) -> Array:
    """(k, f, q, 3) of x (k, n, 3)."""
    return np.stack([faces.at(one) for one in x])


def _scatter(faces: Faces, forces: Array, nodes: int) -> Array:
    """(k, n, 3) of forces (k, f, q, 3)."""
    return np.stack([faces.scatter(one, nodes) for one in forces])


def _placed(values: Array, on: Array, like: Array) -> Array:
    """Values of the facets `on` among all."""
    out = np.zeros(like.shape[: values.ndim])
    out[:, on] = values
    return out
