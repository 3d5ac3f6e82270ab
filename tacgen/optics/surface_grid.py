"""The coated face as a fine regular sheet over rest coordinates, so that what is printed on it moves with it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.optics.description import Gel

    Floats = NDArray[np.float64]


BEYOND = 1e-3  # what is beyond the outline of a solid shrinks to so much, at its edge, and shows nothing


class Surface(Protocol):
    """A deformed coated face: rest positions (n, 2) [mm] on it to current positions (n, 3) [mm]."""

    def at(self, xy: Any) -> Any:
        """Current positions (n, 3) [mm]."""


@dataclass(frozen=True)
class Untouched:
    """What the camera sees of an untouched gel: the inner side of its coating; a plane at z = 0 if nothing is said."""

    skin: float = 0.0  # thickness of what is opaque, as a share of the gel's
    crown: float = 1.0  # the gel's thickness [mm]
    radii: tuple[float, float] = (np.inf, np.inf)  # of the dome [mm]

    @classmethod
    def of(cls, gel: "Gel") -> "Untouched":
        """That of a sensor's gel."""
        crown, clear = (sum(layer.thickness_mm for layer in layers) for layers in (gel.layers, gel.clear_layers))
        dome = (np.inf, np.inf) if gel.dome is None else (gel.dome.radius_x_mm, gel.dome.radius_y_mm)
        return cls(1 - clear / crown, crown, dome)

    def at(self, xy: Any) -> "Floats":
        """Current positions (n, 3) [mm] of rest positions (n, 2) [mm]."""
        xy = np.asarray(xy, dtype=np.float64)
        drop = np.hypot(*(xy**2 / (2 * np.array(self.radii))).T)
        return np.column_stack([xy, 0.0 - drop - self.skin * (self.crown - drop)])


@dataclass(frozen=True)
class Sheet:
    """Nodes of a rectangular grid over the pad, row by row from the least y, and its triangles."""

    size: tuple[float, float]  # x, y extent [mm], centred on 0
    corner: float  # radius of the pad's rounded corners [mm]
    shape: tuple[int, int]  # rows, columns of nodes
    tip: int = 0  # the end in y (-1, +1) that is a semicircle over the whole width; 0: none
    whole: bool = True  # there is gel on all of that; else only where a surface says so, as on a solid of any outline

    @classmethod
    def over(cls, gel: "Gel", spacing: float) -> "Sheet":
        """A sheet over the whole pad with nodes about `spacing` [mm] apart."""
        size = (gel.width_mm, gel.height_mm)
        shape = round(size[1] / spacing) + 1, round(size[0] / spacing) + 1
        return cls(size, gel.corner_radius_mm, shape, gel.tip, gel.solid is None)

    @property
    def rest(self) -> "Floats":
        """Rest positions of the nodes [mm], (nodes, 2)."""
        x, y = (np.linspace(-s / 2, s / 2, n) for s, n in zip(self.size, self.shape[::-1], strict=True))
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)

    @property
    def uv(self) -> "Floats":
        """Rest positions scaled to the unit square, (nodes, 2)."""
        return np.asarray(self.rest / self.size + 0.5)

    @property
    def faces(self) -> "NDArray[np.uint32]":
        """Triangles (2 cells, 3), wound so that their normals point at the camera (-z)."""
        i = np.arange(self.shape[0] * self.shape[1], dtype=np.uint32).reshape(self.shape)
        a, b, c, d = i[:-1, :-1].ravel(), i[:-1, 1:].ravel(), i[1:, 1:].ravel(), i[1:, :-1].ravel()
        return np.concatenate([np.stack([a, c, b], 1), np.stack([a, d, c], 1)])

    def at(self, surface: Surface) -> "Floats":
        """Current positions of the nodes [mm], (nodes, 3). A node in a cut-off corner rides with the nearest point of
        the pad, so that `surface` is only asked where it exists."""
        rest = self.rest
        pad = self._rounded(rest) if self.tip else self._cut(rest)
        now = np.array(surface.at(pad), dtype=np.float64)
        lost = np.isnan(now[:, 2])
        if lost.any():  # between the outline and what a mesh makes of it
            from scipy.spatial import cKDTree

            near = np.flatnonzero(~lost)[cKDTree(pad[~lost]).query(pad[lost])[1]]
            now[lost] = now[near]
            now[lost, :2] += (1.0 if self.whole else BEYOND) * (pad[lost] - pad[near])
        now[:, :2] += rest - pad
        return now

    def _rounded(self, rest: "Floats") -> "Floats":
        """Nodes (n, 2) beyond the semicircular end drawn in to it."""
        radius = self.size[0] / 2
        out = rest - (0.0, self.tip * (self.size[1] / 2 - radius))
        far = np.linalg.norm(out, axis=1)
        beyond = (self.tip * out[:, 1] > 0) & (far > radius)
        return np.asarray(rest + np.where(beyond, radius / np.maximum(far, 1e-300) - 1.0, 0.0)[:, None] * out)

    def _cut(self, rest: "Floats") -> "Floats":
        """Nodes (n, 2) in the cut-off corners drawn in to their arcs."""
        core = np.array(self.size) / 2 - self.corner
        inner = np.clip(rest, -core, core)
        out = rest - inner
        far = np.linalg.norm(out, axis=1)
        shrink = (
            np.minimum(1.0, self.corner * (1 - 1e-9) / np.maximum(far, 1e-300)) if self.corner else np.ones(len(far))
        )
        return np.asarray(inner + out * shrink[:, None])

    def normals(self, now: "Floats") -> "Floats":
        """Unit normals toward the camera (nodes, 3) of node positions (nodes, 3), by central differences."""
        n = self._spans(now)
        return np.asarray(n / np.linalg.norm(n, axis=1, keepdims=True))

    def areas(self, now: "Floats") -> "Floats":
        """What each node stands for of the face [mm^2], (nodes,); twice as much at an edge, where half of it is off."""
        return np.asarray(np.linalg.norm(self._spans(now), axis=1))

    def _spans(self, now: "Floats") -> "Floats":
        grid = now.reshape(*self.shape, 3)
        du, dv = np.gradient(grid, axis=1), np.gradient(grid, axis=0)
        return np.asarray(np.cross(dv, du).reshape(-1, 3))
