"""Tunnelling: whether the indenter passes through the gel in a step, or between the contact's quadrature points."""

from collections.abc import Iterable
from functools import cache

import numpy as np

from tacgen.fem import assembly
from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import QUAD_CORNERS, barycentric
from tacgen.geometry.pose import Pose
from tacgen.mechanics.barrier import Contact
from tacgen.physics import contact as kernels
from tacgen.physics.runtime import call

Array = np.ndarray
OVERLAP_INTERVALS = 6  # intervals along a facet's side: the overlap is sampled at their ends


def blocked(contact: Contact, was: Pose, before: Array, gap: Array, x: Array) -> bool:
    """Whether a straight step carries a point of the face through the indenter.

    The motion is taken in the indenter's frame, from pose `was` with nodes `before` (n, 3) and gaps (f, q) [mm] to the
    contact's pose with nodes x. A point beyond the indenter's middle would be pushed out on the far side. There the
    outward normal has turned by more than a right angle since the point entered, or the depth is large.
    """
    start, step = np.empty((1, *gap.shape, 3)), np.empty((1, *gap.shape, 3))
    length, way = np.empty((1, *gap.shape)), (before[None], x[None], *contact.arrays[:3])
    call(
        kernels.ways, length.shape, *way, was.rotation[None], was.position[None], *contact.placed[:2], gap[None],
        start, step, length,
    )  # fmt: skip
    if not length.any():
        return False
    parts, through = max(2.0, np.ceil(4 * length.max() / contact.shape.reach)), np.empty(length.shape, bool)
    numbers = (np.array([part], float) for part in (parts, contact.shape.reach, contact.offset))
    call(kernels.blocked, length.shape, start, step, length, *numbers, *contact.shape.record, through)
    return bool(through.any())


def blocked_along(contact: Contact, was: Pose, before: Array, gap: Array, path: Iterable[Array]) -> bool:
    """Whether a point of the face passes through the indenter, from one of the positions (n, 3) of the path to the
    next: where the gel snaps out of a fold, it goes round an edge that a straight step would cross."""
    for k, x in enumerate(path):
        if k > 0:
            was, gap = contact.pose, contact.gap(before)
        if blocked(contact, was, before, gap, x):
            return True
        before = x
    return False


def depth_inside(contact: Contact, elastic: Iterable[Elastic], x: Array) -> float:
    """Largest penetration of the gel into the shrunk indenter [mm], at the integration points."""
    least = 0.0
    for part in elastic:
        at = np.einsum("qa,eai->eqi", part.elements.shape, x[part.elements.conn]).reshape(-1, 3)
        least = min(least, float(contact.shape.value(contact.pose.local(at)).min()) + contact.offset)
    return -least


def overlap(contact: Contact, x: Array) -> float:
    """Largest penetration of the gel's face into the shrunk indenter [mm], between the contact points.

    A few micrometres if the mesh resolves the indenter; more at edges sharper than the mesh.
    """
    conn, gap = contact.faces.conn, contact.gap(x).min(1)
    near = gap < contact.dhat + np.sqrt(contact.faces.areas.sum(1))
    if not near.any():
        return 0.0
    at = assembly.at_points(x, conn[near], _grid(conn.shape[1])).reshape(-1, 3)
    deepest = float(contact.shape.value(contact.pose.local(at)).min()) + contact.offset
    return max(0.0, -deepest)


@cache
def _grid(nodes: int) -> Array:
    """Shape functions (p, a) on a grid over a facet."""
    u, v = np.stack(np.meshgrid(*[np.linspace(0, 1, OVERLAP_INTERVALS + 1)] * 2), -1).reshape(-1, 2).T
    if nodes == 4:
        return np.stack([(1 + a * (2 * u - 1)) * (1 + b * (2 * v - 1)) / 4 for a, b in QUAD_CORNERS], -1)
    inside = u + v < 1 + 1e-9
    return barycentric(np.stack([1 - u - v, u, v], -1)[inside], nodes)[0]
