"""What a fit found: a sensor, and how well it explains the photographs; and the sensor file with it."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.recipe import assets, loading, yaml_source
from tacgen.recipe.sensor import LitSensor, Sensor
from tacgen.recipe.yaml_source import KeyPath

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


def digits(value: Any) -> Any:
    """Numbers with four digits, as a person would write them."""
    if isinstance(value, tuple):
        return [digits(v) for v in value]
    return float(f"{value:.4g}")


def write_sensor(path: Path, sensor: Sensor, changes: Mapping[KeyPath, Any], out: Path) -> None:
    """A sensor file with changes in it, its comments kept; the file of a solid gel is found from the new place too."""
    changes = dict(changes)
    if sensor.gel.solid is not None:
        solid = assets.mesh_path(sensor.gel.solid.file, path.parent)
        changes[loading.SOLID] = os.path.relpath(solid.resolve(), out.parent.resolve())
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(yaml_source.edited(path, changes), encoding="utf-8")
