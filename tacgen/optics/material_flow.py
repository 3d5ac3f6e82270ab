"""Surface -> where what is printed on the coating has moved to in the image, and whether the camera still sees it."""

from typing import TYPE_CHECKING

import numpy as np

from tacgen.optics.hidden import hidden
from tacgen.optics.rasterize import draw

if TYPE_CHECKING:
    from tacgen.optics.camera import Camera
    from tacgen.optics.surface_grid import Sheet, Surface

Array = np.ndarray
SLACK = 0.05  # [mm] that another part of the face must stand before a point to hide it: the sheet is that true to it


def behind(sheet: "Sheet", surface: "Surface", camera: "Camera") -> Array:
    """Where the coating's point behind each pixel rests (h, w, 2) [mm]; nan where there is no gel."""
    nodes = sheet.at(surface)
    return draw(sheet.faces, camera.project(nodes), nodes[:, 2].copy(), sheet.rest, camera.shape)


class Points:
    """Material points of the coating, by where they rest (n, 2) [mm], through the layers' refraction."""

    def __init__(self, rest: Array, sheet: "Sheet", surface: "Surface", camera: "Camera") -> None:
        """`surface` is the untouched face."""
        self.rest, self.sheet, self.camera = rest, sheet, camera
        self.undisturbed = self._project(surface.at(rest))

    def at(self, surface: "Surface") -> tuple[Array, Array]:
        """Pixels (n, 2) now, nan of what is not on the face; and whether the camera sees the point (n,): it is in the
        picture, and no other part of the face stands before it."""
        now, nodes, (h, w) = surface.at(self.rest), self.sheet.at(surface), self.camera.shape
        depth, own = nodes[:, 2].copy(), now[:, 2].copy()
        pixels = self._project(now)
        shown = np.asarray((pixels >= 0).all(1) & (pixels <= (w, h)).all(1))
        screen = self.camera.project(nodes)
        return pixels, shown & ~hidden(self.sheet.faces, screen, depth, pixels, own, (h, w), SLACK)

    def _project(self, points: Array) -> Array:
        there = np.isfinite(points).all(1)
        pixels = np.full((len(points), 2), np.nan)
        pixels[there] = self.camera.project(points[there])
        return pixels


class Flow:
    """The coating's flow over the image: of the material point that is behind the centre of each pixel, untouched."""

    def __init__(self, sheet: "Sheet", surface: "Surface", camera: "Camera") -> None:
        """`surface` is the untouched face."""
        rest = behind(sheet, surface, camera)
        self.points, self.shape = Points(rest.reshape(-1, 2), sheet, surface, camera), camera.shape

    def at(self, surface: "Surface") -> Array:
        """Pixels (h, w, 2), x right and y down, from where the point was to where it is now.

        nan where no gel was, or where the camera no longer sees the point.
        """
        pixels, seen = self.points.at(surface)
        flow = np.where(seen[:, None], pixels - self.points.undisturbed, np.nan)
        return np.asarray(flow.reshape(*self.shape, 2))
