"""Maps of contact pressure and friction on the deformed coated face, behind each pixel of the camera."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tacgen.fem import elements
from tacgen.fem.elements import triangles as pieces
from tacgen.geometry.rasterize import hits
from tacgen.mechanics import Problem, State
from tacgen.outputs.gel_surface import GelSurface

if TYPE_CHECKING:
    from tacgen.optics.camera import PinholeCamera

Array = np.ndarray
# share of points in contact at the rim of the contact map [-]: below .5, as the rim is outside them
MIN_CONTACT_SHARE = 0.4
MIN_VISIBLE_SHARE = 0.9  # share of a node's area [-]; a node of which the camera sees less is partly out of view
MIN_FORCE_SHARE = 1e-3  # of the sum of normal forces [-]: the least that resultants are divided by, if these cancel
COULOMB_TOL, SHARE_ROUNDING = 1e-3, 1e-9  # relative tolerances of Coulomb's law, and of shares between 0 and 1 [-]
SHARPENING_STEPS = {4: 2, 3: 2, 6: 0}  # Richardson-Lucy steps by nodes of a facet (see `maps`); more amplify noise


@dataclass(frozen=True)
class Maps:
    """On the image grid (h, w), by area of the deformed face; all are 0 where the camera sees no gel.

    pressure [MPa] along the indenter's normal, positive in compression; traction (h, w, 2) [MPa]: friction on the gel
    in the face's tangent plane, along the face's own x and y (see `tangents`); contact: at least 40 % of the points
    around touch; sliding: share of the pressure that slides, 0 to 1; area [mm^2] of the face behind each pixel; force
    (h, w, 3) [N] on the gel in the sensor frame, also on gel that is hidden by other gel: its sum is the force within
    the picture; unseen: share of the normal forces on gel that is hidden or outside the picture, which pressure and
    traction do not show [-].
    """

    pressure: Array
    traction: Array
    contact: Array
    sliding: Array
    area: Array
    force: Array
    unseen: float = 0.0

    @property
    def slip(self) -> Array:
        """Where there is contact and half or more of the pressure slides."""
        return np.asarray(self.contact & (self.sliding >= 0.5))


def tangents(normal: Array) -> tuple[Array, Array]:
    """The face's own x and y: orthogonal unit vectors (..., 3) in the plane of the outward normal (..., 3).

    The first is the sensor's x projected onto the tangent plane; on a horizontal face they are the sensor's x and y.
    """
    x = np.eye(3)[0] - normal[..., :1] * normal
    size = np.linalg.norm(x, axis=-1, keepdims=True)
    x = np.where(size > 1e-6, x / np.maximum(size, 1e-6), np.eye(3)[2])  # a vertical wall across x
    return x, np.cross(normal, x)


def maps(problem: Problem, surface: GelSurface, state: State, camera: "PinholeCamera") -> Maps:
    """Pressure and traction behind each pixel, through the camera's refraction.

    The force at each contact point is distributed to the nodes of its facet, and the sum of each node to the pixels
    around it: in proportion to linear shape functions, to the pixels' area, and to a weight. The resultant is preserved
    exactly. With equal weights the map would be smoothed twice, once by each distribution; therefore the resulting
    pressure is used as the weight of another distribution (Richardson 1972, Lucy 1974), which stays positive and
    preserves the sum.

    Normal forces and the two tangential components are distributed as scalars: vectors of different normals would
    partly cancel. Where friction slides, its magnitude is distributed too: with vectors of different directions around
    a node the map would be below Coulomb's limit.

    On a facet of six nodes the pressures at its points scatter by 6 %, as a quadratic surface meets a curved indenter
    at the middles of its edges rather than at its corners. Where all points are in contact, the linear part of the
    pressures and of friction is distributed, if that too obeys Coulomb's law.
    """
    return spread(Shares(problem, surface, state, camera), state)


def spread(view: "Shares", state: State) -> Maps:
    """Maps of a state on a `view` of the face that was computed in this state or in a nearby one."""
    pictures = {name: view.picture(values) for name, values in densities(view, state).items()}
    view.add_hidden(state.traction_force, pictures["force"])
    return Maps(**pictures, contact=view.picture(view.contact), area=view.area, unseen=view.unseen(state.normal_force))


def resultant_errors(view: "Shares", surface: GelSurface, state: State, maps: Maps) -> dict[str, float]:
    """Errors of the maps of pressure and traction: |integral over the deformed face - contact forces| / |force| [-].

    Pressure acts along -n and traction along the face's own x and y, with n the normals of the smooth face. The contact
    forces act along and across the normals of the indenter, so that the difference is large where the mesh does not
    resolve the indenter; it includes the force that the maps do not show. 0 without contact.
    """
    normal, area = view.normals(surface), view.seen_area[:, None]
    pressure, traction = (values[view.seen] for values in (maps.pressure, maps.traction))
    x, y = tangents(normal)
    per_area = -pressure[:, None] * normal, traction[:, :1] * x + traction[:, 1:] * y
    push, force = (state.normal_force[..., None] * state.normal).sum((0, 1)), state.traction_force.sum((0, 1))
    pressed, dragged = ((area * values).sum(0) for values in per_area)
    return {"pressure": over_force(pressed - push, state), "traction": over_force(dragged - (force - push), state)}


def over_force(difference: Array, state: State) -> float:
    """Norm of a force (3,) [N] over that of the contact force [-]; 0 without contact."""
    size = float(np.linalg.norm(state.traction_force.sum((0, 1))))
    size = max(size, MIN_FORCE_SHARE * float(state.normal_force.sum()))
    return float(np.linalg.norm(difference)) / size if size > 0 else 0.0


def densities(view: "Shares", state: State) -> dict[str, Array]:
    """Maps of forces by name, at the pixels (p, ...) of `view.seen`."""
    view.weight = np.ones(len(view.weight))
    for _ in range(view.sharpenings):
        view.weight = view.shared(state.normal_force)[:, 0]
    parts = [state.normal_force[..., None], state.traction_force]
    if state.friction is not None and state.sliding is not None:
        parts += [(state.friction * axis).sum(-1, keepdims=True) for axis in tangents(-state.normal)]
        parts += [np.linalg.norm(state.friction, axis=-1, keepdims=True)]
        parts += [(state.normal_force * state.sliding)[..., None]]
    means = view.shared(np.concatenate(parts, -1))
    pressure, force = means[:, 0], means[:, 1:4] * view.seen_area[:, None]
    traction, sliding = np.zeros((len(means), 2)), np.zeros(len(means))
    if means.shape[1] > 4:
        mean, size, slid = means[:, 4:6], means[:, 6], means[:, 7]
        sliding = np.divide(slid, pressure, out=sliding, where=pressure > 0)
        length = np.linalg.norm(mean, axis=1)
        longer = np.divide(size, length, out=np.ones(len(mean)), where=length > 1e-9 * size)
        traction = mean * (1 + sliding * (longer - 1))[:, None]
    return {"pressure": pressure, "traction": traction, "sliding": sliding, "force": force}


def _obeys_coulomb(level: Array, state: State, friction: float) -> Array:
    """Facets (f,) on which forces mapped by `level` (q, q) obey Coulomb's law at all points, shares within 0 and 1."""
    normal = state.normal_force @ level.T
    kept = normal >= 0
    if state.friction is not None and state.sliding is not None:
        slid = (state.normal_force * state.sliding) @ level.T
        kept &= (slid >= -SHARE_ROUNDING * normal) & (slid <= (1 + SHARE_ROUNDING) * normal)
        kept &= np.linalg.norm(level @ state.friction, axis=-1) <= (1 + COULOMB_TOL) * friction * normal
    return np.asarray(kept.all(1))


class Shares:
    """The deformed face as the camera sees it: area (h, w) [mm^2] and facet behind each pixel.

    For the p pixels (`seen`) that see a facet next to a touched one: their area, whether they are in contact, and their
    weight (p,) in the distribution of forces.
    """

    def __init__(self, problem: Problem, surface: GelSurface, state: State, camera: "PinholeCamera") -> None:
        from scipy.sparse import csr_array

        contact, on = problem.contact.faces, np.asarray(state.normal_force > 0)
        touched, self.sharpenings = np.asarray(on.any(1)), SHARPENING_STEPS[contact.conn.shape[1]]
        facets, kind = surface.facets, surface.facets.shape[1]
        triangles = pieces(facets).astype(np.int32, order="C")
        screen, corner = camera.project(surface.now), surface.now[triangles]  # (t, 3, 3)
        hit, place, _ = hits(triangles, screen, -surface.now[:, 2], camera.shape)
        gel = np.asarray(hit >= 0)
        face_area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2
        drawn = screen[triangles]
        pixels = np.abs(np.linalg.det(drawn[:, 1:] - drawn[:, :1])) / 2
        self.area = np.where(gel, (face_area / np.maximum(pixels, 1e-300))[hit], 0.0)

        self._facets, hats = facets, elements.facet_shares(contact.N, contact.areas)
        self._hats = np.tile(hats, (len(on), 1, 1))  # (f, q, k)
        if kind == 6:
            level = elements.linear_pressure(contact.N, contact.areas)
            self._hats[on.all(1) & _obeys_coulomb(level, state, problem.friction)] = level.T @ hats
        beside = np.zeros(len(surface.now), bool)
        beside[self._facets[touched]] = True
        self.seen = gel & np.tile(beside[facets].any(1), len(triangles) // len(facets))[hit]
        self._pixels = np.flatnonzero(self.seen)
        self.seen_area = self.area.ravel()[self._pixels]
        piece, number = np.divmod(hit.ravel()[self._pixels], len(facets))
        triangles = elements.facet_corners(kind)[np.array(elements.FACET_TRIANGLES[kind])]
        ends = triangles[piece]  # corners of its triangle, (p, 3, 2)
        v, w = place.reshape(-1, 2)[self._pixels].T[..., None]
        hats = elements.facet_hats(kind, (1 - v - w) * ends[:, 0] + v * ends[:, 1] + w * ends[:, 2])
        starts, size = kind * np.arange(len(hats) + 1), (len(hats), len(surface.now))
        self._shape = csr_array((hats.ravel(), facets[number].ravel(), starts), shape=size)
        self.weight = np.ones(len(hats))

        areas = elements.facet_areas(surface.now, facets)[0]
        areas = areas @ elements.facet_shares(elements.facet_points(kind)[0], areas)
        whole, visible = np.bincount(self._facets.ravel(), areas.ravel()), self._weighted_area()
        self._visible = np.where(visible > MIN_VISIBLE_SHARE * whole, 1.0, visible / np.maximum(whole, 1e-300))
        outside = np.any((screen < 0) | (screen >= camera.shape[::-1]), axis=1)
        cut = np.zeros(len(surface.now), bool)
        cut[facets[outside[facets].any(1)]] = True  # what these nodes lack is outside the picture
        self._hidden = np.where(cut, 0.0, 1 - self._visible)
        self._points = contact.at(state.x), camera
        touching, around = (self.at(self.nodal(contact.areas * part)) for part in (on, 1.0))
        self.contact = (touching / around)[:, 0] >= MIN_CONTACT_SHARE

    def nodal(self, per_point: Array) -> Array:
        """Nodal sums (s, c) of values at the contact points, (f, q, c) or (f, q)."""
        per_point = per_point.reshape(*per_point.shape[:2], -1)
        out = np.zeros((int(self._facets.max()) + 1, per_point.shape[2]))
        np.add.at(out, self._facets, np.einsum("fqk,fqc->fkc", self._hats, per_point))
        return out

    def at(self, nodal: Array) -> Array:
        """Values (s, c) at the nodes, behind each of the pixels (p, c)."""
        return np.asarray(self._shape @ nodal)

    def normals(self, surface: GelSurface) -> Array:
        """Unit normals (p, 3) of the smooth face behind each of the pixels."""
        mean = self.at(surface.normals)
        return np.asarray(mean / np.linalg.norm(mean, axis=1, keepdims=True))

    def shared(self, per_point: Array) -> Array:
        """Forces at the points per area of the face (p, c), in proportion to the weights; of a node that is partly out
        of view, the visible part."""
        force, weighted = self.nodal(per_point), self._weighted_area()
        scale = np.divide(self._visible, weighted, out=np.zeros(len(weighted)), where=weighted > 0)
        return self.at(force * scale[:, None]) * self.weight[:, None]

    def unseen(self, normal_force: Array) -> float:
        """Share of the forces at the points (f, q) that is on invisible parts of the face [-]; 0 without forces."""
        per_node = self.nodal(normal_force)[:, 0]
        return float((1 - self._visible) @ per_node / per_node.sum()) if per_node.any() else 0.0

    def add_hidden(self, per_point: Array, image: Array) -> None:
        """Add forces (f, q, 3) on gel that other gel hides to the pixels of `image` (h, w, 3) behind which they act."""
        share = np.einsum("fqk,fk->fq", self._hats, self._hidden[self._facets])
        here, (points, camera) = share != 0, self._points
        if here.any():
            (h, w), at = image.shape[:2], camera.project(points[here]).astype(int)
            np.add.at(image, tuple(np.clip(at, 0, (w - 1, h - 1)).T[::-1]), share[here, None] * per_point[here])

    def picture(self, values: Array) -> Array:
        """Values (p, ...) as an image (h, w, ...), 0 at other pixels."""
        out = np.zeros((*self.area.shape, *values.shape[1:]), values.dtype)
        out.reshape(-1, *values.shape[1:])[self._pixels] = values
        return out

    def _weighted_area(self) -> Array:
        """Weighted area (s,) of the pixels around each node."""
        return np.asarray(self._shape.T @ (self.weight * self.seen_area))
