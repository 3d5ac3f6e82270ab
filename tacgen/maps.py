"""State -> Maps: what the contact does to the deformed coated face, behind each pixel of the camera."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tacgen.fem.elements import triangles as pieces
from tacgen.fields import Surface
from tacgen.optics.raster import draw
from tacgen.solve import Problem, State

if TYPE_CHECKING:
    from tacgen.optics.layers import Camera

Array = np.ndarray
RIM = 0.4  # share of points in contact at the contact map's rim: less than half, for the rim passes outside of them
VISIBLE = 0.9  # of its share of the face: a node seen less than that lies partly out of view


@dataclass(frozen=True)
class Maps:
    """On the image grid (h, w), by area of the deformed face; all are 0 where the camera sees no gel.

    pressure [MPa] along the indenter's normal, positive in compression; traction (h, w, 2) [MPa] friction on the gel in
    the face's tangent plane, along the face's own x and y (see `tangents`), so that its size is that of the vector;
    contact: touched, at least at 40 % of the points around; sliding: share of the pressure that slides, 0 to 1;
    area [mm^2] of the face behind each pixel; force (h, w, 3) [N] on the gel there, in the sensor frame: its sum is the
    force that the camera can see.
    """

    pressure: Array
    traction: Array
    contact: Array
    sliding: Array
    area: Array
    force: Array

    @property
    def slip(self) -> Array:
        """Where there is contact and most of the pressure slides."""
        return np.asarray(self.contact & (self.sliding >= 0.5))


def tangents(normal: Array) -> tuple[Array, Array]:
    """The face's own x and y: unit vectors (..., 3) at right angles to each other and to the outward normal (..., 3).

    The first is the sensor's x drawn into the tangent plane; on a level face they are the sensor's x and y.
    """
    x = np.eye(3)[0] - normal[..., :1] * normal
    size = np.linalg.norm(x, axis=-1, keepdims=True)
    x = np.where(size > 1e-6, x / np.maximum(size, 1e-6), np.eye(3)[2])  # a wall across x
    return x, np.cross(normal, x)


def maps(problem: Problem, surface: Surface, state: State, camera: "Camera") -> Maps:
    """Pressure and traction behind each pixel, through the camera's refraction.

    Nodal forces are shared among the pixels that see the node, in proportion to its shape function and their area: the
    resultant is kept exactly, whatever the pixels. Normal forces and the two tangential components are spread as
    numbers: as vectors they would partly cancel around a bend. Where friction slides its sizes are, too, since Coulomb
    says the size: directions that differ around a node would cancel, and the map fall short of his law.
    """
    view, faces, n = _View(surface, camera), problem.contact.faces, len(state.x)

    def spread(per_point: Array) -> Array:
        return view.spread(faces.shared(per_point, n)[surface.nodes])

    pressure = spread(state.normal_force[..., None])[..., 0]
    force = spread(state.traction_force) * view.area[..., None]
    touched = state.normal_force > 0
    part = [faces.shared((faces.areas * points)[..., None], n)[surface.nodes] for points in (touched, 1.0)]
    contact = view.at(part[0] / part[1])[..., 0] >= RIM
    traction, sliding = np.zeros((*camera.shape, 2)), np.zeros(camera.shape)
    if state.friction is not None and state.sliding is not None:
        components = [(state.friction * axis).sum(-1) for axis in tangents(-state.normal)]
        slid = spread((state.normal_force * state.sliding)[..., None])
        sliding = np.divide(slid[..., 0], pressure, out=sliding, where=pressure > 0)
        mean = spread(np.stack(components, -1))
        length, size = np.linalg.norm(mean, axis=-1), spread(np.linalg.norm(state.friction, axis=-1)[..., None])[..., 0]
        longer = np.divide(size, length, out=np.ones(camera.shape), where=length > 1e-9 * size)
        traction = mean * (1 + sliding * (longer - 1))[..., None]
    return Maps(pressure, traction, contact, sliding, view.area, force)


class _View:
    """The deformed face as the camera sees it: which nodes are behind each pixel, and how much of the face."""

    def __init__(self, surface: Surface, camera: "Camera") -> None:
        triangles = pieces(surface.facets)
        corner = surface.now[triangles]  # (t, 3, 3)
        screen = camera.project(surface.now)[triangles]
        face_area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2
        pixels = np.abs(np.linalg.det(screen[:, 1:] - screen[:, :1])) / 2

        # each triangle with corners of its own, drawn with its number and barycentric coordinates
        own = np.arange(3 * len(triangles), dtype=np.uint32).reshape(-1, 3)
        number = np.repeat(np.arange(len(triangles)), 3)[:, None]
        values = np.concatenate([number, np.tile(np.eye(3), (len(triangles), 1))], 1)
        picture = draw(own, screen.reshape(-1, 2), -corner[..., 2].ravel(), values, camera.shape)
        self.seen = np.isfinite(picture[..., 0])
        t = np.round(picture[self.seen][:, 0]).astype(int)
        self.nodes, self.share = triangles[t], picture[self.seen][:, 1:]  # (p, 3)
        self.area = np.zeros(camera.shape)
        self.area[self.seen] = face_area[t] / pixels[t]

        count = len(surface.now)
        whole = np.bincount(triangles.ravel(), np.repeat(face_area / 3, 3), count)
        visible = np.bincount(self.nodes.ravel(), (self.share * self.area[self.seen][:, None]).ravel(), count)
        self._weight = np.where(visible > VISIBLE * whole, visible, whole)

    def at(self, nodal: Array) -> Array:
        """Nodal values (s, c) behind each pixel (h, w, c); 0 where there is no gel."""
        out = np.zeros((*self.area.shape, nodal.shape[1]))
        out[self.seen] = np.einsum("pk,pkc->pc", self.share, nodal[self.nodes])
        return out

    def spread(self, force: Array) -> Array:
        """Nodal sums (s, c) by area of the face (h, w, c). A node partly out of view keeps the area it has on the
        mesh."""
        return self.at(force / self._weight[:, None])
