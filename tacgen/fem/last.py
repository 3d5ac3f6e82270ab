"""One remembered answer: energy, gradient and stiffness are asked for at the same positions one after the other."""

from collections.abc import Callable
from typing import Any

import numpy as np


class Last:
    """Keeps what was computed for the last array asked about, told by identity: positions are never edited."""

    def __init__(self) -> None:
        self._key: np.ndarray | None = None
        self._value: Any = None

    def of(self, x: np.ndarray, make: Callable[[np.ndarray], Any]) -> Any:
        """make(x), or what it gave the last time if that was for this very array."""
        if self._key is not x:
            self._key, self._value = None, make(x)
            self._key = x
        return self._value
