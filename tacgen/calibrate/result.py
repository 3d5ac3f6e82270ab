"""What a fit found: a sensor, and how well it explains the photographs."""

from dataclasses import dataclass

import numpy as np

from tacgen.recipe.sensor import LitSensor

Array = np.ndarray


@dataclass(frozen=True)
class Fitted:
    """Misfits in counts of 8 bit, root mean square."""

    sensor: LitSensor
    untouched: float
    before: float  # the same of the sensor file as it was
    presses: float | None = None  # of how the presses change the picture
    held_out: float | None = None  # of those the fit has not seen
    deeper: float = 1.0  # what all depths that were given seem to be off by
    judged: LitSensor | None = None  # fitted without those held out, that they can judge it


def rms(parts: list[Array]) -> float:
    """Root mean square over arrays of any shapes."""
    return float(np.sqrt(np.mean(np.concatenate([p.ravel() for p in parts]) ** 2)))


def rgb(row: Array) -> tuple[float, float, float]:
    """Plain numbers."""
    return float(row[0]), float(row[1]), float(row[2])
