"""Contact of FElupe's player with a rigid shape, at points of Gauss on the face: an augmented Lagrangian along the
normal of the exact shape, and Coulomb's law by return mapping; and Newton's method for both.
"""

from typing import Any

import numpy as np
from scipy import sparse

from benchmarks.referee.case import Array, Pose
from benchmarks.referee.players.felupe_pad import Pad

PUSH, HOLD = 5.0, 4.0  # stiffness along the normal, and of stick, before they are corrected [MPa/mm]
TRIES, FORCE_N = 20, 1e-5  # Newton's steps; largest force that is left at a node
Touch = tuple[Array, Array, Array]  # pressure (q,), friction (q, 3) in the shape's frame [MPa], where it sticks (q, 1)


def contact(
    y: Array, before: Array, kept: Touch, shape: Any, friction: float, stuck: bool
) -> tuple[Array, Array, Touch]:
    """Tractions (q, 3) [MPa] at points y (q, 3) [mm] of its frame, their derivative (q, 3, 3), and their parts."""
    d, n, bend = shape.distance(y)
    p, normal = kept[0] - PUSH * d, n[:, :, None] * n[:, None]
    flat, q = np.eye(3) - normal, kept[1] - HOLD * (y - before)
    s = np.einsum("nij,nj->ni", flat, q)
    size = np.maximum(np.linalg.norm(s, axis=1), 1e-30)[:, None]
    e = s / size
    turned = (q * n).sum(1)[:, None, None] * bend + n[:, :, None] * np.einsum("nj,njk->nk", q, bend)[:, None]
    stick, most = -HOLD * flat - turned, friction * p[:, None]
    along = np.eye(3) - e[:, :, None] * e[:, None]
    slide = (most / size)[:, :, None] * (along @ stick) - friction * PUSH * e[:, :, None] * n[:, None]
    slips = (size > most) & (not stuck)
    rub = np.where(slips, most * e, s) if friction else np.zeros_like(s)
    slope = p[:, None, None] * bend - PUSH * normal
    slope += np.where(slips[..., None], slide, stick) if friction else 0.0
    on = (p > 0)[:, None]
    return on * (p[:, None] * n + rub), on[..., None] * slope, (np.maximum(p, 0), on * rub, on & ~slips)


def solve(
    pad: Pad, u: Array, before: Array, kept: Touch, pose: Pose, shape: Any, friction: float, corrections: int
) -> Any:
    """Displacements (3n,) at rest and their contact, from a guess; None if Newton's steps do not lead there."""
    from pypardiso import spsolve

    turn, count = pose.matrix[:3, :3], len(pad.area)
    for correction in range(corrections):
        for step in range(TRIES):
            pad.field[0].values[:] = u.reshape(-1, 3)
            y = ((pad.at @ (pad.points.ravel() + u)).reshape(-1, 3) - pose[:3]) @ turn
            with np.errstate(all="ignore"):
                push, slope, new = contact(y, before, kept, shape, friction, step + correction == 0)
                inner = pad.solid.assemble.vector(pad.field).toarray().ravel()
            left = pad.free.T @ (inner - pad.at.T @ (pad.area[:, None] * push @ turn.T).ravel())
            if not (worst := abs(left).max()) < np.inf:
                return None
            if worst < FORCE_N:
                break
            blocks = -pad.area[:, None, None] * (turn @ slope @ turn.T)
            K = sparse.bsr_matrix((blocks, np.arange(count), np.arange(count + 1)))
            K = pad.free.T @ (pad.solid.assemble.matrix(pad.field) + pad.at.T @ K @ pad.at) @ pad.free
            u = u - pad.free @ spsolve(K.tocsr(), left)
        else:
            return None
        kept = new
    held = np.where(kept[2], before, y)  # a point that sticks is still drawn to where it did first
    return u, held, kept, pad.area[:, None] * push @ turn.T
