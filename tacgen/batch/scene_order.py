"""Which scene is next: of those that wait, the one expected to take longest, so that no long one is left for the end.

The logarithm of a scene's seconds is predicted from its frames and its varied values by ridge regression on the scenes
that are made: numbers are taken as they are, other values as categories.
"""

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from tacgen.recipe.plan import Row
from tacgen.report.estimate import work

Array = np.ndarray
Known = tuple[int, dict[str, Any]]  # a scene's frames and varied values
LEAST = 8  # scenes made, before which the plan's order is kept
LEARNT = 128  # latest scenes made that are remembered
WINDOW = 128  # waiting scenes that are compared, which takes 2 ms: each is resolved for it, 28 kB
RIDGE = 30.0  # penalty of a standardised value's weight, as of so many more scenes of average cost [-]


class SceneOrder:
    """Remembers what scenes took."""

    def __init__(self) -> None:
        self._made: deque[tuple[Known, float]] = deque(maxlen=LEARNT)  # with the logarithm of seconds a frame

    def learn(self, row: Row, seconds: dict[str, float]) -> None:
        """A scene was made, with these seconds by stage."""
        if (spent := work(seconds)) > 0:
            self._made.append(((row.frames, row.values), float(np.log(spent / row.frames))))

    def longest(self, rows: Sequence[Row]) -> int:
        """Place of the scene among `rows` to make next; 0 while too few are known."""
        known = len(self._made)
        if known < LEAST or len(rows) < 2:
            return 0
        x = _features([*(one for one, _ in self._made), *((row.frames, row.values) for row in rows)])
        y = np.array([cost for _, cost in self._made])
        x -= x[:known].mean(0)
        spread = x[:known].std(0)
        x = x[:, spread > 0] / spread[spread > 0]
        inner = x[:known].T @ x[:known] + RIDGE * np.eye(x.shape[1])
        weights = np.linalg.solve(inner, x[:known].T @ (y - y.mean()))
        frames = np.array([row.frames for row in rows])
        return int(np.argmax(x[known:] @ weights + np.log(frames)))


def _features(scenes: Sequence[Known]) -> Array:
    """Numbers (scenes, columns) that the cost of a frame may depend on."""
    columns: dict[str, Array] = {}
    for k, (frames, values) in enumerate(scenes):
        columns.setdefault("frames", np.zeros(len(scenes)))[k] = frames
        for path, value in values.items():
            number = isinstance(value, int | float)
            column = columns.setdefault(path if number else f"{path}={value}", np.zeros(len(scenes)))
            column[k] = value if number else 1.0
    return np.column_stack(list(columns.values()))
