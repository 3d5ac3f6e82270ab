"""Contact between two meshes by the IPC Toolkit: the coated face against a triangulated, rigid indenter.

The face is triangulated through its nodes and quadrature points. Each of these acts on the indenter's triangles, and
each of the indenter's vertices on those of the face, by the clamped log barrier of Li et al. (2020), weighted by area,
without double counting at edges and corners (Li et al. 2023, "Convergent IPC"), and with friction on the same pairs.

Pairs of edges get a hundredth of that force, only to prevent intersections: with their full areas they make a flat
contact 5 to 65 times too stiff, and cause tangential forces of up to a fifth of the normal force at single nodes
(tests/mechanics/test_ipctk.py).
"""

import math
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any, ClassVar

import numpy as np
from scipy import sparse
from scipy.spatial import Delaunay, cKDTree

from tacgen.fem.assembly import Pattern
from tacgen.fem.elements import facet_corners, facet_points
from tacgen.fem.potential import Projection
from tacgen.geometry.analytic_sdf import Shape, Triangles
from tacgen.geometry.pose import Pose
from tacgen.mechanics.barrier import Contact, Faces

Array = np.ndarray
NODES = 0.04  # share of a facet's area for its nodes, which only stop sharp features between quadrature points
VERTEX = 0.25  # largest area of an indenter's vertex, over that of a quadrature point, for the same reason
EDGE = 0.01  # share of that area for a pair of edges: prevents intersections with a negligible force
LIKE_DISTANCE = 0.25  # factor on kappa [-]: the Toolkit's barrier, of squared distances, is about 4 times as strong
CLEAR = 2.0  # smallest height above the gel at which the indenter starts, over dhat [-]
SAFE = 0.25  # largest reduction of the offset (growth of the shrunk indenter) in one step, over the smallest gap [-]


@cache
def _toolkit() -> Any:
    """The Toolkit and, added to it, the barrier whose Hessian is the Gauss-Newton one."""
    import ipctk

    class GaussNewton(ipctk.Barrier):  # type: ignore[misc]
        """A clamped log barrier f(D), D = d^2, with zero slope, so that only the part b'' of its Hessian remains.

        Of b(d) = f(D), b'' grad d grad d is (f'' + f'/2D) grad D grad D, with f = -(D - Dhat)^2 ln(D/Dhat). The
        curvature of d jumps at corners, which stalls Newton's method; clamped to be positive it makes the gel too stiff
        against sliding.
        """

        def __init__(self) -> None:
            super().__init__()

        def __call__(self, D: float, Dhat: float) -> float:
            return 0.0  # would only add the mollifier of nearly parallel edges

        def first_derivative(self, D: float, Dhat: float) -> float:
            return 0.0

        def second_derivative(self, D: float, Dhat: float) -> float:
            part, r = D / Dhat, 1 - Dhat / D
            return -math.log(part) * (2 + r) - 4 * r + r * r / 2 if part < 1 else 0.0

        def units(self, Dhat: float) -> float:
            return Dhat * Dhat

    ipctk.set_num_threads(1)  # deterministic order of sums
    ipctk.set_logger_level(ipctk.LoggerLevel.error)
    return ipctk, GaussNewton()


def lattice(nodes: int) -> tuple[Array, Array, Array]:
    """Points on a facet, first its nodes, then its quadrature points: N (q, a), their shares of its area (q,), and a
    triangulation (t, 3)."""
    N, _, weights = facet_points(nodes)
    N = np.concatenate([np.eye(nodes), N])
    at = N @ facet_corners(nodes)
    pieces = Delaunay(at).simplices
    a, b, c = np.moveaxis(at[pieces], 1, 0)
    twice = np.linalg.det(np.stack([b - a, c - a], 1))
    pieces = np.where(twice[:, None] > 0, pieces, pieces[:, ::-1])[np.abs(twice) > 1e-9]
    return N, np.concatenate([np.full(nodes, NODES / nodes), (1 - NODES) * weights / weights.sum()]), pieces


def _follow(pattern: Pattern, points: Array, facets: Array) -> Array:
    """(n,) 1 on the face, 0 where the gel is bonded, and in between proportional to the height above the base."""
    face, held = np.unique(facets), np.ones(len(points), bool)
    held[pattern.free // 3] = False
    base = points[held, 2].min() if held.any() else points[:, 2].min() - 1.0
    top = points[face[cKDTree(points[face, :2]).query(points[:, :2])[1]], 2]
    out = np.clip((points[:, 2] - base) / (top - base), 0.0, 1.0)
    out[face], out[held] = 1.0, 0.0
    return np.asarray(out)


@dataclass(frozen=True, eq=False)
class Pair:
    """Both surfaces as one mesh for the Toolkit: first c points of the gel's face, then the indenter's v vertices.

    faces: the points by facet (f, q), those on edges once for each facet; copy (f, q): which of the c points each is;
    share (f, q): its part of that point's area; weights (c, n): interpolation from the nodes; follow (n,): share of a
    motion of the whole face that a node follows.
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
        collision.vertex_areas = 4 * np.concatenate([area, stands_for])  # the Toolkit takes a quarter of it
        body = np.repeat(np.array([0, 1], np.int32), [len(first), len(indenter.vertices)])
        collision.can_collide = ipctk.make_vertex_patches_filter(body)
        follow = _follow(pattern, points, facets)
        return cls(faces, indenter, copy, faces.areas / area[copy], weights, collision, follow, pattern)

    @property
    def points(self) -> int:
        """Number of vertices on the gel."""
        return int(self.weights.shape[0])

    @cached_property
    def firsts(self) -> Array:
        """Number among (f q) of the first copy of each point (c,)."""
        return np.unique(self.copy, return_index=True)[1]

    @cached_property
    def moves(self) -> Any:
        """Matrix from displacements of the pattern's free dofs to those of the points (3c,)."""
        return sparse.kron(self.weights, sparse.eye(3), format="csc")[:, self.pattern.free]

    @cached_property
    def entries(self) -> Array:
        """The pattern's entries, row by row, each as one sorted key."""
        rows = np.repeat(np.arange(self.pattern.size), np.diff(self.pattern.indptr))
        return np.asarray(rows * np.int64(self.pattern.size) + self.pattern.indices)

    def at(self, x: Array, pose: Pose, offset: float) -> Array:
        """All vertices (c + v, 3) with the gel's nodes at x and the indenter, shrunk by offset, at pose."""
        body = pose.world(self.indenter.vertices - offset * self.indenter.outward)
        return np.asfortranarray(np.concatenate([self.weights @ x, body]))

    def spread(self, forces: Array) -> Array:
        """Forces on the gel's points per facet (f, q, 3), from forces on the vertices (c + v, 3)."""
        return np.asarray(forces[self.copy] * self.share[..., None])

    def on_nodes(self, forces: Array) -> Array:
        """Nodal forces on the gel (n, 3), from forces on the vertices (c + v, 3)."""
        return np.asarray(self.weights.T @ forces[: self.points])

    def free_way(self, start: Array, end: Array) -> float:
        """Largest part of the linear motion between two sets of vertices that is free of collisions."""
        ipctk, _ = _toolkit()
        ccd = ipctk.AdditiveCCD()  # the exact method takes minutes for parallel flat faces
        part = float(ipctk.compute_collision_free_stepsize(self.collision, start, end, 0.0, ipctk.LBVH(), ccd))
        return 1.0 if part > 1 - 1e-9 else part

    def add_hessian(self, hessian: Any, data: Array) -> None:
        """Add d2E (3(c+v), 3(c+v)), restricted to the gel, to the pattern's entries."""
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
    overlaps: ClassVar[bool] = False
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
        """With another offset, or the nearest to it that the gaps of the gel at x allow."""
        return self.moved(self.pose, max(offset, self.offset - SAFE * self.least(x)))

    def clear(self, pose: Pose, x: Array) -> Pose:
        """A pose above `pose` at which the indenter does not touch the gel at x."""
        ipctk, _ = _toolkit()
        for doublings in range(20):
            lift = CLEAR * self.dhat * 2**doublings
            pose = Pose(pose.rotation, pose.position + np.array([0.0, 0.0, lift]))
            if not ipctk.has_intersections(self.pair.collision, self.pair.at(x, pose, self.offset), ipctk.LBVH()):
                break
        return pose

    def starts(self, x: Array, ahead: Array, pose: Pose) -> tuple[Array, Array]:
        """Positions from which Newton may start, reached without a collision from x under the indenter at `pose`.

        The indenter moves freely up to a collision. Then the face follows it rigidly: the first result. The second
        moves from there towards the guess `ahead` up to a collision.
        """
        before = self.moved(pose, self.offset)
        part = before._way(x, self, x)
        if part < 1:
            on = before.moved(before.pose.toward(self.pose, part), self.offset)
            on = on if before._way(x, on, x) == 1 else before  # the check assumed a linear motion
            x = x + self.pair.follow[:, None] * (self.pose.world(on.pose.local(x)) - x)
        return x, x + self._way(x, self, ahead) * (ahead - x)

    def _way(self, x: Array, other: "MeshContact", there: Array) -> float:
        """Largest part of the motion to another state of indenter and gel that is free of collisions."""
        return self.pair.free_way(self._vertices(x), other._vertices(there))

    def _vertices(self, x: Array) -> Array:
        return self.pair.at(x, self.pose, self.offset)

    def _near(self, x: Array) -> tuple[Array, Any, Array]:
        """All vertices, the pairs within dhat of each other and the gradient of their energy (c + v, 3).

        The search dominates the time, so the result for the last array is kept.
        """
        if not self._found or self._found[0][0] is not x:
            self._found[:] = [(x, self._find(x))]
        nearby: tuple[Array, Any, Array] = self._found[0][1]
        return nearby

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

    def friction(self, coefficient: float, x: Array, normal_force: Array, anchor: Array, eps: float) -> "MeshFriction":
        """Friction with the pairs, forces and directions of the gel at x, lagged; `normal_force` (f, q) [N] are these
        forces, `anchor` (f, q, 3) in the sensor frame."""
        ipctk, _ = _toolkit()
        V, near, _ = self._near(x)
        tangential = ipctk.TangentialCollisions()
        tangential.build(self.pair.collision, V, near, self._barrier, coefficient)
        return MeshFriction(normal_force, anchor, eps, self.pair, tangential)


@dataclass(frozen=True)
class MeshFriction:
    """Friction of pairs of primitives; slip counts from each point's anchor. Fits potential.Potential."""

    normal_force: Array  # (f, q) [N], lagged
    anchor: Array
    eps: float  # slip over which friction builds up [mm]
    pair: Pair
    tangential: Any

    def _slips(self, x: Array) -> tuple[Any, Any, Array]:
        """Arguments for the Toolkit: the pairs, the mesh, and the slip of each vertex (c + v, 3)."""
        slips = np.zeros((self.pair.points + len(self.pair.indenter.vertices), 3), order="F")
        slips[: self.pair.points] = self.pair.weights @ x - self.anchor.reshape(-1, 3)[self.pair.firsts]
        return self.tangential, self.pair.collision, slips

    @property
    def _potential(self) -> Any:
        return _toolkit()[0].FrictionPotential(self.eps)

    def _push(self, x: Array) -> Array:
        return np.asarray(self._potential.gradient(*self._slips(x)).reshape(-1, 3))

    def force(self, x: Array) -> Array:
        """Friction on the gel (f, q, 3) [N]."""
        return self.pair.spread(-self._push(x))

    def value(self, x: Array) -> float:
        return float(self._potential(*self._slips(x)))

    def gradient(self, x: Array) -> Array:
        return self.pair.on_nodes(self._push(x))

    def add_hessian(self, x: Array, data: Array, projection: Projection) -> None:
        method = _toolkit()[0].PSDProjectionMethod
        hessian = self._potential.hessian(*self._slips(x), method.CLAMP if projection else method.NONE)
        self.pair.add_hessian(hessian, data)

    def max_step(self, x: Array, p: Array) -> float:
        return 1.0
