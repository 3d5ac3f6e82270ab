"""What the camera sees of a face: its height, its normals and how far the indenter is from it."""

from typing import TYPE_CHECKING

import numpy as np

from tacgen.contact.barrier import Pose
from tacgen.geometry.analytic_sdf import Shape
from tacgen.labels.gel_surface import Surface
from tacgen.optics.drawn_face import DrawnFace
from tacgen.optics.surface_grid import unit

if TYPE_CHECKING:
    from tacgen.optics.camera import Camera

Array = np.ndarray


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
