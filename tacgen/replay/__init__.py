"""Contacts of other simulators solved again: their logs become a recipe, whose frames are compared with their forces.

read the logs -> select the rows near contact -> write tables and a recipe -> run it -> compare the forces
"""

from collections.abc import Sequence

from tacgen.bundle.bundle import read
from tacgen.bundle.resume import SceneResult
from tacgen.replay import comparison
from tacgen.replay.comparison import Compared
from tacgen.replay.preparation import Prepared, prepare
from tacgen.replay.selection import Choice

__all__ = ["Choice", "Prepared", "compared", "prepare"]


def compared(prepared: Prepared, results: Sequence[SceneResult]) -> list[Compared]:
    """The frames of each finished scene beside the log's rows; a scene that failed has no bundle and is left out."""
    made = [(log, result.path) for log, result in zip(prepared.logs, results, strict=True) if result.status != "failed"]
    return [comparison.compare(log, read(path), prepared.sensor_pose) for log, path in made]
