"""The deformed faces of the gel, and the net force and torque.

Height, normals and gap are in camera_maps, pressure and traction in contact_maps, stress in stress, so that each is
computed only if it is needed.
"""

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from tacgen.geometry.analytic_sdf import Shape
from tacgen.geometry.clough_tocher import CloughTocher
from tacgen.geometry.pose import Pose
from tacgen.mechanics import Problem, State
from tacgen.outputs import contact_rim

if TYPE_CHECKING:
    from tacgen.mechanics.mesh import GelMesh

Array = np.ndarray
MIN_RADIUS_EDGES = 3  # indenter's smallest radius over the element edge, from which the face follows the indenter [-]
MIN_GAP_WEIGHT = 1e-3  # of the gap beside a contact, below which the face is drawn by its nodes alone [-]
MIN_TANGENT_NORMAL_Z = 0.2  # z component of an indenter's normal below which the face is not made tangent to it [-]


class GelSurface:
    """The coated face of a mesh at rest and now, smooth between its nodes (C1, Clough & Tocher).

    rest, now (s, 3) [mm]; facets (f, a) numbers among them; nodes (s,) their numbers in the mesh.
    """

    _touching: Array | None = None  # share of each facet's points that touch (f,)
    # the indenter, touching points (f, q), and the mesh's edge [mm]
    _contact: tuple[Shape, Pose, Array, float] | None = None

    def __init__(self, points: Array, facets: Array) -> None:
        self.nodes = np.unique(facets)
        self.facets = np.searchsorted(self.nodes, facets)
        self.rest = self.now = points[self.nodes]
        self._between = CloughTocher(self.rest[:, :2])

    def sharing(self, other: "GelSurface") -> "GelSurface":
        """This face; it shares the interpolation of another one whose nodes are at the same x and y."""
        if np.array_equal(self.rest[:, :2], other.rest[:, :2]):
            self._between = other._between
        return self

    def moved(self, x: Array) -> "GelSurface":
        """The face at nodal positions x (n, 3) of the mesh."""
        new = object.__new__(GelSurface)
        new.nodes, new.facets, new.rest, new._between = self.nodes, self.facets, self.rest, self._between
        new.now = x[self.nodes]
        return new

    def pressed(self, problem: Problem, state: State) -> "GelSurface":
        """The face in a solved state; in contact it follows the indenter's surface between the nodes, and beside it the
        gap opens as contact_rim says.

        Otherwise the cells would be visible as facets within a contact and as scallops around it. The mesh must resolve
        the indenter's curvature.
        """
        new, shape = self.moved(state.x), problem.contact.shape
        if self.facets.shape[1] > 1:
            touching = state.normal_force > 0
            new._touching = touching.mean(axis=1)
            if shape.smallest_radius >= MIN_RADIUS_EDGES * problem.edge:
                new._contact = shape, Pose.of(state.pose), touching, problem.edge
        return new

    @cached_property
    def _nodal(self) -> Array:
        """Positions and, in contact, the opening beside it and its weight, followed by their slopes: (3s, 3 or 5), see
        CloughTocher.nodal."""
        if self._contact is None:
            return self._between.nodal(self.now)
        touched, edge = self._contact[2:]
        gap, normal = self._to_indenter(self.now)
        most = np.repeat(touched.mean(1) - 0.5, self.facets.shape[1])  # over half of the points touch
        lies = (np.bincount(self.facets.ravel(), most) >= 0) & (np.abs(normal[:, 2]) > MIN_TANGENT_NORMAL_Z)
        placed = self.now - np.where(lies, gap, 0.0)[:, None] * normal
        opening = contact_rim.openings(self.rest[:, :2], gap, lies, edge)
        nodal = self._between.nodal(placed if opening is None else np.hstack([placed, opening]))
        slopes, tangent = nodal[len(gap) :].reshape(len(gap), 2, -1), normal[lies]
        slopes[lies, :, 2] = -np.einsum("sai,si->sa", slopes[lies, :, :2], tangent[:, :2]) / tangent[:, 2:]
        return nodal

    def _to_indenter(self, points: Array) -> tuple[Array, Array]:
        """Gap (n,) [mm] from points (n, 3) [mm] to the indenter, and its unit normals (n, 3) there."""
        assert self._contact is not None
        shape, pose = self._contact[:2]
        gap, normal = shape.gradient(pose.local(points))
        return gap, normal @ pose.rotation.T

    @property
    def normals(self) -> Array:
        """Unit normals (s, 3) of the smooth face at its nodes, out of the gel."""
        slopes = self._nodal[len(self.rest) :, :3].reshape(-1, 2, 3)
        normal = np.cross(slopes[:, 0], slopes[:, 1])
        return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))

    def at(self, xy: Array) -> Array:
        """Positions (n, 3) [mm] now of the points that rest at xy (n, 2) [mm]; nan outside the face."""
        xy = np.asarray(xy, dtype=float)
        found = self._between.at(xy, self._nodal)
        if found.shape[1] == 3:
            return found
        near = np.flatnonzero(found[:, 4] > MIN_GAP_WEIGHT)
        moved, opening, weight = np.split(found[near], [3, 4], axis=1)
        gap, normal = self._to_indenter(moved)
        by = np.minimum(weight[:, 0], 1.0) * (contact_rim.gaps(opening[:, 0]) - gap)
        found[near, :3] = moved + np.where(np.abs(normal[:, 2]) > MIN_TANGENT_NORMAL_Z, by, 0.0)[:, None] * normal
        return found[:, :3]

    def touched(self, xy: Array) -> Array:
        """Share of contact (n,), 0 to 1, at rest positions xy (n, 2) [mm], smooth between the nodes; nan outside."""
        if self._touching is None or not self._touching.any():
            return np.zeros(len(xy))
        at, each = self.facets.ravel(), np.repeat(self._touching, self.facets.shape[1])
        share = np.bincount(at, each) / np.bincount(at)
        found = self._between.at(np.asarray(xy, dtype=float), self._between.nodal(share[:, None]))
        return np.asarray(np.clip(found[:, 0], 0.0, 1.0))


def seen(mesh: "GelMesh", clear: int) -> GelSurface:
    """The face that the camera sees: the coated one, or the interface above the first `clear` layers."""
    if clear > mesh.layer.max():
        return GelSurface(mesh.points, mesh.facets["coated"])
    shared = np.intersect1d(mesh.cells[mesh.layer < clear], mesh.cells[mesh.layer >= clear])
    return GelSurface(mesh.points, shared[:, None])


def wrench(problem: Problem, state: State) -> tuple[Array, Array]:
    """Force [N] on the gel and its torque [N mm] about the origin of the sensor frame, each (3,)."""
    f = state.traction_force
    x = problem.contact.faces.at(state.x)
    return f.sum((0, 1)), np.cross(x, f).sum((0, 1))
