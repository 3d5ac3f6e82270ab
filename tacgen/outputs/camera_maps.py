"""Maps of the face that the camera sees: height, normals, and gap to the indenter."""

from typing import TYPE_CHECKING

import numpy as np

from tacgen.geometry.analytic_sdf import Shape
from tacgen.geometry.pose import Pose
from tacgen.optics.drawn_face import DrawnFace
from tacgen.outputs.gel_surface import GelSurface

if TYPE_CHECKING:
    from tacgen.optics.camera import PinholeCamera

Array = np.ndarray


def in_view(surface: GelSurface, camera: "PinholeCamera") -> Array:
    """x0, x1, y0, y1 [mm] at rest of the part of a face that the camera may see.

    The part behind the picture at the height of the face's highest point, extended by the largest sideways motion.
    """
    (h, w), side = camera.shape, np.linspace(0, 1, 9)
    rim = [np.column_stack(xy) for k in (0, 1) for xy in ((w * side, 0 * side + k * h), (0 * side + k * w, h * side))]
    origins, rays = camera.rays(np.concatenate(rim))
    top = max(surface.now[:, 2].max(), surface.rest[:, 2].max())
    at = origins[:, :2] + rays[:, :2] * ((top - origins[:, 2:]) / rays[:, 2:])
    around = np.abs(surface.now - surface.rest)[:, :2].max(0) + 0.5
    return np.stack([at.min(0) - around, at.max(0) + around], 1).ravel()


class View(DrawnFace):
    """The deformed face behind each pixel, smooth between the mesh's nodes; nan where there is no face."""

    def height(self) -> Array:
        """z (h, w) [mm]."""
        return self.behind(self.nodes[:, 2:], outermost=True)[..., 0]

    def places(self) -> Array:
        """x and y (h, w, 2) [mm]."""
        return self.behind(self.nodes[:, :2], outermost=True)

    def normals(self) -> Array:
        """Unit normals (h, w, 3), out of the gel."""
        return self.behind(-self.facing, outermost=True, unit=True)

    def gap(self, shape: Shape, pose: Array) -> Array:
        """Distance (h, w) [mm] between the face and the indenter at a pose (4, 4).

        In contact it is within micrometres of zero where the face is drawn on the indenter (GelSurface.pressed);
        otherwise within a few hundredths of a millimetre of either sign: the barrier keeps the surfaces apart, the
        indenter is shrunk by the mean gap, and the face is smoothed. For a mesh it is a lower bound outside the grid
        of its distance (see geometry/sdf_grid).
        """
        return self.behind(shape.value(Pose.of(pose).local(self.nodes))[:, None], outermost=True)[..., 0]
