"""Motion of points of the coating in the image, and whether the camera still sees them."""

from typing import TYPE_CHECKING

import numpy as np

from tacgen.geometry.rasterize import hidden
from tacgen.optics.drawn_face import DrawnFace

if TYPE_CHECKING:
    from tacgen.optics.camera import PinholeCamera
    from tacgen.optics.surface_grid import Surface

Array = np.ndarray
# distance in front of a point at which another part of the face hides it: the sheet's accuracy [mm]
HIDING_DISTANCE_MM = 0.05


class MaterialPoints:
    """Material points of the coating with rest positions (n, 2) [mm], seen through the refracting layers."""

    def __init__(self, rest: Array, surface: "Surface", camera: "PinholeCamera") -> None:
        """`surface` is the untouched face."""
        self.rest, self.camera = np.array(rest), camera
        self.rest.flags.writeable = False
        self.undisturbed = self._project(surface.at(self.rest))

    def at(self, face: DrawnFace) -> tuple[Array, Array]:
        """Current pixels (n, 2), nan outside the face; and whether the camera sees the point (n,)."""
        now = face.surface.at(self.rest)
        pixels = self._project(now)
        shown = within(pixels, self.camera)
        if face.folded:
            shown &= ~_behind(face, pixels, now[:, 2].copy())
        return pixels, shown

    def _project(self, points: Array) -> Array:
        there = np.isfinite(points).all(1)
        pixels = np.full((len(points), 2), np.nan)
        pixels[there] = self.camera.project(points[there])
        return pixels


class Flow:
    """The coating's flow over the image: of the material point that is behind the centre of each pixel, untouched.

    Between the nodes of the sheet it is linear.
    """

    def __init__(self, untouched: DrawnFace) -> None:
        (h, w), self.untouched = untouched.camera.shape, untouched
        self._centers = np.stack(np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5), -1)

    def at(self, face: DrawnFace) -> Array:
        """Pixels (h, w, 2), x right and y down, from where the point was to where it is now.

        nan where no gel was, or where the camera no longer sees the point.
        """
        if face.sheet != self.untouched.sheet:
            self.untouched = DrawnFace(face.sheet, self.untouched.surface, face.camera)
        flow = self.untouched.behind(face.screen - self.untouched.screen)
        pixels = self._centers + flow
        flow[~within(pixels, face.camera)] = np.nan
        if face.folded:
            depth = self.untouched.behind(face.nodes[:, 2:])
            flow[_behind(face, pixels.reshape(-1, 2), depth.ravel()).reshape(flow.shape[:2])] = np.nan
        return flow


def within(pixels: Array, camera: "PinholeCamera") -> Array:
    """Whether pixels (..., 2) are in the picture (...)."""
    h, w = camera.shape
    x, y = pixels[..., 0], pixels[..., 1]
    return np.asarray((x >= 0) & (x <= w) & (y >= 0) & (y <= h))


def _behind(face: DrawnFace, pixels: Array, depth: Array) -> Array:
    """Whether another part of a face stands before points of it (n,) at pixels (n, 2) and heights (n,)."""
    return np.asarray(
        hidden(
            face.sheet.faces, face.screen, face.nodes[:, 2].copy(), pixels, depth, face.camera.shape, HIDING_DISTANCE_MM
        )
    )
