"""Gels: what lies inside, how high the face is, which layer is where, and their closed surface as triangles."""

from dataclasses import dataclass

import numpy as np

from tacgen.fem.materials import Law

Array = np.ndarray


@dataclass(frozen=True)
class Layer:
    """A slab of one material; thickness [mm]."""

    thickness: float
    law: Law
    youngs_modulus: float  # [MPa]


@dataclass(frozen=True)
class Gel:
    """A pad bonded at its base, layers from base to face; width along x, height along y [mm].

    tip: the end in y (-1, +1) that is a semicircle over the whole width, 0 for none; radii: of the dome along x and y.
    """

    width: float
    height: float
    corner_radius: float
    layers: tuple[Layer, ...]
    tip: int = 0
    radii: tuple[float, float] = (np.inf, np.inf)

    @property
    def thickness(self) -> float:
        """At the crown [mm]."""
        return sum(layer.thickness for layer in self.layers)

    @property
    def flat(self) -> bool:
        """Whether the whole face lies at z = 0."""
        return bool(np.isinf(self.radii).all())

    @property
    def interfaces(self) -> Array:
        """Height of the face above each layer as a part of the gel's, the last layer's being 1 (layers,)."""
        return np.cumsum([layer.thickness for layer in self.layers]) / self.thickness

    def top(self, x: Array, y: Array) -> Array:
        """z of the untouched face [mm], 0 at the crown; x and y broadcast."""
        return np.asarray(0.0 - np.hypot(x * x / (2 * self.radii[0]), y * y / (2 * self.radii[1])))

    def at(self, part: float, xy: Array) -> Array:
        """Points (n, 3) above xy (n, 2) at a part of the gel's height there: layers share a dome's squeeze."""
        return np.column_stack([xy, part * (self.top(*xy.T) + self.thickness) - self.thickness])

    def layer_of(self, points: Array) -> Array:
        """Number of the layer that each of points (n, 3) lies in."""
        part = (points[:, 2] + self.thickness) / (self.top(*points[:, :2].T) + self.thickness)
        return np.searchsorted(self.interfaces[:-1], part).astype(np.int32)

    def contains(self, x: Array, y: Array) -> Array:
        """Whether points lie inside the outline; x and y broadcast."""
        if self.tip:
            r = self.width / 2
            past = self.tip * y - (self.height / 2 - r)  # beyond the semicircle's centre, toward the tip
            return np.asarray((-self.tip * y <= self.height / 2) & (np.hypot(x, np.maximum(past, 0)) <= r))
        r = self.corner_radius
        beyond = np.hypot(
            np.maximum(np.abs(x) - (self.width / 2 - r), 0), np.maximum(np.abs(y) - (self.height / 2 - r), 0)
        )
        within = (np.abs(x) <= self.width / 2) & (np.abs(y) <= self.height / 2) & (beyond <= max(r, 1e-12))
        return np.asarray(within)

    def outline(self, sag: float) -> Array:
        """Corners (n, 2) of a polygon around the pad, counter-clockwise; its sides lie within `sag` [mm] of arcs."""
        w, h = self.width / 2, self.height / 2
        if self.tip:
            arc = np.linspace(0, np.pi, _corners(np.pi, w, sag))
            end = np.column_stack([w * np.cos(arc), h - w + w * np.sin(arc)])
            whole = np.concatenate([[[-w, -h], [w, -h]], end])
            return whole if self.tip > 0 else -whole
        r = self.corner_radius
        arc = np.linspace(0, np.pi / 2, _corners(np.pi / 2, r, sag))
        quarter = np.column_stack([np.cos(arc), np.sin(arc)]) * r
        turns = [np.array([[c, -s], [s, c]]) for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))]
        centres = np.array([[w - r, h - r], [r - w, h - r], [r - w, r - h], [w - r, r - h]])
        return np.concatenate([quarter @ R.T + c for R, c in zip(turns, centres, strict=True)])

    def surface(self, step: float, sag: float) -> tuple[Array, Array, list[Array]]:
        """Vertices (n, 3), triangles (m, 3) of the closed surface wound outward, and those of each interface between
        layers, whose rims are edges of the sides. On a dome edges are about `step` long [mm]; for `sag` see outline."""
        from scipy.spatial import Delaunay

        rim = self.outline(sag)
        if not self.flat:
            rim = _divided(rim, step)
        xy = rim
        if not self.flat:
            x, y = (np.linspace(-s / 2, s / 2, int(np.ceil(s / step)) + 1) for s in (self.width, self.height))
            grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
            far = np.abs(grid[:, None] - rim).max(-1).min(1) > step / 2
            xy = np.concatenate([rim, grid[self.contains(*(grid * 1.02).T) & far]])
        flat = Delaunay(xy).simplices
        a, b, c = xy[flat[:, 0]], xy[flat[:, 1]], xy[flat[:, 2]]
        area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
        flat = np.where((area > 0)[:, None], flat, flat[:, [0, 2, 1]])[np.abs(area) > 1e-9]
        k, after = np.arange(len(rim)), np.roll(np.arange(len(rim)), -1)
        strip = np.concatenate(
            [np.stack([k, after, len(xy) + after], 1), np.stack([k, len(xy) + after, len(xy) + k], 1)]
        )
        sides = [strip + level * len(xy) for level in range(len(self.layers))]
        sheets = [flat + level * len(xy) for level in range(len(self.layers) + 1)]
        vertices = np.concatenate([self.at(part, xy) for part in (0.0, *self.interfaces)])
        return vertices, np.concatenate([sheets[0][:, [0, 2, 1]], sheets[-1], *sides]), sheets[1:-1]

    def patches(self, centres: Array, normals: Array, reach: float) -> dict[str, Array]:
        """Which facets of a mesh, of centres and outward normals (f, 3) within `reach` of the surface, are bonded and
        which are coated (f,)."""
        z, n = centres[:, 2], normals[:, 2]
        return {
            "bonded": (n < -0.5) & (z < reach - self.thickness),
            "coated": (n > 0.5) & (z > self.top(*centres[:, :2].T) - reach),
        }


def _corners(angle: float, radius: float, sag: float) -> int:
    """How many points on an arc, its ends among them, keep the chords within `sag` of it."""
    return 1 + int(np.ceil(angle / (2 * np.arccos(1 - min(sag, radius) / radius)))) if radius else 1


def _divided(rim: Array, step: float) -> Array:
    """A closed polygon with corners at most `step` apart."""
    out = []
    for a, b in zip(rim, np.roll(rim, -1, 0), strict=True):
        pieces = max(1, int(np.ceil(np.linalg.norm(b - a) / step)))
        out.append(a + (b - a) * (np.arange(pieces) / pieces)[:, None])
    return np.concatenate(out)
