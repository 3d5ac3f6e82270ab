"""The coated face as a fine regular sheet over rest coordinates, so that markers move with it."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from tacgen.physics import faces
from tacgen.physics.runtime import call

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.geometry.outline import Pad
    from tacgen.sensor.model import Gel

    Floats = NDArray[np.float64]


OUTSIDE_SCALE = 1e-3  # scale of the part of a sheet outside a solid's outline: too small to be seen [-]
UNBOUNDED_BOX = (-np.inf, np.inf, -np.inf, np.inf)


class Surface(Protocol):
    """A deformed coated face: rest positions (n, 2) [mm] on it to current positions (n, 3) [mm]."""

    def at(self, xy: Any) -> Any:
        """Current positions (n, 3) [mm]."""


@runtime_checkable
class TouchedSurface(Surface, Protocol):
    """A face that tells where something touches it."""

    def touched(self, xy: Any) -> Any:
        """Share of contact (n,), 0 to 1, at rest positions (n, 2) [mm]."""


@dataclass(frozen=True)
class Untouched:
    """The untouched face that the camera sees: the inner side of the coating; by default a plane at z = 0."""

    skin: float = 0.0  # thickness of what is opaque, as a share of the gel's
    crown: float = 1.0  # the gel's thickness [mm]
    pad: "Pad | None" = None  # whose face it is

    @classmethod
    def of(cls, gel: "Gel") -> "Untouched":
        """That of a sensor's gel."""
        crown, clear = (sum(layer.thickness_mm for layer in layers) for layers in (gel.layers, gel.clear_layers))
        return cls(1 - clear / crown, crown, gel.pad)

    def at(self, xy: Any) -> "Floats":
        """Current positions (n, 3) [mm] of rest positions (n, 2) [mm]."""
        xy = np.asarray(xy, dtype=np.float64)
        return np.column_stack([xy, self.height(xy)])

    def height(self, xy: "Floats") -> "Floats":
        """z (n,) [mm] at rest positions (n, 2) [mm]; a number on a flat face, even where they are nan."""
        if self.pad is None or self.pad.flat:
            return np.full(len(xy), 0.0 - self.skin * self.crown)
        top = self.pad.top(*xy.T)
        return np.asarray(top - self.skin * (self.crown + top))


@dataclass(frozen=True)
class Sheet:
    """Nodes of a rectangular grid over the pad, row by row from the least y, and its triangles."""

    pad: "Pad"
    shape: tuple[int, int]  # rows, columns of nodes over the pad
    whole: bool = True  # gel covers the whole pad; otherwise the surface tells where it is, as on a solid
    box: tuple[float, ...] = UNBOUNDED_BOX  # x0, x1, y0, y1 [mm]: only the nodes in there

    @classmethod
    def over(cls, gel: "Gel", spacing: float, box: tuple[float, ...] = UNBOUNDED_BOX) -> "Sheet":
        """A sheet over the whole pad with nodes about `spacing` [mm] apart, or over the part of it in a box."""
        shape = round(gel.height_mm / spacing) + 1, round(gel.width_mm / spacing) + 1
        return cls(gel.pad, shape, gel.solid is None, box)

    @property
    def size(self) -> tuple[float, float]:
        """x, y extent [mm], centred on 0."""
        return self.pad.width, self.pad.height

    @cached_property
    def lines(self) -> tuple["Floats", "Floats"]:
        """x of the columns and y of the rows of nodes [mm]."""
        x, y = (np.linspace(-s / 2, s / 2, n) for s, n in zip(self.size, self.shape[::-1], strict=True))
        x0, x1, y0, y1 = self.box
        return x[(x >= x0) & (x <= x1)], y[(y >= y0) & (y <= y1)]

    @cached_property
    def rest(self) -> "Floats":
        """Rest positions of the nodes [mm], (nodes, 2)."""
        return np.stack(np.meshgrid(*self.lines), axis=-1).reshape(-1, 2)

    @cached_property
    def inside(self) -> "Floats":
        """Rest positions (nodes, 2) [mm], nodes in a cut-off corner moved to the pad's nearest point; read-only."""
        here = np.array(self.pad.drawn_in(self.rest))
        here.flags.writeable = False
        return here

    @cached_property
    def _outside(self) -> "NDArray[np.int64]":
        """Nodes (n,) in cut-off corners."""
        return np.flatnonzero((self.rest != self.inside).any(axis=1))

    @property
    def uv(self) -> "Floats":
        """Rest positions scaled to the unit square, (nodes, 2)."""
        return np.asarray(self.rest / self.size + 0.5)

    @cached_property
    def faces(self) -> "NDArray[np.int32]":
        """Triangles (2 cells, 3), wound so that their normals point at the camera (-z)."""
        columns, rows = map(len, self.lines)
        i = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
        a, b, c, d = i[:-1, :-1].ravel(), i[:-1, 1:].ravel(), i[1:, 1:].ravel(), i[1:, :-1].ravel()
        return np.concatenate([np.stack([a, c, b], 1), np.stack([a, d, c], 1)])

    def at(self, surface: Surface) -> "Floats":
        """Current positions of the nodes [mm], (nodes, 3). A node in a cut-off corner moves with the nearest point of
        the pad, so that `surface` is evaluated only where it exists."""
        pad, now = self.inside, np.array(surface.at(self.inside), dtype=np.float64)
        lost = np.isnan(now[:, 2])
        if lost.any():  # between the outline and what a mesh makes of it
            from scipy.spatial import cKDTree

            near = np.flatnonzero(~lost)[cKDTree(pad[~lost]).query(pad[lost])[1]]
            now[lost] = now[near]
            now[lost, :2] += (1.0 if self.whole else OUTSIDE_SCALE) * (pad[lost] - pad[near])
        now[self._outside, :2] += self.rest[self._outside] - pad[self._outside]
        return now

    def touched(self, surface: Surface) -> "Floats":
        """Share of contact at the nodes (nodes,); 0 on a face that does not tell."""
        if isinstance(surface, TouchedSurface):
            return np.asarray(np.nan_to_num(surface.touched(self.inside)))
        return np.zeros(len(self.rest))

    def normals(self, now: "Floats") -> "Floats":
        """Unit normals toward the camera (nodes, 3) of node positions (nodes, 3), by central differences."""
        return self._spans(now, True)

    def areas(self, now: "Floats") -> "Floats":
        """Area of the face per node [mm^2], (nodes,); at the sheet's edge twice that of the half cell there."""
        return np.asarray(np.linalg.norm(self._spans(now, False), axis=1))

    def _spans(self, now: "Floats", unit: bool) -> "Floats":
        columns, rows = map(len, self.lines)
        out = np.empty((len(now), 3))
        call(faces.spans, (1, rows, 1), now, rows, columns, 1, unit, out)
        return out
