"""What is lagged, renewed from an answer that depends on it, until both agree: as it comes or, where that fails, mixed.

Anderson (1965), "Iterative procedures for nonlinear integral equations": the sum of the last few whose errors cancel
best. Errors that go round in a circle are met in its middle, those that creep are run ahead of.
"""

from collections import deque

import numpy as np

Array = np.ndarray
PAST = 8  # errors that say what to take next
SEEN = 5  # as many there are, and the last is no less than
FALLS = 0.7  # of the one before, where what comes is not taken as it is
BACK = 0.8  # minus the cosine between two errors from which on the middle between two answers is meant
JUMPS = 5.0  # times the one before: something else has changed too, and those before say nothing of it
BEYOND = 10.0  # the most that any one may count for


class Renewal:
    """The last positions x (n, 3), the forces found there and by how much they were off those that had been lagged."""

    def __init__(self) -> None:
        self._past: deque[tuple[Array, Array, Array]] = deque(maxlen=PAST)

    def next(self, x: Array, force: Array, lagged: Array, between: bool = False) -> tuple[Array, Array]:
        """Positions and forces to lag, where `lagged` led to x and `force`; only `between` those known, if so asked."""
        error = force - lagged
        now, before = (float(np.linalg.norm(e)) for e in (error, self._past[-1][2] if self._past else 0.0))
        if now > JUMPS * before:
            self._past.clear()
        self._past.append((x, force, error))
        past = list(self._past)[-2 if between else 0 :]
        if between:
            asked = len(past) == 2 and float((error * past[0][2]).sum()) < -BACK * now * before
        else:
            asked = len(past) >= SEEN and now >= FALLS * before
        if not asked:
            return x, force
        errors = np.stack([error.ravel() for _, _, error in past], 1)
        weights = np.linalg.lstsq(errors[:, :-1] - errors[:, -1:], -errors[:, -1])[0]
        weights = np.append(weights, 1 - weights.sum())
        least, most = (0.0, 1.0) if between else (-BEYOND, BEYOND)
        if weights.min() < least or weights.max() > most:
            return x, force
        x, force = (np.tensordot(weights, np.stack(known), 1) for known in list(zip(*past, strict=True))[:2])
        return x, np.maximum(force, 0.0)
