"""States -> Fields: the net wrench, the deformed coated face, and its height, normals and gap as the camera sees them.

Pressure and traction are in maps, stress in the gel in stress: a scene pays for what it asks for.
"""

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from tacgen.contact.barrier import Pose
from tacgen.geometry.analytic_sdf import Shape
from tacgen.optics.rasterize import draw
from tacgen.solve import Problem, State

if TYPE_CHECKING:
    from tacgen.optics.camera import Camera
    from tacgen.optics.surface_grid import Sheet
    from tacgen.scene.mesh import Mesh

Array = np.ndarray


class Surface:
    """The coated face of a mesh at rest and now, smooth between its nodes (C1, Clough & Tocher).

    rest, now (s, 3) [mm]; facets (f, a) numbers among them; nodes (s,) their numbers in the mesh.
    """

    def __init__(self, points: Array, facets: Array) -> None:
        from scipy.spatial import Delaunay

        self.nodes = np.unique(facets)
        self.facets = np.searchsorted(self.nodes, facets)
        self.rest = self.now = points[self.nodes]
        self._plan = Delaunay(self.rest[:, :2])

    def moved(self, x: Array) -> "Surface":
        """The same face of the mesh at nodal positions x (n, 3)."""
        new = object.__new__(Surface)
        new.nodes, new.facets, new.rest, new._plan = self.nodes, self.facets, self.rest, self._plan
        new.now = x[self.nodes]
        return new

    @cached_property
    def _smooth(self) -> "object":
        from scipy.interpolate import CloughTocher2DInterpolator

        return CloughTocher2DInterpolator(self._plan, self.now - self.rest * (1.0, 1.0, 0.0))

    def at(self, xy: Array) -> Array:
        """Positions (n, 3) [mm] now of the points that rest at xy (n, 2) [mm]; nan outside the face."""
        xy = np.asarray(xy, dtype=float)
        moved = self._smooth(xy) if len(xy) else np.zeros((0, 3))  # type: ignore[operator]
        return np.asarray(moved + np.column_stack([xy, np.zeros(len(xy))]))


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


class View:
    """The deformed face behind each pixel of the camera, smooth between the mesh's nodes; nan where there is none."""

    def __init__(self, sheet: "Sheet", surface: Surface, camera: "Camera") -> None:
        self.sheet, self.camera = sheet, camera
        self.now = sheet.at(surface)
        self._screen = camera.project(self.now)

    def height(self) -> Array:
        """z (h, w) [mm]."""
        return self._seen(self.now[:, 2:])[..., 0]

    def normals(self) -> Array:
        """Unit normals (h, w, 3), out of the gel."""
        mean = self._seen(-self.sheet.normals(self.now))
        return np.asarray(mean / np.linalg.norm(mean, axis=-1, keepdims=True))

    def gap(self, shape: Shape, pose: Array) -> Array:
        """How far (h, w) [mm] the indenter at a pose (4, 4) is from the face there.

        In contact it is within a few hundredths of zero, to either side: the barrier holds the faces apart, the
        indenter is shrunk for it in the mean, and the face is drawn smooth. Of a mesh, beyond the grid of its distance
        (see geometry/sdf_grid), it is a bound from below.
        """
        return self._seen(shape.distance(Pose.of(pose).local(self.now))[0][:, None])[..., 0]

    def _seen(self, values: Array) -> Array:
        return draw(self.sheet.faces, self._screen, -self.now[:, 2], values, self.camera.shape)
