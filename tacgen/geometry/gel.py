"""Gels: outline, height of the face, layers, and the closed surface as triangles."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from tacgen.base.errors import UserError
from tacgen.fem.materials import Law
from tacgen.geometry import mesh_file, mesh_import
from tacgen.geometry.outline import Pad

Array = np.ndarray
SHEET_SPACING_RATIO = 0.024  # grid spacing of the interfaces between a solid's layers, over the longer side [-]
FACE_PIXEL_RATIO = 0.004  # grid spacing on which overhangs of a solid's face are detected, over the longer side [-]
# parts of a solid's back belong together if one begins so little above the highest point of another [mm]
BACK_SEAM_MM = 0.02
# bonded part of a solid's footprint [-]; a gel that is held by less is askew on its plate, or loose
MIN_BONDED_SHARE = 0.5
LOOSE_GEL_MESSAGE = (
    "{:.2g} of its footprint would be bonded to the plate, and at least half must be: does it lie askew, or is its back"
    " steep or in pieces? Say gel.solid.bonded_deg, or bonded_mm"
)
FACET_NORMAL_TOL = np.radians(10)  # of the normals of a mesh's facets [rad]


@dataclass(frozen=True)
class GelLayer:
    """A layer of one material; thickness [mm]."""

    thickness: float
    law: Law
    youngs_modulus: float  # [MPa]
    prony: tuple[tuple[float, float], ...] = ()  # g and tau [s] of each term, see fem/viscoelasticity


@dataclass(frozen=True)
class GelBody(Pad):
    """A pad that is bonded at its base; layers from base to face."""

    layers: tuple[GelLayer, ...] = field(kw_only=True)

    @property
    def thickness(self) -> float:
        """Thickness at the crown [mm]."""
        return sum(layer.thickness for layer in self.layers)

    @property
    def side(self) -> float:
        """The longer side [mm]."""
        return max(self.width, self.height)

    @property
    def interfaces(self) -> Array:
        """Height of the upper side of each layer over the gel's thickness (layers,); the last is 1 [-]."""
        return np.cumsum([layer.thickness for layer in self.layers]) / self.thickness

    def at_height(self, part: float, xy: Array) -> Array:
        """Points (n, 3) at xy (n, 2) and a fraction `part` of the local height: a dome scales all layers."""
        return np.column_stack([xy, part * (self.top(*xy.T) + self.thickness) - self.thickness])

    def layer_of(self, points: Array) -> Array:
        """Number of the layer (n,) in which points (n, 3) lie."""
        above = [points[:, 2] > self.at_height(float(part), points[:, :2])[:, 2] for part in self.interfaces[:-1]]
        return np.sum(above, axis=0, dtype=np.int32) * np.ones(len(points), np.int32)

    def surface(self, step: float, sag: float) -> tuple[Array, Array, list[Array]]:
        """Vertices (n, 3) and triangles (m, 3) of the closed surface, oriented outward, and the triangles of each
        interface between layers. On a dome edges are about `step` long; for `sag` see outline. Both are relative to the
        longer side."""
        from scipy.spatial import Delaunay, cKDTree

        step, rim = step * self.side, self.outline(sag * self.side)
        if not self.flat:
            rim = _subdivided(rim, step)
        xy = rim
        if not self.flat:
            x, y = (np.linspace(-s / 2, s / 2, int(np.ceil(s / step)) + 1) for s in (self.width, self.height))
            grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
            far = cKDTree(rim).query(grid, p=np.inf)[0] > step / 2
            xy = np.concatenate([rim, grid[self.contains(*(grid * 1.02).T) & far]])
        flat = Delaunay(xy).simplices
        area = _area_upward(xy, flat)
        flat = np.where((area > 0)[:, None], flat, flat[:, [0, 2, 1]])[np.abs(area) > 5e-13 * self.side**2]
        k, after = np.arange(len(rim)), np.roll(np.arange(len(rim)), -1)
        low, high = np.stack([k, after, len(xy) + after], 1), np.stack([k, len(xy) + after, len(xy) + k], 1)
        strip = np.concatenate([low, high])
        sides = [strip + level * len(xy) for level in range(len(self.layers))]
        sheets = [flat + level * len(xy) for level in range(len(self.layers) + 1)]
        vertices = np.concatenate([self.at_height(part, xy) for part in (0.0, *self.interfaces)])
        return vertices, np.concatenate([sheets[0][:, [0, 2, 1]], sheets[-1], *sides]), sheets[1:-1]

    def patches(self, corners: Array, normals: Array, reach: float) -> dict[str, Array]:
        """Which facets of a mesh are bonded and which are coated (f,), from their corners (f, 3, 3) and outward normals
        (f, 3); facets are within `reach` [mm] of the surface."""
        (x, y, z), n = corners.mean(1).T, normals[:, 2]
        return {"bonded": (n < -0.5) & (z < reach - self.thickness), "coated": (n > 0.5) & (z > self.top(x, y) - reach)}


@dataclass(frozen=True)
class SolidGel(GelBody):
    """A gel of any shape with its highest point at z = 0.

    Bonded at its `back`: the part around the lowest point whose normals are within the angle `bonded` [rad] of -z, or,
    if `held` is given, all up to this height [mm] above the lowest point. Coated where the normal is within the angle
    `coated` [rad] of z; this face must have no overhang, as seen by the camera below.
    """

    solid: mesh_file.SolidMesh | None = None
    bonded: float = 0.0
    held: float | None = None
    coated: float = 0.0

    @property
    def flat(self) -> bool:
        return False

    @cached_property
    def face(self) -> tuple[Array, Array]:
        """Vertices and triangles of the coated face: the highest connected patch of the triangles that face up.

        Raises:
            UserError: there is none, or it has an overhang.
        """
        v, t, _ = self.surface(0, 0)
        t = t[_facing(v, t, 1, self.coated) & (v[t, 2].max(1) > (self.held or 0.0) - self.thickness)]
        if len(t):
            patch = _connected(t, len(v))
            t = t[patch == patch[v[t, 2].max(1).argmax()]]
        name = self.solid.name if self.solid else "gel"
        if not len(t):
            angle = f"gel.solid.coated_deg, {np.degrees(self.coated):g}"
            raise UserError(f"{name}: no part of it faces up to within {angle}")
        pixel = FACE_PIXEL_RATIO * self.side
        screen, shape = (v[:, :2] - v[:, :2].min(0)) / pixel, np.ceil(np.ptp(v[:, :2], axis=0) / pixel).astype(int)
        faces, size = t.astype(np.int32), (int(shape[1]), int(shape[0]))
        from tacgen.geometry.rasterize import nearest  # compiled: gels that are pads do not need it

        high, low = (sign * nearest(faces, screen, sign * v[:, 2], size) for sign in (-1.0, 1.0))
        folded = np.argwhere(high - low > pixel * 2 * np.tan(self.coated))
        if len(folded):
            x, y = v[:, :2].min(0) + (folded[len(folded) // 2][::-1] + 0.5) * pixel
            raise UserError(
                f"{name}: its coated face lies over itself at ({x:.3g}, {y:.3g}), which no camera below sees:"
                " gel.solid.coated_deg says what is coated"
            )
        return v, t

    @cached_property
    def back(self) -> tuple[Array, Array]:
        """Vertices and triangles of the bonded face. Raises UserError: that is too little."""
        assert self.solid is not None
        v, t, _ = self.surface(0, 0)
        if why := held_by(self.solid, self.bonded, self.held)[1]:
            raise UserError(f"{self.solid.name}: {why}")
        return v, t[bonded(v, t, self.bonded, self.held)]

    @cached_property
    def bonded_share(self) -> float:
        """Part of the footprint that is bonded [-]."""
        v, t, _ = self.surface(0, 0)
        return bonded_share(v, t, self.back[1])

    def top(self, x: Array | float, y: Array | float) -> Array:
        """z of the untouched face [mm]; outside its outline that of the nearest point."""
        x, y = np.broadcast_arrays(x, y)
        z, _ = mesh_import.above(*self.face, np.column_stack([x.ravel(), y.ravel()]))
        return z.reshape(x.shape)

    def contains(self, x: Array | float, y: Array | float, slack: float = 0.0) -> Array:
        """Whether points lie within the coated face's outline, or at most `slack` [mm] outside."""
        x, y = np.broadcast_arrays(x, y)
        _, beside = mesh_import.above(*self.face, np.column_stack([x.ravel(), y.ravel()]))
        return (beside < slack + 1e-9).reshape(x.shape)

    def drawn_in(self, xy: Array) -> Array:
        """The points (n, 2) of the coated face, as seen from above, that are closest to points (n, 2)."""
        v, t = self.face
        return mesh_import.nearest(v * [1.0, 1.0, 0.0], t, np.column_stack([xy, np.zeros(len(xy))]))[:, :2]

    def surface(self, step: float, sag: float) -> tuple[Array, Array, list[Array]]:
        """Vertices and triangles of the file; the interfaces between layers extend beyond them on all sides."""
        assert self.solid is not None
        v, t = self.solid.vertices, self.solid.triangles
        v = v - [0.0, 0.0, v[:, 2].max()]
        if not step or not self.sheets:
            return v, t, []
        before = np.cumsum([len(v), *(len(points) for points, _ in self.sheets)])
        whole = np.concatenate([v, *(points for points, _ in self.sheets)])
        return whole, t, [faces + start for (_, faces), start in zip(self.sheets, before, strict=False)]

    @cached_property
    def sheets(self) -> list[tuple[Array, Array]]:
        """Vertices and triangles of the interfaces between layers, from the base up, on a grid wider than the gel."""
        assert self.solid is not None
        flat, step = self.solid.vertices[:, :2], SHEET_SPACING_RATIO * self.side
        ends = zip(flat.min(0) - 2 * step, flat.max(0) + 2 * step, strict=True)
        x, y = (np.linspace(a, b, int(np.ceil((b - a) / step)) + 1) for a, b in ends)
        xy = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
        number = np.arange(len(xy)).reshape(len(x), len(y))
        a, b, c, d = (piece.ravel() for piece in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
        faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
        return [(super(SolidGel, self).at_height(float(part), xy), faces) for part in self.interfaces[:-1]]

    def at_height(self, part: float, xy: Array) -> Array:
        """As for a pad; on an interface between layers, on its triangles, since these are meshed."""
        for known, sheet in zip(self.interfaces[:-1], self.sheets if 0 < part < 1 else [], strict=False):
            if part == known:
                return np.column_stack([xy, mesh_import.above(*sheet, xy)[0]])
        return super().at_height(part, xy)

    def patches(self, corners: Array, normals: Array, reach: float) -> dict[str, Array]:
        centres = corners.mean(1)

        def near(face: tuple[Array, Array]) -> Array:
            return np.asarray(np.linalg.norm(mesh_import.nearest(*face, centres) - centres, axis=1) < reach)

        if self.held is None:
            held = (-normals[:, 2] > np.cos(min(self.bonded + FACET_NORMAL_TOL, np.pi / 2))) & near(self.back)
        else:
            held = np.all(corners[..., 2] < self.held + reach - self.thickness, axis=1)
        return {"bonded": held, "coated": (normals[:, 2] > np.cos(self.coated)) & ~held & near(self.face)}


def bonded(vertices: Array, triangles: Array, angle: float, held: float | None) -> Array:
    """Which triangles (t,) of a closed surface a plate below it holds, see `SolidGel`.

    Of the connected parts that face down, those that reach the lowest one, or follow on it without a step: a back that
    a groove divides is held on both sides of it, and the underside of an overhang above is not.
    """
    z = vertices[triangles, 2]
    if held is not None:
        return np.asarray(z.max(1) <= vertices[:, 2].min() + held + 1e-9)
    down = np.flatnonzero(_facing(vertices, triangles, -1, angle))
    if not len(down):
        return np.zeros(len(triangles), bool)
    part = _connected(triangles[down], len(vertices))
    lowest, highest = np.full(part.max() + 1, np.inf), np.full(part.max() + 1, -np.inf)
    np.minimum.at(lowest, part, z[down].min(1))
    np.maximum.at(highest, part, z[down].max(1))
    upward = np.argsort(lowest, kind="stable")
    reached = np.maximum.accumulate(highest[upward])
    step = lowest[upward][1:] > reached[:-1] + BACK_SEAM_MM
    ours = upward[: 1 + int(step.argmax())] if step.any() else upward
    mask = np.zeros(len(triangles), bool)
    mask[down] = np.isin(part, ours)
    return mask


def held_by(solid: mesh_file.SolidMesh, angle: float, held: float | None) -> tuple[float, str]:
    """Part of a solid's footprint that is bonded [-], and why that is too little, or ""."""
    v, t = solid.vertices, solid.triangles
    ours = bonded(v, t, angle, held)
    share, bodies = bonded_share(v, t, t[ours]), np.unique(solid.body)
    if share < MIN_BONDED_SHARE:
        return share, LOOSE_GEL_MESSAGE.format(share)
    theirs = np.isin(solid.body, solid.body[ours])
    first = np.array([v[t[solid.body == body][0, 0]] for body in np.setdiff1d(bodies, solid.body[ours])])
    if len(first) and (loose := int((~mesh_import.inside(v, t[theirs], first)).sum())):
        text = "{} of its {} bodies would not be bonded to the plate: unite them in a mesh editor"
        return share, text.format(loose, len(bodies))
    return share, ""


def bonded_share(vertices: Array, triangles: Array, held: Array) -> float:
    """Part of a closed surface's footprint that triangles `held` (s, 3) cover, both seen from the plate [-].

    The footprint's area is that of what faces up, or of its convex hull where overhangs make that smaller.
    """
    from scipy.spatial import ConvexHull

    up, below = (_area_upward(vertices, t) for t in (triangles, held))
    return float(abs(below.sum()) / min(up[up > 0].sum(), ConvexHull(vertices[:, :2]).volume))


def _area_upward(v: Array, t: Array) -> Array:
    """Area (t,) of triangles of points (n, 2 or 3) as seen from above, negative where they face down [mm^2]."""
    a, b, c = (v[t[:, k], :2] for k in range(3))
    return np.asarray(((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2)


def _facing(v: Array, t: Array, sign: int, angle: float) -> Array:
    """Which triangles (t,) have normals within an angle [rad] of z times `sign`."""
    normal = np.cross(v[t[:, 1]] - v[t[:, 0]], v[t[:, 2]] - v[t[:, 0]])
    return np.asarray(sign * normal[:, 2] > np.cos(angle) * np.linalg.norm(normal, axis=1))


def _connected(t: Array, vertices: int) -> Array:
    """The connected part (t,) to which each triangle belongs; those that share a vertex are connected."""
    own = np.repeat(np.arange(len(t)), 3)
    return mesh_file.connected(own, len(t) + t.ravel(), len(t) + vertices)[: len(t)]


def _subdivided(rim: Array, step: float) -> Array:
    """A closed polygon divided so that its corners are at most `step` apart."""
    out = []
    for a, b in zip(rim, np.roll(rim, -1, 0), strict=True):
        pieces = max(1, int(np.ceil(np.linalg.norm(b - a) / step)))
        out.append(a + (b - a) * (np.arange(pieces) / pieces)[:, None])
    return np.concatenate(out)
