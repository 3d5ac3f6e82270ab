"""States -> Fields: the net wrench, the deformed coated face, and its height, normals and gap as the camera sees them.

Pressure and traction are in maps, stress in the gel in stress: a scene pays for what it asks for.
"""

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from tacgen.contact.barrier import Pose
from tacgen.geometry.analytic_sdf import Shape
from tacgen.geometry.clough_tocher import CloughTocher
from tacgen.optics.drawn_face import DrawnFace
from tacgen.optics.surface_grid import unit
from tacgen.solve import Problem, State

if TYPE_CHECKING:
    from tacgen.optics.camera import Camera
    from tacgen.scene.mesh import Mesh

Array = np.ndarray
MIN_EDGES = 3  # an indenter's smallest radius over the mesh's edge from which a face is drawn lying on it [-]
STEEPEST = 0.2  # cosine to z of an indenter's normal below which a face cannot be held tangent to it


class Surface:
    """The coated face of a mesh at rest and now, smooth between its nodes (C1, Clough & Tocher).

    rest, now (s, 3) [mm]; facets (f, a) numbers among them; nodes (s,) their numbers in the mesh.
    """

    _contact: tuple[Shape, Pose, Array] | None = None  # the indenter, and which points of the facets touch it (f, q)

    def __init__(self, points: Array, facets: Array) -> None:
        self.nodes = np.unique(facets)
        self.facets = np.searchsorted(self.nodes, facets)
        self.rest = self.now = points[self.nodes]
        self._between = CloughTocher(self.rest[:, :2])

    def moved(self, x: Array) -> "Surface":
        """The same face of the mesh at nodal positions x (n, 3)."""
        new = object.__new__(Surface)
        new.nodes, new.facets, new.rest, new._between = self.nodes, self.facets, self.rest, self._between
        new.now = x[self.nodes]
        return new

    def pressed(self, problem: Problem, state: State) -> "Surface":
        """The same face in a solved state; of a touched one, what lies on the indenter follows it between the nodes.

        Cells alone would show as facets within a contact and as ripples around it. They have to be finer than the
        indenter's bends.
        """
        new, shape = self.moved(state.x), problem.contact.shape
        if self.facets.shape[1] > 1 and shape.smallest_radius >= MIN_EDGES * problem.edge:
            new._contact = shape, Pose.of(state.pose), state.normal_force > 0
        return new

    @cached_property
    def _nodal(self) -> Array:
        """Displacements, with z for the third, and their slopes, as CloughTocher.nodal has them."""
        if self._contact is None:
            return self._between.nodal(self.now - self.rest * (1.0, 1.0, 0.0))
        (shape, pose, touched), s = self._contact, len(self.rest)
        gap, normal, _ = shape.distance(pose.local(self.now))
        normal = normal @ pose.rotation.T
        most = np.repeat(touched.mean(1) - 0.5, self.facets.shape[1])  # of the points around a node are touched
        lies = (np.bincount(self.facets.ravel(), most) >= 0) & (np.abs(normal[:, 2]) > STEEPEST)
        placed = self.now - np.where(lies, gap, 0.0)[:, None] * normal
        nodal = self._between.nodal(placed - self.rest * (1.0, 1.0, 0.0))
        slopes, tangent = nodal[s:].reshape(s, 2, 3), normal[lies]
        stretch = slopes[lies, :, :2] + np.eye(2)
        slopes[lies, :, 2] = -np.einsum("sai,si->sa", stretch, tangent[:, :2]) / tangent[:, 2:]
        return nodal

    def at(self, xy: Array) -> Array:
        """Positions (n, 3) [mm] now of the points that rest at xy (n, 2) [mm]; nan outside the face."""
        moved = self._between.at(np.asarray(xy, dtype=float), self._nodal)
        moved[:, :2] += xy
        return moved


def seen(mesh: "Mesh", clear: int) -> Surface:
    """The face that a camera sees of a mesh: the coated one, or where the first `clear` layers meet the opaque rest."""
    if clear > mesh.layer.max():
        return Surface(mesh.points, mesh.facets["coated"])
    shared = np.intersect1d(mesh.cells[mesh.layer < clear], mesh.cells[mesh.layer >= clear])
    return Surface(mesh.points, shared[:, None])


def wrench(problem: Problem, state: State) -> tuple[Array, Array]:
    """Force [N] on the gel and its torque [N mm] about the origin of the sensor frame, each (3,)."""
    f = state.traction_force
    x = problem.contact.faces.at(state.x)
    return f.sum((0, 1)), np.cross(x, f).sum((0, 1))


def in_view(surface: Surface, camera: "Camera") -> Array:
    """x0, x1, y0, y1 [mm] around where what the camera may see of a face rests.

    That is what is behind the picture where the face is highest, and as far around as its nodes have moved sideways.
    """
    (h, w), side = camera.shape, np.linspace(0, 1, 9)
    rim = [np.column_stack(xy) for k in (0, 1) for xy in ((w * side, 0 * side + k * h), (0 * side + k * w, h * side))]
    origins, rays = camera.rays(np.concatenate(rim))
    top = max(surface.now[:, 2].max(), surface.rest[:, 2].max())
    at = origins[:, :2] + rays[:, :2] * ((top - origins[:, 2:]) / rays[:, 2:])
    around = np.abs(surface.now - surface.rest)[:, :2].max(0) + 0.5
    return np.stack([at.min(0) - around, at.max(0) + around], 1).ravel()


class View(DrawnFace):
    """The deformed face behind each pixel of the camera, smooth between the mesh's nodes; nan where there is none."""

    def height(self) -> Array:
        """z (h, w) [mm]."""
        return self.behind(self.nodes[:, 2:], outermost=True)[..., 0]

    def normals(self) -> Array:
        """Unit normals (h, w, 3), out of the gel."""
        mean = self.behind(-self.facing, outermost=True)
        return np.asarray(unit(mean.reshape(-1, 3)).reshape(mean.shape))

    def gap(self, shape: Shape, pose: Array) -> Array:
        """How far (h, w) [mm] the indenter at a pose (4, 4) is from the face there.

        In contact it is within micrometres of zero where the face is drawn lying on the indenter (Surface.pressed), and
        else within a few hundredths, to either side: the barrier holds the faces apart, the indenter is shrunk for it
        in the mean, and the face is drawn smooth. Of a mesh, beyond the grid of its distance
        (see geometry/sdf_grid), it is a bound from below.
        """
        return self.behind(shape.distance(Pose.of(pose).local(self.nodes))[0][:, None], outermost=True)[..., 0]
