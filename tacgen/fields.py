"""States -> Fields: stress in the gel, pressure and traction on the image grid, markers in the gel, net wrench.

Each function makes one of them and none calls another's work, so a scene pays for what it asks for.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from tacgen.fem.elements import triangles as pieces
from tacgen.optics.raster import draw
from tacgen.solve import Problem, State

if TYPE_CHECKING:
    from tacgen.optics.layers import Camera
    from tacgen.optics.sheet import Sheet

Array = np.ndarray
RIM = (
    0.4  # share of points in contact at the rim of the contact map: less than half, for the rim passes outside of them
)
VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))  # xx yy zz yz xz xy


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


def wrench(problem: Problem, state: State) -> tuple[Array, Array]:
    """Force [N] on the gel and its torque [N mm] about the origin of the sensor frame, each (3,)."""
    f = state.traction_force
    x = problem.contact.faces.at(state.x)
    return f.sum((0, 1)), np.cross(x, f).sum((0, 1))


@dataclass(frozen=True)
class Stress:
    """Cauchy stress [MPa] in the order xx yy zz yz xz xy: per element (e, 6), its volume mean, and per node (n, 6)."""

    element: Array
    node: Array


def stress(problem: Problem, x: Array) -> Stress:
    """Cauchy stress from the constitutive law at the integration points.

    A node's value is the lumped L2 projection over the elements of its outermost layer, so that no average crosses an
    interface between layers.
    """
    mesh = problem.mesh
    element = np.zeros((len(mesh.cells), 6))
    node = np.zeros((len(x), 6))
    for number, elastic in enumerate(problem.elastic):  # from the base outward: the outermost layer is written last
        sigma, volume = elastic.cauchy(x)
        voigt = np.stack([sigma[..., i, j] for i, j in VOIGT], -1)
        element[mesh.layer == number] = np.einsum("eq,eqc->ec", volume, voigt) / volume.sum(1)[:, None]
        share = np.abs(elastic.elements.shape)  # N is negative at some corners of quadratic tets
        conn = elastic.elements.conn
        weight = np.zeros(len(x))
        total = np.zeros((len(x), 6))
        np.add.at(weight, conn, volume @ share)
        np.add.at(total, conn, np.einsum("eq,qa,eqc->eac", volume, share, voigt))
        here = weight > 0
        node[here] = total[here] / weight[here, None]
    return Stress(element, node)


@dataclass(frozen=True)
class Maps:
    """What acts on the deformed coated face, on the image grid (h, w).

    pressure [MPa] along the indenter's normal, positive in compression; traction (h, w, 2) [MPa] x and y of friction;
    contact, slip: bool; area [mm^2] of the deformed face behind each pixel, 0 outside the pad; stress (h, w, 3) [MPa]
    the whole traction vector: its sum with `area` is the force on the gel that the camera can see.
    """

    pressure: Array
    traction: Array
    contact: Array
    slip: Array
    area: Array
    stress: Array


def maps(problem: Problem, surface: Surface, state: State, camera: "Camera") -> Maps:
    """Pressure and traction behind each pixel, through the camera's refraction.

    Nodal forces are shared among the pixels that see the node, in proportion to its shape function and their area: the
    resultant is kept exactly, whatever the pixels. A node partly out of view keeps the area it has on the mesh.
    """
    shape = camera.shape
    triangles = pieces(surface.facets)
    corner = surface.now[triangles]  # (t, 3, 3)
    screen = camera.project(surface.now)[triangles]
    face_area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2
    side = screen[:, 1:] - screen[:, :1]
    pixels = np.abs(np.linalg.det(side)) / 2

    # each triangle with corners of its own, drawn with its number and barycentric coordinates
    own = np.arange(3 * len(triangles), dtype=np.uint32).reshape(-1, 3)
    values = np.concatenate(
        [np.repeat(np.arange(len(triangles)), 3)[:, None], np.tile(np.eye(3), (len(triangles), 1))], 1
    )
    picture = draw(own, screen.reshape(-1, 2), -corner[..., 2].ravel(), values, shape)
    seen = np.isfinite(picture[..., 0])
    t = np.round(picture[seen][:, 0]).astype(int)
    share = picture[seen][:, 1:]
    area = np.zeros(shape)
    area[seen] = face_area[t] / pixels[t]

    nodes = triangles[t]
    lumped, visible = np.zeros(len(surface.rest)), np.zeros(len(surface.rest))
    np.add.at(lumped, triangles, np.repeat(face_area[:, None] / 3, 3, 1))
    np.add.at(visible, nodes, share * area[seen][:, None])
    weight = np.where(visible > 0.9 * lumped, visible, lumped)

    def spread(per_point: Array) -> Array:
        force = problem.contact.faces.shared(per_point, len(state.x))[surface.nodes]
        out = np.zeros((*shape, per_point.shape[-1]))
        out[seen] = np.einsum("pk,pkc->pc", share, (force / weight[:, None])[nodes])
        return out

    # the normal forces are spread as numbers: their vectors partly cancel around an edge sharper than the mesh
    pressure = spread(state.normal_force[..., None])[..., 0]
    whole = spread(state.traction_force)
    tangential = np.zeros((*shape, 2)) if state.friction is None else spread(state.friction[..., :2])

    faces = problem.contact.faces
    whole_face = faces.shared(faces.areas[..., None], len(state.x))[surface.nodes, 0]

    def mostly(points: Array, level: float) -> Array:
        """Pixels where the share of the face around that `points` (f, q) bool make up reaches `level`."""
        part = faces.shared((faces.areas * points)[..., None], len(state.x))[surface.nodes, 0] / whole_face
        out = np.zeros(shape, bool)
        out[seen] = (share * part[nodes]).sum(1) >= level
        return out

    contact = mostly(state.normal_force > 0, RIM)
    slip = np.zeros(shape, bool) if state.sliding is None else contact & mostly(state.sliding, RIM / 2)
    return Maps(pressure, tangential, contact, slip, area, whole)


def height(sheet: "Sheet", surface: Surface, camera: "Camera") -> Array:
    """z (h, w) [mm] of the deformed face behind each pixel, on the smooth surface; nan where there is none."""
    now = sheet.at(surface)
    return draw(sheet.faces, camera.project(now), -now[:, 2], now[:, 2:], camera.shape)[..., 0]
