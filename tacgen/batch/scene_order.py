"""Order of a batch's scenes: the one predicted to take longest is started first, so that workers end together.

The logarithm of a scene's seconds is predicted from its frames and its varied values, by ridge regression on the scenes
that are done. Numbers enter as they are, other values as categories.
"""

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from tacgen.recipe.row import Row
from tacgen.report.estimate import work

Array = np.ndarray
Known = tuple[int, dict[str, Any]]  # a scene's frames and varied values
MIN_SCENES_FOR_PREDICTION = 8  # scenes done before the first prediction; until then the plan's order is kept
PREDICTION_SCENES = 128  # scenes, the latest ones done, on which the prediction is based
COMPARED_SCENES = 128  # waiting scenes that are compared; it takes 2 ms, and 28 kB for each scene's recipe
COST_FIT_RIDGE = 30.0  # penalty on the weights of standardised values, equivalent to so many scenes of average cost [-]


class SceneOrder:
    """Predicts the run time of scenes from those done."""

    def __init__(self) -> None:
        # with the logarithm of seconds a frame
        self._made: deque[tuple[Known, float]] = deque(maxlen=PREDICTION_SCENES)

    def learn(self, row: Row, seconds: dict[str, float]) -> None:
        """Records the seconds by stage of a scene that is done."""
        if (spent := work(seconds)) > 0:
            self._made.append(((row.frames, row.values), float(np.log(spent / row.frames))))

    def longest(self, rows: Sequence[Row]) -> int:
        """Index in `rows` of the scene to make next; 0 until MIN_SCENES_FOR_PREDICTION scenes are done."""
        known = len(self._made)
        if known < MIN_SCENES_FOR_PREDICTION or len(rows) < 2:
            return 0
        x = _features([*(one for one, _ in self._made), *((row.frames, row.values) for row in rows)])
        y = np.array([cost for _, cost in self._made])
        x -= x[:known].mean(0)
        spread = x[:known].std(0)
        x = x[:, spread > 0] / spread[spread > 0]
        inner = x[:known].T @ x[:known] + COST_FIT_RIDGE * np.eye(x.shape[1])
        weights = np.linalg.solve(inner, x[:known].T @ (y - y.mean()))
        frames = np.array([row.frames for row in rows])
        return int(np.argmax(x[known:] @ weights + np.log(frames)))


def _features(scenes: Sequence[Known]) -> Array:
    """The regression's features, (scenes, columns)."""
    columns: dict[str, Array] = {}
    for k, (frames, values) in enumerate(scenes):
        columns.setdefault("frames", np.zeros(len(scenes)))[k] = frames
        for path, value in values.items():
            number = isinstance(value, int | float)
            column = columns.setdefault(path if number else f"{path}={value}", np.zeros(len(scenes)))
            column[k] = value if number else 1.0
    return np.column_stack(list(columns.values()))
