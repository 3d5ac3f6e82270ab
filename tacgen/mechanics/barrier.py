"""Contact of the coated face with a rigid indenter: a barrier on the signed distance at surface quadrature points.

Li et al. (2020), "Incremental Potential Contact", clamped barrier; scaled to a length times a pressure as in Li et al.
(2023), "Convergent IPC", and weighted by area, so that kappa [MPa] does not depend on the mesh.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tacgen.fem import assembly
from tacgen.fem.assembly import Pattern
from tacgen.fem.elements import facet_areas, facet_points, facet_shares
from tacgen.geometry.analytic_sdf import Shape
from tacgen.geometry.pose import Pose
from tacgen.mechanics.measures import SMALLEST
from tacgen.physics import contact as kernels
from tacgen.physics.assembly import add_sparse_blocks
from tacgen.physics.decisions import free_part
from tacgen.physics.runtime import call

Array = np.ndarray


def barrier(d: Array, dhat: float) -> tuple[Array, Array, Array]:
    """Clamped log barrier in millimetres with its first two derivatives.

        b(d) = -dhat (d/dhat - 1)^2 ln(d/dhat)     for PARABOLA_GAP_RATIO dhat < d < dhat

    0 from dhat on and C2 there; below PARABOLA_GAP_RATIO dhat its second-order Taylor polynomial. Times kappa [MPa] and
    an area [mm^2] it is an energy [N mm].

    Args:
        d: gaps [mm], any shape. dhat: gap below which the barrier acts [mm].

    Returns:
        b [mm], db/dd [-], d2b/dd2 [1/mm], each of the shape of d.
    """
    out = np.empty((d.size, 3))
    call(kernels.barriers, (d.size,), np.ascontiguousarray(d, float).ravel(), float(dhat), out)
    b, db, ddb = out.T
    return b.reshape(d.shape), db.reshape(d.shape), ddb.reshape(d.shape)


@dataclass(frozen=True)
class Faces:
    """Quadrature on the coated face: conn (f, a); N (q, a); rest areas (f, q) [mm^2]; slots of the (3a, 3a) blocks."""

    conn: Array
    N: Array
    areas: Array
    slots: Array

    @classmethod
    def on(cls, pattern: Pattern | None, points: Array, facets: Array, along: int = 2) -> "Faces":
        """With this number of points `along` each side of a quad; without slots if there is no pattern."""
        N, _, _ = facet_points(facets.shape[1], along)
        facets = np.ascontiguousarray(facets, np.int32)
        slots = np.zeros((len(facets), 0), np.int32) if pattern is None else pattern.slots(facets)
        return cls(facets, N, facet_areas(points, facets, along)[0], slots)

    def only(self, which: Array) -> "Faces":
        """The faces with indices `which` (k,)."""
        return replace(self, conn=self.conn[which], areas=self.areas[which], slots=self.slots[which])

    def at(self, x: Array) -> Array:
        """Positions (f, q, 3) of the quadrature points."""
        return np.asarray(assembly.at_points(x, self.conn, self.N))

    def scatter(self, forces: Array, nodes: int) -> Array:
        """Nodal forces (n, c) of forces (f, q, c) at the quadrature points."""
        return self._sum(self.N, forces, nodes)

    def shared(self, forces: Array, nodes: int) -> Array:
        """Nodal sums (n, c) for maps: as `scatter`, but uniform under a uniform pressure (see facet_shares)."""
        return self._sum(facet_shares(self.N, self.areas), forces, nodes)

    def _sum(self, weights: Array, forces: Array, nodes: int) -> Array:
        out = np.zeros((nodes, forces.shape[-1]))
        assembly.add_point_forces(forces, self.conn, weights, out)
        return out

    def add_blocks(self, which: Array, D: Array, data: Array) -> None:
        """Add the stiffness D (k, q, 3, 3) of the faces with indices `which` (k,) to the entries of the Pattern."""
        call(add_sparse_blocks, (1,), D, self.N, self.slots[which], data)


class Gaps(NamedTuple):
    """Points `at` (f, q, 3) of facets, their distances d (f, q) [mm] from an indenter, not shrunk, gradients n
    (f, q, 3) and Hessians H (f, q, 3, 3) [1/mm], in the sensor's frame."""

    at: Array
    d: Array
    n: Array
    H: Array


@dataclass(frozen=True)
class Contact:
    """The barrier between the coated face and an indenter shrunk by `offset`.

    The barrier keeps the gel at a small gap. The indenter is shrunk by the mean gap, so that on average the face lies
    on the real surface (see equilibrium).
    """

    faces: Faces
    shape: Shape
    pose: Pose
    dhat: float  # [mm]
    kappa: float  # [MPa]
    offset: float = 0.0  # [mm]

    def moved(self, pose: Pose, offset: float) -> "Contact":
        return replace(self, pose=pose, offset=offset)

    def gaps(self, x: Array) -> Gaps:
        """The points and their distances at nodes x (n, 3)."""
        wide = (*self.faces.areas.shape, 3)
        at, n, H, d = np.empty((1, *wide)), np.empty((1, *wide)), np.empty((1, *wide, 3)), np.empty((1, *wide[:2]))
        call(kernels.gaps, d.shape, x[None], *self.arrays, at, d, n, H)
        return Gaps(at[0], d[0], n[0], H[0])

    def gap(self, x: Array) -> Array:
        """Gap to the shrunk indenter (f, q) [mm] alone, at nodes x (n, 3)."""
        d = np.empty((1, *self.faces.areas.shape))
        call(kernels.gaps, d.shape, x[None], *self.arrays, None, d, None, None)
        return np.asarray(d[0] + self.offset)

    @cached_property
    def arrays(self) -> tuple[Array, ...]:
        """Facets, their shape functions and areas, the pose and the indenter, as kernels take them."""
        f = self.faces
        return f.conn[None], f.N, f.areas[None], *self.placed

    @cached_property
    def placed(self) -> tuple[Array, ...]:
        """The pose and the indenter, as kernels take them."""
        return self.pose.rotation[None], self.pose.position[None], *self.shape.record

    @cached_property
    def numbers(self) -> tuple[Array, ...]:
        """kappa, dhat and offset (1,), as kernels take them."""
        return tuple(np.array([part], float) for part in (self.kappa, self.dhat, self.offset))

    def least(self, x: Array) -> float:
        """Smallest gap to the shrunk indenter [mm]."""
        return float(self.gap(x).min())

    def max_step(self, gap: Array, p: Array) -> float:
        """Largest part of step p (n, 3) without tunnelling, from gaps (f, q) [mm]."""
        way = np.linalg.norm(self.faces.at(p), axis=2)
        return float(min(1.0, free_part(gap, self.shape.reach, way, SMALLEST).min()))
