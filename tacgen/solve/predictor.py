"""Predictor of a load step: the gel carried along with the indenter.

A point that sticks goes where the indenter goes, whatever the load steps before did; the other nodes follow by the
linearised stiffness. The prediction is what Newton's method starts from, and it says where new points first
touch: taken from the motion of the step before instead, which a turn makes wrong, a capsule pressed in and slid by 1 mm
at once was 46 % of its force off the same path in sixteen frames. It is .6 % so.
"""

from dataclasses import dataclass

import numpy as np

from tacgen.contact.barrier import Contact, Pose
from tacgen.solve.bulk import Tangent
from tacgen.solve.state import History

Array = np.ndarray
TIE = 16.0  # springs that tie a point to the indenter, times its normal force over dhat: stiff, as friction at rest is
PARALLEL = 0.9  # cosine between the motions of two steps from which on the indenter goes on as it went


@dataclass(frozen=True)
class Prediction:
    """Nodes x (n, 3) where the points in contact went `way` (f, q, 3) along with the indenter, all else following; by
    the tangent alone, to first order, they are `straight`."""

    x: Array
    straight: Array
    way: Array

    def missed(self, answer: Array) -> tuple[Array, Array]:
        """What the first order missed of an answer (n, 3), and the way on which it did."""
        return answer - self.straight, self.way


def predict(contact: Contact, tangent: Tangent, history: History, pose: Pose) -> Prediction | None:
    """To first order, or to second where the indenter goes on as it went; None where nothing touches that the tangent
    is condensed to."""
    touching = history.normal_force > 0
    at = contact.faces.at(history.x)
    way = np.where(touching[..., None], pose.world(history.pose.local(at)) - at, 0.0)
    straight = _tied(contact, tangent, history, way)
    if straight is None:
        return None
    if history.missed is None:
        return Prediction(straight, straight, way)
    missed, before = history.missed
    both = touching & before.any(-1)
    along, now, then = (float((a * b)[both].sum()) for a, b in ((way, before), (way, way), (before, before)))
    part = min(along / then, 1.0) if along > PARALLEL * np.sqrt(now * then) else 0.0
    return Prediction(straight + part**2 * missed, straight, way)


def _tied(contact: Contact, tangent: Tangent, history: History, way: Array) -> Array | None:
    condensed, faces, x = tangent.condensation, contact.faces, history.x
    inside = (condensed.local[faces.conn] >= 0).all(1)
    which = np.flatnonzero((history.normal_force > 0).any(1) & inside)
    if not which.size:
        return None
    ties = TIE * history.normal_force[which, :, None] / contact.dhat
    dofs = condensed.dofs[condensed.local[faces.conn[which]]]
    springs = condensed.schur.stiffness(ties[..., None] * np.eye(3), faces.N, dofs)
    part = faces.only(which)
    pull = part.scatter(ties * way[which], len(x))[condensed.nodes][condensed.dofs >= 0]
    u = condensed.schur.solve(springs, pull, symmetric=True)
    return np.asarray(x + condensed.expand(u, np.zeros(len(condensed.whole.free))))
