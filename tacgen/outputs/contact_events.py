"""The state of the contact as a whole: sticking, partly slipping, sliding, turning, releasing.

The mode of a frame follows from its labels and the pose before it, not from the movement in the recipe. It is the first
of these that is true:

    apart            hardly any pressure: less than MIN_PRESSURE_PER_SHEAR_MODULUS
    releasing        the normal force falls, and the indenter moves off the gel more than sideways
    sliding          the whole contact slips, and the indenter moves sideways
    turning          the same, but at the contact's mean radius it rotates by more than it moves sideways
    touching         hardly any tangential load
    sticking         a tangential load, and nearly all of the pressure sticks
    partly slipping  a tangential load, and part of the pressure slides
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tacgen.fem.elements import facet_areas, triangles
from tacgen.outputs.contact_maps import MIN_CONTACT_SHARE
from tacgen.outputs.contact_modes import CONTACT_MODES

if TYPE_CHECKING:
    from tacgen.mechanics import Problem, State
    from tacgen.mechanics.barrier import Faces

Array = np.ndarray
APART, TOUCHING, STICKING, SLIPPING, SLIDING, TURNING, RELEASING = range(len(CONTACT_MODES))
# mean pressure over the shear modulus [-]; below, the barrier acts before the gel is indented
MIN_PRESSURE_PER_SHEAR_MODULUS = 3e-3
MIN_TANGENTIAL_LOAD = 0.1  # friction used [-]; below, there is hardly any tangential load
MIN_STICKING_SHARE = 0.95  # share of the pressure that sticks [-]; above, the contact is sticking
MIN_SLIDING_FRICTION_USE = 0.9  # friction used [-]; above, the contact may slide as a whole
MAX_REST_MOTION_MM = 1e-6  # motion between frames [mm]; below, the indenter is at rest
WEAKEST_MOTION_STEPS = 30  # iterations of the search for the weakest motion; it has converged to 1e-3 by then


@dataclass(frozen=True)
class Events:
    """The contact in one frame; all are 0 where nothing touches.

    mode: index in CONTACT_MODES; stick_ratio: share of the pressure that sticks [-]; friction_used: see the function of
    that name [-]; center_of_pressure (3,) in the sensor frame [mm]; contact_area of the deformed face [mm^2], and its
    number of connected patches, whether the camera sees them or not.
    """

    mode: int = APART
    stick_ratio: float = 0.0
    friction_used: float = 0.0
    center_of_pressure: tuple[float, ...] = (0.0, 0.0, 0.0)
    contact_area: float = 0.0
    patches: int = 0


def events(problem: "Problem", state: "State", before: "State | None") -> Events:
    """The contact in a state; `before` is the state of the previous frame, None in the first."""
    faces, on = problem.contact.faces, state.normal_force > 0
    force = state.normal_force[on]
    if force.sum() <= MIN_PRESSURE_PER_SHEAR_MODULUS * problem.elastic[-1].law.mu * faces.areas[on].sum():
        return Events()
    at = faces.at(state.x)[on]
    center = force @ at / force.sum()
    stick = used = 0.0
    if state.friction is not None and state.sliding is not None:
        stick = float(force[~state.sliding[on]].sum() / force.sum())
        used = friction_used(at - center, state.normal[on], problem.friction * force, state.friction[on])
    radius = float(force @ np.hypot(*(at - center).T[:2]) / force.sum())
    away, sideways, turned = (0.0, 0.0, 0.0) if before is None else _moved(before.pose, state.pose, center, radius)
    if before is not None and away > max(sideways, MAX_REST_MOTION_MM) and force.sum() < before.normal_force.sum():
        mode = RELEASING
    elif (
        stick < 1 - MIN_STICKING_SHARE
        and used > MIN_SLIDING_FRICTION_USE
        and max(sideways, turned) > MAX_REST_MOTION_MM
    ):
        mode = SLIDING if sideways >= turned else TURNING
    elif used < MIN_TANGENTIAL_LOAD:
        mode = TOUCHING
    else:
        mode = STICKING if stick > MIN_STICKING_SHARE else SLIPPING
    return Events(mode, stick, used, tuple(center), *touched(faces, state.x, on))


def touched(faces: "Faces", x: Array, on: Array) -> tuple[float, int]:
    """Area [mm^2] of the face at nodal positions x (n, 3) that touches, and the number of its connected patches.

    It is where MIN_CONTACT_SHARE of the points around, `on` (f, q) of which touch, as in the map of contact; the points
    alone where no node has so many around it.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    touching, around = faces.shared(np.stack([faces.areas * on, faces.areas], -1), len(x)).T
    above = np.divide(touching, around, out=np.zeros(len(x)), where=around > 0) - MIN_CONTACT_SHARE
    drawn, stretch = triangles(faces.conn), facet_areas(x, faces.conn)[0].sum(1) / faces.areas.sum(1)
    if faces.conn.shape[1] == 4:  # around their middles, which no diagonal favours
        x, above = (np.concatenate([each, each[faces.conn].mean(1)]) for each in (x, above))
        middle = np.arange(len(x) - len(stretch), len(x))
        drawn = np.concatenate([np.column_stack([faces.conn[:, [k - 1, k]], middle]) for k in range(4)])
    inside, area = above >= 0, float(stretch @ (faces.areas * on).sum(1))
    if inside.any():
        corner = x[drawn]
        sizes = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2
        area = float(sizes @ share_above(above[drawn]))
    else:
        inside[faces.conn[on.any(1)]] = True
    ends = np.concatenate([drawn[:, [k - 1, k]] for k in range(3)])
    ends = ends[inside[ends].all(1)]
    graph = coo_array((np.ones(len(ends)), tuple(ends.T)), shape=(len(x), len(x)))
    return area, len(np.unique(connected_components(graph, directed=False)[1][inside]))


def share_above(values: Array) -> Array:
    """Share (t,) of each triangle on which the linear function with these values (t, 3) at its corners is positive."""
    a, b, c = np.sort(values, axis=1).T
    cut = np.where(b > 0, np.minimum(a, 0.0), np.maximum(c, 0.0)) ** 2  # the corner that is cut off, at a or at c
    part = np.divide(cut, (c - a) * np.where(b > 0, b - a, c - b), out=np.zeros(len(cut)), where=cut > 0)
    return np.asarray(np.where(b > 0, 1 - part, part))


def friction_used(arm: Array, normal: Array, most: Array, friction: Array) -> float:
    """Share of the available friction that the tangential load uses, 0 to 1; 1 if the whole contact slides.

    Friction can carry a load f (two forces and a torque in the sensor's plane) if for every rigid motion u in the plane
    f . u is at most the friction power of full sliding, the sum of most |u|. The result is the largest ratio of the two
    over all u. For a horizontal contact under a pure force it is the friction force over friction coefficient x normal
    force; under a pure torque it is the torque over that of full sliding.

    Args:
        arm: vectors from the centre of pressure to the points (k, 3) [mm]. normal: unit normals there (k, 3).
        most: friction coefficient x normal force (k,) [N]. friction: on the gel there (k, 3) [N].

    Source: limit surface of Goyal, Ruina & Papadopoulos (1991), "Planar sliding with dry friction"; the motion is found
    by Weiszfeld's reweighted least squares.
    """
    radius = max(float(most @ np.hypot(*arm.T[:2]) / most.sum()), 1e-9)  # weighs rotations against motion
    along = np.zeros((len(arm), 3, 3))  # motion of the points per unit of x, y and rotation
    along[:, 0, 0] = along[:, 1, 1] = 1.0
    along[:, :2, 2] = np.column_stack([-arm[:, 1], arm[:, 0]]) / radius
    along -= normal[:, :, None] * np.einsum("ki,kij->kj", normal, along)[:, None]
    load, weight, most_used = np.einsum("ki,kij->j", friction, along), most, 0.0
    squared = np.einsum("kia,kib->kab", along, along).reshape(-1, 9)  # of the motion, to the squared way of each point
    for _ in range(WEAKEST_MOTION_STEPS):
        motion = np.linalg.lstsq((weight @ squared).reshape(3, 3), load, rcond=None)[0]
        way = np.sqrt(np.maximum(squared @ np.outer(motion, motion).ravel(), 0.0))
        if not (taken := float(most @ way)) > 0:
            return 0.0
        most_used = max(most_used, float(load @ motion) / taken)
        weight = most / np.maximum(way, 1e-9 * way.max())
    return min(most_used, 1.0)  # regularised friction may exceed the limit slightly


def _moved(before: Array, pose: Array, center: Array, radius: float) -> tuple[float, float, float]:
    """Motion of the indenter between two poses (4, 4) at `center` (3,): away from the gel, sideways, and by rotation
    about z at `radius` [mm]."""
    turn = pose[:3, :3] @ before[:3, :3].T
    move = turn @ (center - before[:3, 3]) + pose[:3, 3] - center
    angle = float(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))
    return float(move[2]), float(np.hypot(move[0], move[1])), abs(angle) * radius
