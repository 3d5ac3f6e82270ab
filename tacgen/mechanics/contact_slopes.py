"""Derivatives of contact forces and friction's anchors with respect to contact points, anchors and the offset.

Motions are (k, f, q, 3) for k parameters at once, in the sensor frame, relative to the indenter: forces do not change
where all move together.
"""

from functools import cached_property

import numpy as np

from tacgen.mechanics.barrier import barrier
from tacgen.mechanics.coupled import CoupledContact, smooth
from tacgen.mechanics.measures import SMALLEST, slip
from tacgen.physics.contact import MIN_SLOPE

Array = np.ndarray


def times(A: Array, v: Array) -> Array:
    """A (f, q, 3, 3) times v (k, f, q, 3)."""
    return np.asarray(np.einsum("fqij,kfqj->kfqi", A, v))


def dot(a: Array, b: Array) -> Array:
    return np.asarray((a * b).sum(-1))


class ContactSlopes:
    """Derivatives at an equilibrium x (n, 3) of the points of some facets."""

    def __init__(self, coupled: CoupledContact, x: Array) -> None:
        contact = coupled.contact
        self.eps, self.forces = coupled.eps, coupled.evaluate(x)
        n, N = self.forces.normal, self.forces.N
        self._gradient, self._hessian = self.forces.seen.n, self.forces.seen.H
        self._size = np.maximum(np.linalg.norm(self._gradient, axis=-1), MIN_SLOPE)
        _, db, ddb = barrier(self.forces.gap, contact.dhat)
        stiffness = contact.kappa * contact.faces.areas
        self._N_by_gap = -stiffness * ddb * self._size
        self._N_by_motion = -(stiffness * db)[..., None] * np.einsum("fqi,fqij->fqj", n, self._hessian)
        self._across = np.eye(3) - n[..., :, None] * n[..., None, :]
        self._lever, self._slip = dot(self.forces.at - coupled.anchor, n), slip(self.forces.at, coupled.anchor, n)
        self._length = np.linalg.norm(self._slip, axis=-1)
        _, slope, bend = smooth(self._length, coupled.eps)
        curved = bend[..., None, None] * self._slip[..., :, None] * self._slip[..., None, :]
        self._by_anchor = (coupled.friction * N)[..., None, None] * (slope[..., None, None] * self._across + curved)
        touching = np.where(N > 0, self._N_by_gap / np.maximum(N, SMALLEST), 0.0)
        self.by_offset = touching[..., None] * self.forces.force  # d(force)/d(offset) (f, q, 3) [N/mm]

    @cached_property
    def friction(self) -> Array:
        """Friction on the gel (f, q, 3) [N]."""
        return np.asarray(self.forces.force - self.forces.N[..., None] * self.forces.normal)

    def force(self, motion: Array, anchors: Array) -> Array:
        """Change of the force on the gel (k, f, q, 3) [N], at a constant offset."""
        return np.asarray(times(self._by_anchor, anchors) - times(self.forces.tangent, motion))

    def normal_force(self, motion: Array, offset: Array) -> Array:
        """Its change (k, f, q) [N]; `offset` (k,) is that of the offset [mm]."""
        closer = dot(self._gradient, motion) + offset[:, None, None]
        return np.asarray(self._N_by_gap * closer + dot(self._N_by_motion, motion))

    def normal(self, motion: Array) -> Array:
        """Its change (k, f, q, 3) with the position on the indenter."""
        return np.asarray(times(self._across, times(self._hessian, motion)) / self._size[..., None])

    def gap_excess(self, motion: Array, offset: Array) -> Array:
        """Change of the force-weighted mean gap less the offset, times the normal force (k,) [N mm]."""
        N, gap = self.forces.N, self.forces.gap - self.forces.mean_gap
        return np.asarray((self.normal_force(motion, offset) * gap + N * dot(self._gradient, motion)).sum((1, 2)))

    def dragged(self, motion: Array, anchors: Array) -> Array:
        """Change of the anchors after the step; `anchors` is that before it (see measures.dragged)."""
        n, length, u = self.forces.normal, np.maximum(self._length, SMALLEST), self._slip
        turn, away = self.normal(motion), motion - anchors
        slip = times(self._across, away) - self._lever[..., None] * turn
        slip -= dot(turn, u + self._lever[..., None] * n)[..., None] * n
        kept = np.minimum(1.0, self.eps / length)
        change = np.where(length > self.eps, -kept / length**2 * dot(u, slip), 0.0)
        return np.asarray(motion - change[..., None] * u - kept[..., None] * slip)
