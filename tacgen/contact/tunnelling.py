"""Whether an indenter passes through the gel unseen: in a step, or between the points where contact acts."""

from collections.abc import Iterable

import numpy as np

from tacgen.contact.barrier import Contact, Pose
from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import QUAD_CORNERS, barycentric

Array = np.ndarray
DEEPEST = 0.75  # of the indenter's reach: how far inside it a point may come on its way
BETWEEN = 6  # parts of a facet's side, at whose ends it is looked at between the points of contact
TURN = 0.25  # minus the cosine by which the way out of it may have turned there


def blocked(contact: Contact, was: Pose, before: Array, gap: Array, x: Array) -> bool:
    """Whether a point of the face, going straight, would have the indenter pass through it.

    As seen from the indenter, which `was` at one pose with the nodes at `before` (n, 3) and gaps (f, q) [mm], and is at
    the contact's with the nodes at x. A point that comes past the indenter's middle, which shows in the way out there
    having turned by more than a right angle or in a great depth, would be pushed out on the far side.
    """
    a, b = was.local(contact.faces.at(before)), contact.pose.local(contact.faces.at(x))
    way = np.linalg.norm(b - a, axis=-1)
    near = way > np.maximum(gap, 0.0)  # the others cannot have come to the surface
    if not near.any():
        return False
    start, step, reach = a[near], (b - a)[near], contact.shape.reach
    parts = max(2, int(np.ceil(4 * way[near].max() / reach)))
    entered, entry = np.zeros(len(start), bool), np.zeros_like(start)
    for k in range(parts + 1):
        d, n, _ = contact.shape.distance(start + k / parts * step)
        inside = d + contact.offset < 0
        entry[inside & ~entered] = n[inside & ~entered]
        entered |= inside
        if d.min() < -DEEPEST * reach or (entered & ((entry * n).sum(1) < -TURN)).any():
            return True
        entered &= inside
    return False


def depth_inside(contact: Contact, elastic: Iterable[Elastic], x: Array) -> float:
    """How deep matter of the gel is inside the shrunk indenter [mm], at the integration points."""
    least = 0.0
    for part in elastic:
        at = np.einsum("qa,eai->eqi", part.elements.shape, x[part.elements.conn]).reshape(-1, 3)
        least = min(least, float(contact.shape.distance(contact.pose.local(at))[0].min()) + contact.offset)
    return -least


def overlap(contact: Contact, x: Array) -> float:
    """How deep the gel's face is inside the shrunk indenter [mm], between the points where contact acts.

    A few micrometres where the mesh resolves the indenter; with edges sharper than its cells, what they cut into it.
    """
    conn, gap = contact.faces.conn, contact.gaps(x)[0].min(1)
    near = gap < contact.dhat + np.sqrt(contact.faces.areas.sum(1))
    if not near.any():
        return 0.0
    at = np.einsum("qa,fai->fqi", _grid(conn.shape[1]), x[conn[near]]).reshape(-1, 3)
    deepest = float(contact.shape.distance(contact.pose.local(at))[0].min()) + contact.offset
    return max(0.0, -deepest)


def _grid(nodes: int) -> Array:
    """Shape functions (p, a) on a grid over a facet."""
    u, v = np.stack(np.meshgrid(*[np.linspace(0, 1, BETWEEN + 1)] * 2), -1).reshape(-1, 2).T
    if nodes == 4:
        return np.stack([(1 + a * (2 * u - 1)) * (1 + b * (2 * v - 1)) / 4 for a, b in QUAD_CORNERS], -1)
    inside = u + v < 1 + 1e-9
    return barycentric(np.stack([1 - u - v, u, v], -1)[inside], nodes)[0]
