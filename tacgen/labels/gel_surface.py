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


class Surface:
    """The coated face of a mesh at rest and now, smooth between its nodes (C1, Clough & Tocher).

    rest, now (s, 3) [mm]; facets (f, a) numbers among them; nodes (s,) their numbers in the mesh.
    """

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

    @cached_property
    def _nodal(self) -> Array:
        return self._between.nodal(self.now - self.rest * (1.0, 1.0, 0.0))

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

        In contact it is within a few hundredths of zero, to either side: the barrier holds the faces apart, the
        indenter is shrunk for it in the mean, and the face is drawn smooth. Of a mesh, beyond the grid of its distance
        (see geometry/sdf_grid), it is a bound from below.
        """
        return self.behind(shape.distance(Pose.of(pose).local(self.nodes))[0][:, None], outermost=True)[..., 0]
