"""Contact of the coated face with a rigid indenter: a barrier on the signed distance at surface quadrature points.

Li et al. (2020), "Incremental Potential Contact", clamped barrier; scaled to a length times a pressure as in Li et al.
(2023), "Convergent IPC", and weighted by area, so that kappa [MPa] does not depend on the mesh.
"""

from dataclasses import dataclass, replace

import numpy as np

from tacgen.fem import assembly
from tacgen.fem.assembly import Pattern
from tacgen.fem.elements import facet_areas, facet_points, facet_shares
from tacgen.geometry.analytic_sdf import Shape
from tacgen.geometry.pose import Pose

Array = np.ndarray
# gap over dhat below which the barrier is a parabola, so that Newton can start from an overlap [-]
PARABOLA_GAP_RATIO = 0.5


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
    s = d / dhat
    t = np.clip(s, PARABOLA_GAP_RATIO, 1.0)
    ln, r = np.log(t), 1 - t
    b, db, ddb = -(r**2) * ln, 2 * r * ln - r**2 / t, -2 * ln + 4 * r / t + (r / t) ** 2
    below = np.minimum(s - PARABOLA_GAP_RATIO, 0.0)
    return dhat * (b + db * below + ddb / 2 * below**2), db + ddb * below, ddb / dhat


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
        facets = np.ascontiguousarray(facets)  # another memory layout would compile the loops again
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
        """Add the stiffness D (k, q, 3, 3) of the faces with indices `which` (k,)."""
        assembly.add_point_blocks(D, self.N, self.slots[which], data)


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

    def gaps(self, x: Array) -> tuple[Array, Array, Array]:
        """Gap to the shrunk indenter (f, q) [mm], normal (f, q, 3) and Hessian (f, q, 3, 3), in the sensor frame."""
        return self.gaps_at(self.faces.at(x))

    def gaps_at(self, at: Array) -> tuple[Array, Array, Array]:
        """Gap [mm], normal and Hessian, as of `gaps`, at points (f, q, 3)."""
        R = self.pose.rotation
        d, n, H = self.shape.distance(self.pose.local(at).reshape(-1, 3))
        fq = at.shape[:2]
        return d.reshape(fq) + self.offset, (n @ R.T).reshape(*fq, 3), (R @ H @ R.T).reshape(*fq, 3, 3)

    def gap(self, at: Array) -> Array:
        """Gap to the shrunk indenter (f, q) [mm] alone, at points (f, q, 3)."""
        return self.shape.value(self.pose.local(at).reshape(-1, 3)).reshape(at.shape[:2]) + self.offset

    def pressure(self, x: Array) -> tuple[Array, Array, Array]:
        """Force of each quadrature point on the indenter (f, q) [N], normals (f, q, 3) and gaps (f, q) [mm]."""
        d, n, _ = self.gaps(x)
        slope = np.maximum(np.linalg.norm(n, axis=2), 1e-12)  # 1 except for interpolated distances
        return -self.kappa * self.faces.areas * barrier(d, self.dhat)[1] * slope, n / slope[..., None], d

    def mean_gap(self, x: Array) -> float:
        """Force-weighted mean gap to the shrunk indenter [mm]; the present offset without contact."""
        force, _, gap = self.pressure(x)
        total = force.sum()
        return float((force * gap).sum() / total) if total > 0 else self.offset

    def least(self, x: Array) -> float:
        """Smallest gap to the shrunk indenter [mm]."""
        return float(self.gap(self.faces.at(x)).min())

    def max_step(self, gap: Array, p: Array) -> float:
        """Largest part of step p (n, 3) without tunnelling, from gaps (f, q) [mm]. Distance is 1-Lipschitz: a point
        that moves less than its gap cannot enter, and with half the indenter's reach in addition it cannot leave on the
        far side."""
        allowed = np.maximum(gap, 0.0) + self.shape.reach / 2
        return float(min(1.0, (allowed / np.maximum(np.linalg.norm(self.faces.at(p), axis=2), 1e-300)).min()))
