"""How an equilibrium moves with a parameter, by the implicit function theorem: no second solve.

    R(x, o; p) = 0    forces on the free dofs,        K dx + R_o do + R_p dp = 0
    o = m(x, o; p)    mean gap, the shrunk offset,    do = m_x dx + m_o do + m_p dp

K is the exact tangent of gel and contact. The factor that Newton's method has at hand is that of a tangent nearby, and
preconditions GMRES. Friction's anchors on the indenter are held as they were before the frame.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import LinearOperator, gmres

from tacgen.contact.barrier import Contact, Pose
from tacgen.contact.coupled import ContactForces, CoupledContact
from tacgen.fem.materials import Law
from tacgen.fem.potential import Projection
from tacgen.solve.bulk import Bulk
from tacgen.solve.full_newton import WholeBulk
from tacgen.solve.problem import Problem
from tacgen.solve.state import History, NotConverged, State

Array = np.ndarray
SMALL = 1e-3  # of dhat, what differences move, and of a parameter's scale
RTOL = 1e-7  # of the right-hand side, where GMRES stops: a lowered pose presses each point by far more than its force
MOST, RESTARTS = 40, 3  # of its steps, and times that; then all is factorised anew


@dataclass(frozen=True)
class Parameter:
    """What changes with p: the layers' laws, friction and how deep the pose is [mm], the latter two per unit of p;
    `scale` is what p is small beside."""

    scale: float
    laws: Callable[[float], tuple[Law, ...]] | None = None
    friction: float = 0.0
    depth: float = 0.0


NOTHING = Parameter(1.0)


class Linearised:
    """The equilibrium of a frame, and how it moves."""

    def __init__(self, problem: Problem, state: State, before: History) -> None:
        """`before`: what the frame inherited of the one before."""
        assert state.after is not None
        self.problem, self.state = problem, state
        held = (before.normal_force > 0)[..., None] & (state.substeps == 1)
        self._anchor = np.where(held, before.anchor, state.after.anchor)
        self._bulk, self._h = Bulk(problem.elastic, problem.folding, ()), SMALL * problem.contact.dhat
        base = self._forces(state.x, 0.0, NOTHING, 0.0)
        self._touching = bool(base.N.any())
        self._solve = self._solver(base)
        lean = self._slope(lambda h: -self._scattered(self._forces(state.x, h, NOTHING, 0.0)), self._h)
        self._leaning = self._solve(-lean) if self._touching else np.zeros_like(state.x)

    def moved(self, parameter: Parameter) -> tuple[State, float]:
        """The state where p is larger by a small step, and that step.

        Raises NotConverged: the linear equations have no solution, as where the gel snaps.
        """
        state, small = self.state, SMALL * parameter.scale
        pull = self._slope(lambda h: -self._scattered(self._forces(state.x, 0.0, parameter, h)), small)
        if (laws := parameter.laws) is not None:
            pull += self._slope(lambda h: self._inner(laws(h)), small)
        dx, do = self._solve(-pull), 0.0
        if self._touching:
            by_p = self._gap_slope(dx, 0.0, parameter, small)
            do = by_p / (1 - self._gap_slope(self._leaning, 1.0, NOTHING, self._h))
        way = dx + do * self._leaning
        step = min(small, self._h / max(float(np.abs(way).max()), abs(do), 1e-300))
        forces = self._forces(state.x + step * way, step * do, parameter, step)
        rub = None if state.friction is None else forces.force - forces.N[..., None] * forces.normal
        pose = self._pose(parameter, step)
        return replace(state, x=state.x + step * way, pose=pose, offset=state.offset + step * do,
                       normal_force=forces.N, normal=forces.normal, friction=rub), step  # fmt: skip

    def _slope(self, f: Callable[[float], Array], h: float) -> Array:
        return np.asarray((f(h) - f(-h)) / (2 * h))

    def _gap_slope(self, dx: Array, do: float, parameter: Parameter, h: float) -> float:
        """How the mean gap changes along x, o and p together; h is for p."""
        h = min(h, self._h / max(float(np.abs(dx).max()), abs(do), 1e-300))
        ends = [self._forces(self.state.x + s * dx, s * do, parameter, s).mean_gap for s in (h, -h)]
        return float(ends[0] - ends[1]) / (2 * h)

    def _pose(self, parameter: Parameter, p: float) -> Array:
        pose = self.state.pose.copy()
        pose[2, 3] -= p * parameter.depth
        return pose

    def _coupled(self, offset: float, parameter: Parameter, p: float) -> CoupledContact:
        whole, after = self.problem.contact, self.state.after
        assert isinstance(whole, Contact)
        assert after is not None
        pose = Pose.of(self._pose(parameter, p))
        contact = replace(whole.moved(pose, self.state.offset + offset), kappa=after.kappa)
        friction, eps = self.problem.friction + p * parameter.friction, self.problem.options.slip * whole.dhat
        return CoupledContact(contact, friction, pose.world(self._anchor), eps)

    def _forces(self, x: Array, offset: float, parameter: Parameter, p: float) -> ContactForces:
        return self._coupled(offset, parameter, p).evaluate(x)

    def _scattered(self, forces: ContactForces) -> Array:
        contact = self.problem.contact
        assert isinstance(contact, Contact)
        return contact.faces.scatter(forces.force, len(self.state.x))

    def _inner(self, laws: tuple[Law, ...]) -> Array:
        parts = zip(self.problem.elastic, laws, strict=True)
        return np.asarray(sum(replace(part, law=law).gradient(self.state.x) for part, law in parts))

    def _solver(self, forces: ContactForces) -> Callable[[Array], Array]:
        """K dx = b for forces b (n, 3)."""
        problem, contact = self.problem, self._coupled(0.0, NOTHING, 0.0)
        whole, free, x = WholeBulk(problem, self._bulk), problem.pattern.free, self.state.x

        def direct(b: Array) -> Array:
            found = whole.solve(x, contact, forces.tangent, -b, False)
            if found is None:
                raise NotConverged("no sensitivity: the tangent is singular")
            return found

        condensed = problem.tangent.condensation if problem.condensed else None
        felt = np.flatnonzero(forces.tangent.any((1, 2, 3)))
        faces = contact.contact.faces
        if condensed is None or not condensed.usable or not condensed.covers(faces.conn[felt]):
            return direct
        data = np.zeros(len(problem.pattern.indices))
        self._bulk.add_tangent(whole.at(x), data, Projection.NONE, None)
        upper = csr_matrix((data, problem.pattern.indices, problem.pattern.indptr), shape=(problem.pattern.size,) * 2)
        diagonal, lower, part = upper.diagonal(), upper.T.tocsr(), faces.only(felt)
        added = condensed.schur.stiffness(forces.tangent[felt], faces.N, condensed.dofs[condensed.local[part.conn]])

        def wide(v: Array) -> Array:
            out = np.zeros(x.size)
            out[free] = v
            return out.reshape(x.shape)

        def times(v: Array) -> Array:
            pressed = np.einsum("fqij,fqj->fqi", forces.tangent[felt], part.at(wide(v)))
            return np.asarray(upper @ v + lower @ v - diagonal * v + part.scatter(pressed, len(x)).ravel()[free])

        def nearly(v: Array) -> Array:
            y = condensed.forward(-wide(v))
            u = condensed.schur.solve(added, -condensed.load(y), False)
            return np.asarray(condensed.expand(u, y).ravel()[free])

        size = (problem.pattern.size,) * 2
        K, M = LinearOperator(size, matvec=times), LinearOperator(size, matvec=nearly)

        def iterated(b: Array) -> Array:
            found, failed = gmres(K, b.ravel()[free], rtol=RTOL, restart=MOST, maxiter=RESTARTS, M=M)
            return direct(b) if failed else wide(found)

        return iterated
