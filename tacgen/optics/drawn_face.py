"""A deformed face as a camera sees it; each property is computed once."""

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from tacgen.geometry.rasterize import Hits, blend, hits

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.optics.camera import PinholeCamera
    from tacgen.optics.surface_grid import Sheet, Surface

    Floats = NDArray[np.float64]


class DrawnFace:
    """One face on the nodes (n,) of a sheet, seen by a camera with `samples` x `samples` samples a pixel."""

    def __init__(self, sheet: "Sheet", surface: "Surface", camera: "PinholeCamera", samples: int = 1) -> None:
        self.sheet, self.surface, self.camera, self.samples = sheet, surface, camera, samples

    @cached_property
    def nodes(self) -> "Floats":
        """Current positions of the nodes (n, 3) [mm]."""
        return self.sheet.at(self.surface)

    @cached_property
    def screen(self) -> "Floats":
        """Positions of the nodes in the image (n, 2), in samples."""
        return np.asarray(self.camera.project(self.nodes) * self.samples)

    @cached_property
    def facing(self) -> "Floats":
        """Unit normals of the nodes toward the camera (n, 3)."""
        return self.sheet.normals(self.nodes)

    @property
    def folded(self) -> bool:
        """Whether parts of the face may hide others."""
        return self._nearest[2]

    def behind(self, values: "Floats", outermost: bool = False, unit: bool = False) -> "Floats":
        """Values (n, c) at the nodes, behind each sample (H, W, c), nan where there is no gel; where the face is folded
        of what is nearest to the camera, or of what is outermost; unit: scaled to length 1."""
        triangle, place, _ = self._outermost if outermost and self.folded else self._nearest
        return blend(self._behind(triangle, place), values, unit).reshape(*triangle.shape, -1)

    @property
    def hits(self) -> Hits:
        """The nearest triangles behind the samples, row by row."""
        return self._behind(*self._nearest[:2])

    def _behind(self, triangle: "NDArray[np.int32]", place: "Floats") -> Hits:
        return Hits(self.sheet.faces, triangle.ravel(), place.reshape(-1, 2))

    @cached_property
    def _nearest(self) -> "tuple[NDArray[np.int32], Floats, bool]":
        return self._hits(self.nodes[:, 2].copy())

    @cached_property
    def _outermost(self) -> "tuple[NDArray[np.int32], Floats, bool]":
        return self._hits(-self.nodes[:, 2])

    def _hits(self, near: "Floats") -> "tuple[NDArray[np.int32], Floats, bool]":
        h, w = self.camera.shape
        return hits(self.sheet.faces, self.screen, near, (h * self.samples, w * self.samples))
