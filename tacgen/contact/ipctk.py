"""Contact between two meshes by the IPC Toolkit: the coated face against a triangulated, rigid indenter.

The face is triangulated through its nodes and quadrature points. Each of these pushes on the indenter's triangles, and
each of the indenter's vertices on the face's, with the clamped log barrier of Li et al. (2020), weighted by area, with
what edges and corners count twice taken off (Li et al. 2023, "Convergent IPC"), and with friction on the same pairs.

Each crossing of two edges takes a hundredth of that force, only to keep them apart: with their full areas, crossings
make a flat contact 5 to 65 times as stiff as its area says, and push single nodes along the face by up to a fifth of
the force across it (tests/contact/test_ipctk.py).
"""

import math
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from scipy import sparse
from scipy.spatial import Delaunay, cKDTree

from tacgen.contact.barrier import Contact, Faces, Pose
from tacgen.contact.friction import Friction
from tacgen.fem.assembly import Pattern
from tacgen.fem.elements import facet_corners, facet_points
from tacgen.fem.potential import Projection
from tacgen.geometry.analytic_sdf import Shape, Triangles

Array = np.ndarray
NODES = 0.04  # of a facet's area falls to its nodes, which only keep what is sharp from slipping between the others
VERTEX = 0.25  # of a quadrature point's area is the most that an indenter's vertex stands for, for the same reason
EDGE = 0.01  # of its area falls to each crossing of two edges: enough to keep them apart, too little to be felt
LIKE_DISTANCE = 0.25  # the Toolkit's barrier, of squared distances, pushes about 4 times as hard as contact.barrier
CLEAR = 2.0  # times dhat: how far above the gel the indenter starts, at least
SAFE = 0.25  # of the smallest gap, by which the indenter's surface may grow at a time


@cache
def _toolkit() -> Any:
    """The Toolkit and, added to it, the barrier whose Hessian is the Gauss-Newton one."""
    import ipctk

    class GaussNewton(ipctk.Barrier):  # type: ignore[misc]
        """A clamped log barrier f(D), D = d^2, without slope: of its Hessian, what stretches d is left.

        Of b(d) = f(D), b'' grad d grad d is (f'' + f'/2D) grad D grad D, with f = -(D - Dhat)^2 ln(D/Dhat). The
        curvature of d, which jumps wherever a corner is passed, stalls Newton's method, and clamped at zero it makes
        the gel stiff against sliding.
        """

        def __init__(self) -> None:
            super().__init__()

        def __call__(self, D: float, Dhat: float) -> float:
            return 0.0  # it would only bring in how crossings fade where edges become parallel

        def first_derivative(self, D: float, Dhat: float) -> float:
            return 0.0

        def second_derivative(self, D: float, Dhat: float) -> float:
            part, r = D / Dhat, 1 - Dhat / D
            return -math.log(part) * (2 + r) - 4 * r + r * r / 2 if part < 1 else 0.0

        def units(self, Dhat: float) -> float:
            return Dhat * Dhat

    ipctk.set_num_threads(1)  # sums in one order
    ipctk.set_logger_level(ipctk.LoggerLevel.error)
    return ipctk, GaussNewton()


def lattice(nodes: int) -> tuple[Array, Array, Array]:
    """Points on a facet, its nodes and then its quadrature points: N (q, a), their parts of its area (q,), and the
    triangles (t, 3) between them."""
    N, _, weights = facet_points(nodes)
    N = np.concatenate([np.eye(nodes), N])
    at = N @ facet_corners(nodes)
    pieces = Delaunay(at).simplices
    a, b, c = np.moveaxis(at[pieces], 1, 0)
    twice = np.linalg.det(np.stack([b - a, c - a], 1))
    pieces = np.where(twice[:, None] > 0, pieces, pieces[:, ::-1])[np.abs(twice) > 1e-9]
    return N, np.concatenate([np.full(nodes, NODES / nodes), (1 - NODES) * weights / weights.sum()]), pieces


def _follow(pattern: Pattern, points: Array, facets: Array) -> Array:
    """1 on the face, 0 where the gel is held, in proportion to the height above the base in between (n,)."""
    face, held = np.unique(facets), np.ones(len(points), bool)
    held[pattern.free // 3] = False
    base = points[held, 2].min() if held.any() else points[:, 2].min() - 1.0
    top = points[face[cKDTree(points[face, :2]).query(points[:, :2])[1]], 2]
    out = np.clip((points[:, 2] - base) / (top - base), 0.0, 1.0)
    out[face], out[held] = 1.0, 0.0
    return np.asarray(out)


@dataclass(frozen=True, eq=False)
class Pair:
    """The two surfaces side by side for the Toolkit: first c points of the gel's face, then the indenter's v vertices.

    faces: the points by facet (f, q), those on edges once for each facet; copy (f, q): which of the c points each is;
    share (f, q): its part of that point's area; weights (c, n): the points from the nodes; follow (n,): how far nodes
    go along where the whole face is moved.
    """

    faces: Faces
    indenter: Triangles
    copy: Array
    share: Array
    weights: Any
    collision: Any
    follow: Array
    pattern: Pattern

    @classmethod
    def of(cls, pattern: Pattern, points: Array, facets: Array, indenter: Triangles) -> "Pair":
        ipctk, _ = _toolkit()
        N, part, pieces = lattice(facets.shape[1])
        simple = Faces.on(pattern, points, facets)
        faces = replace(simple, N=N, areas=simple.areas.sum(1)[:, None] * part)
        at = faces.at(points)
        places = np.round(at.reshape(-1, 3) / np.ptp(points), 8)
        _, first, copy = np.unique(places, axis=0, return_index=True, return_inverse=True)
        copy = copy.reshape(at.shape[:2])
        area = np.bincount(copy.ravel(), faces.areas.ravel())
        f, q = np.divmod(first, len(N))
        rows = np.repeat(np.arange(len(first)), N.shape[1])
        weights = sparse.csr_matrix((N[q].ravel(), (rows, facets[f].ravel())), (len(first), len(points)))
        triangles = np.concatenate([copy[:, pieces].reshape(-1, 3), indenter.triangles + len(first)])
        triangles = np.asfortranarray(triangles.astype(np.int32))
        rest = np.asfortranarray(np.concatenate([at.reshape(-1, 3)[first], indenter.vertices]))
        collision = ipctk.CollisionMesh(rest, ipctk.edges(triangles), triangles)
        stands_for = np.minimum(indenter.areas, VERTEX * simple.areas.min())
        collision.edge_areas = np.full(collision.num_edges, 2 * EDGE * simple.areas.min())  # both are added, and halved
        collision.vertex_areas = 4 * np.concatenate([area, stands_for])  # of which the Toolkit takes a quarter
        body = np.repeat(np.array([0, 1], np.int32), [len(first), len(indenter.vertices)])
        collision.can_collide = ipctk.make_vertex_patches_filter(body)
        follow = _follow(pattern, points, facets)
        return cls(faces, indenter, copy, faces.areas / area[copy], weights, collision, follow, pattern)

    @property
    def points(self) -> int:
        """How many of the vertices are the gel's."""
        return int(self.weights.shape[0])

    @cached_property
    def firsts(self) -> Array:
        """Number among (f q) of the first copy of each point (c,)."""
        return np.unique(self.copy, return_index=True)[1]

    @cached_property
    def moves(self) -> Any:
        """Displacements (3c,) of the points from those of the pattern's free dofs."""
        return sparse.kron(self.weights, sparse.eye(3), format="csc")[:, self.pattern.free]

    @cached_property
    def entries(self) -> Array:
        """The pattern's entries in their order, row by row, each as one number."""
        rows = np.repeat(np.arange(self.pattern.size), np.diff(self.pattern.indptr))
        return np.asarray(rows * np.int64(self.pattern.size) + self.pattern.indices)

    def at(self, x: Array, pose: Pose, offset: float) -> Array:
        """All vertices (c + v, 3) with the gel's nodes at x and the indenter, shrunk by offset, at pose."""
        body = pose.world(self.indenter.vertices - offset * self.indenter.outward)
        return np.asfortranarray(np.concatenate([self.weights @ x, body]))

    def spread(self, forces: Array) -> Array:
        """What of forces on the vertices (c + v, 3) falls to the gel's points, facet by facet (f, q, 3)."""
        return np.asarray(forces[self.copy] * self.share[..., None])

    def on_nodes(self, forces: Array) -> Array:
        """What forces on the vertices (c + v, 3) do to the gel's nodes (n, 3)."""
        return np.asarray(self.weights.T @ forces[: self.points])

    def free_way(self, start: Array, end: Array) -> float:
        """Part of the straight way between two sets of vertices that is free of collisions."""
        ipctk, _ = _toolkit()
        ccd = ipctk.AdditiveCCD()  # the exact one takes minutes where flat faces are parallel
        part = float(ipctk.compute_collision_free_stepsize(self.collision, start, end, 0.0, ipctk.LBVH(), ccd))
        return 1.0 if part > 1 - 1e-9 else part

    def add_hessian(self, hessian: Any, data: Array) -> None:
        """Add d2E (3(c+v), 3(c+v)), of which the indenter's part is fixed, to the pattern's entries."""
        S = self.moves
        K = sparse.triu(S.T @ hessian[: S.shape[0], : S.shape[0]] @ S).tocoo()
        np.add.at(data, np.searchsorted(self.entries, K.row * np.int64(S.shape[1]) + K.col), K.data)


@dataclass(frozen=True)
class MeshContact:
    """The barrier between the coated face and a triangulated indenter shrunk by `offset`; stands in for Contact.

    distance: the same contact by signed distance. Its gaps say where a point is going to touch, and its curvature, that
    of the surface which the triangles stand for, goes into the Hessian.
    """

    pair: Pair
    distance: Contact
    pose: Pose
    dhat: float  # [mm]
    kappa: float  # [MPa]
    offset: float = 0.0  # [mm]
    _found: list[tuple[Array, Any]] = field(default_factory=list, init=False, compare=False, repr=False)

    @property
    def faces(self) -> Faces:
        return self.pair.faces

    @property
    def shape(self) -> Shape:
        return self.distance.shape

    def moved(self, pose: Pose, offset: float) -> "MeshContact":
        return replace(self, pose=pose, offset=offset, distance=self.distance.moved(pose, offset))

    def grown(self, offset: float, x: Array) -> "MeshContact":
        """Shrunk by another offset, or by as near to it as what is close to the gel at x allows."""
        return self.moved(self.pose, max(offset, self.offset - SAFE * self.least(x)))

    def clear(self, pose: Pose, x: Array) -> Pose:
        """Above `pose`, where the indenter does not touch the gel at x."""
        ipctk, _ = _toolkit()
        for doublings in range(20):
            lift = CLEAR * self.dhat * 2**doublings
            pose = Pose(pose.rotation, pose.position + np.array([0.0, 0.0, lift]))
            if not ipctk.has_intersections(self.pair.collision, self.pair.at(x, pose, self.offset), ipctk.LBVH()):
                break
        return pose

    def starts(self, x: Array, ahead: Array, pose: Pose) -> tuple[Array, Array]:
        """Positions from which Newton may start, reached without a collision from x under the indenter at `pose`.

        The indenter moves through air as far as it can; from there on the whole face follows as if glued to it, which
        is the first answer. The second then goes toward the guess `ahead` as far as it can.
        """
        before = self.moved(pose, self.offset)
        part = before._way(x, self, x)
        if part < 1:
            on = before.moved(before.pose.toward(self.pose, part), self.offset)
            on = on if before._way(x, on, x) == 1 else before  # its way is a turn, and the one looked at was straight
            x = x + self.pair.follow[:, None] * (self.pose.world(on.pose.local(x)) - x)
        return x, x + self._way(x, self, ahead) * (ahead - x)

    def _way(self, x: Array, other: "MeshContact", there: Array) -> float:
        """Part of the way to another place of indenter and gel that is free of collisions."""
        return self.pair.free_way(self._vertices(x), other._vertices(there))

    def _vertices(self, x: Array) -> Array:
        return self.pair.at(x, self.pose, self.offset)

    def _near(self, x: Array) -> tuple[Array, Any, Array]:
        """All vertices, the pairs within dhat of each other and the gradient of their energy (c + v, 3).

        The search takes far longer than all else: what it found for the last array is kept.
        """
        if not self._found or self._found[0][0] is not x:
            self._found[:] = [(x, self._find(x))]
        found: tuple[Array, Any, Array] = self._found[0][1]
        return found

    def _find(self, x: Array) -> tuple[Array, Any, Array]:
        ipctk, _ = _toolkit()
        V, candidates, near = self._vertices(x), ipctk.Candidates(), ipctk.NormalCollisions()
        candidates.build(self.pair.collision, V, self.dhat / 2, ipctk.LBVH())
        near.use_area_weighting = True
        near.collision_set_type = ipctk.NormalCollisions.IMPROVED_MAX_APPROX
        near.build(candidates, self.pair.collision, V, self.dhat, 0.0)
        return V, near, self._barrier.gradient(near, self.pair.collision, V).reshape(-1, 3)

    @property
    def _barrier(self) -> Any:
        ipctk, _ = _toolkit()
        return ipctk.BarrierPotential(self.dhat, LIKE_DISTANCE * self.kappa, use_physical_barrier=True)

    def gaps(self, x: Array) -> tuple[Array, Array, Array]:
        """Gaps, normals and Hessians by signed distance."""
        return self.distance.gaps(x)

    def least(self, x: Array) -> float:
        """Smallest gap to the shrunk indenter [mm]."""
        V, near, _ = self._near(x)
        least = float(np.sqrt(near.compute_minimum_distance(self.pair.collision, V)))
        return least if np.isfinite(least) else max(self.dhat, self.distance.least(x))

    def mean_gap(self, x: Array) -> float:
        """Force-weighted mean gap [mm]: distances are of degree one in the positions, so force times gap is -g . V."""
        V, _, g = self._near(x)
        total = float(np.linalg.norm(g[: self.pair.points], axis=1).sum())
        return -float((g * V).sum()) / total if total > 0 else self.offset

    def pressure(self, x: Array) -> tuple[Array, Array, Array]:
        """Force of each point on the indenter (f, q) [N], its direction (f, q, 3) and gap (f, q) [mm]."""
        force = self.pair.spread(-self._near(x)[2])
        size = np.linalg.norm(force, axis=-1)
        gap, normal, _ = self.gaps(x)
        return size, np.where(size[..., None] > 0, force / np.maximum(size, 1e-300)[..., None], normal), gap

    def value(self, x: Array) -> float:
        V, near, _ = self._near(x)
        return float(self._barrier(near, self.pair.collision, V))

    def gradient(self, x: Array) -> Array:
        return self.pair.on_nodes(self._near(x)[2])

    def add_hessian(self, x: Array, data: Array, projection: Projection) -> None:
        ipctk, gauss_newton = _toolkit()
        V, near, _ = self._near(x)
        barrier = ipctk.BarrierPotential(gauss_newton, self.dhat, LIKE_DISTANCE * self.kappa, use_physical_barrier=True)
        method = ipctk.PSDProjectionMethod.CLAMP if projection else ipctk.PSDProjectionMethod.NONE
        self.pair.add_hessian(barrier.hessian(near, self.pair.collision, V, method), data)
        if projection == Projection.NONE:
            force, _, _ = self.pressure(x)
            which = np.flatnonzero((force > 0).any(1))
            self.faces.add_blocks(which, -force[which][..., None, None] * self.gaps(x)[2][which], data)

    def max_step(self, x: Array, p: Array) -> float:
        return self._way(x, self, x + p)

    def friction(
        self, coefficient: float, x: Array, normal_force: Array, normal: Array, anchor: Array, eps: float
    ) -> "MeshFriction":
        """Friction with what is lagged: the pairs of the gel at x, their forces and directions, and anchors."""
        ipctk, _ = _toolkit()
        V, near, _ = self._near(x)
        rubbing = ipctk.TangentialCollisions()
        rubbing.build(self.pair.collision, V, near, self._barrier, coefficient)
        return MeshFriction(self.faces, coefficient, normal_force, normal, anchor, eps, self.pair, rubbing)


@dataclass(frozen=True)
class MeshFriction(Friction):
    """Friction of pairs of primitives; slip counts from each point's anchor on the indenter, as in Friction."""

    pair: Pair
    rubbing: Any

    def _slips(self, x: Array) -> tuple[Any, Any, Array]:
        """What the Toolkit asks for: the pairs, the mesh, and how far each vertex (c + v, 3) has slipped."""
        slips = np.zeros((self.pair.points + len(self.pair.indenter.vertices), 3), order="F")
        slips[: self.pair.points] = self.pair.weights @ x - self.anchor.reshape(-1, 3)[self.pair.firsts]
        return self.rubbing, self.pair.collision, slips

    @property
    def _potential(self) -> Any:
        return _toolkit()[0].FrictionPotential(self.eps)

    def _push(self, x: Array) -> Array:
        return np.asarray(self._potential.gradient(*self._slips(x)).reshape(-1, 3))

    def force(self, x: Array) -> Array:
        return self.pair.spread(-self._push(x))

    def value(self, x: Array) -> float:
        return float(self._potential(*self._slips(x)))

    def gradient(self, x: Array) -> Array:
        return self.pair.on_nodes(self._push(x))

    def add_hessian(self, x: Array, data: Array, projection: Projection) -> None:
        method = _toolkit()[0].PSDProjectionMethod
        hessian = self._potential.hessian(*self._slips(x), method.CLAMP if projection else method.NONE)
        self.pair.add_hessian(hessian, data)
