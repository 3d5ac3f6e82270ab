"""How a simulator takes part: it plays cases and answers with forces on the gel."""

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from benchmarks.referee.case import Case

Array = np.ndarray


class NotPlayed(Exception):
    """The simulator has no means for a case, or failed in it; the text is the reason, which the table tells."""


@dataclass(frozen=True)
class Answer:
    """A player's answer in the n frames that a case judges. All forces are ON THE GEL, in the sensor's frame, z out
    of the gel: those of a press have a negative z.

    force (n, 3) [N] and torque (n, 3) [N mm], nan without any, about the untouched contact's lowest point; seconds of
    processor time a frame, of all frames, on one core, or of wall time on a GPU if `on_gpu`; settings that matter, as
    they are printed. If the simulator has them: pressure (n, CELLS, CELLS) [MPa] and traction (n, CELLS, CELLS, 2)
    [MPa] per area of a cell of `case.grid()`, at the deformed place, as `case.spread` makes them of forces at points;
    markers (n, DOTS^2, 2): how far the face has moved along x and y at `case.dots()` [mm].
    """

    force: Array
    torque: Array
    seconds: float
    settings: dict[str, Any] = field(default_factory=dict)
    pressure: Array | None = None
    traction: Array | None = None
    markers: Array | None = None
    on_gpu: bool = False


class Player(Protocol):
    """A simulator by its own public interface: a module of `players` holds one or several as PLAYERS."""

    name: str
    settings: tuple[str, ...]  # such as "default", "tuned"; the first is what a user gets who sets nothing

    def available(self) -> str | None:
        """Why it does not run here, in a few words; None if it runs."""

    def version(self) -> str:
        """Name and version of the simulator."""

    def play(self, case: Case, setting: str) -> Answer:
        """Play a case. Raises NotPlayed: it has no means for it, or failed."""
