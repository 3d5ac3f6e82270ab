"""Fixed-point iteration of lagged normal forces, with Anderson acceleration.

If two updates in a row cancel each other, the mixture with the smallest error is used: Anderson (1965),
"Iterative procedures for nonlinear integral equations", with a memory of one.
"""

import numpy as np

Array = np.ndarray
OPPOSED = 0.8  # minus the cosine between two errors, above which the updates cancel each other [-]


class Lag:
    """Keeps the last positions x (n, 3), the forces there, and their difference from the lagged ones."""

    def __init__(self) -> None:
        self._last: tuple[Array, Array, Array] | None = None

    def next(self, x: Array, force: Array, lagged: Array) -> tuple[Array, Array]:
        """The next positions and forces to lag, if `lagged` led to x and `force`."""
        error, last = force - lagged, self._last
        self._last = x, force, error
        if last is None:
            return x, force
        before = last[2]
        size = float(np.linalg.norm(error) * np.linalg.norm(before))
        if float((error * before).sum()) >= -OPPOSED * size:
            return x, force
        change = error - before
        part = float(np.clip(-(before * change).sum() / (change * change).sum(), 0.0, 1.0))
        return last[0] + part * (x - last[0]), np.maximum(last[1] + part * (force - last[1]), 0.0)
