"""The result of a fit to photographs, and writing of the changed sensor file."""

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen import output_file
from tacgen.recipe import assets, loading
from tacgen.sensor import yaml_source
from tacgen.sensor.layers import Layer
from tacgen.sensor.model import LitSensor, Sensor
from tacgen.sensor.yaml_source import KeyPath

if TYPE_CHECKING:
    from tacgen.calibrate.unseen import Unseen

Array = np.ndarray


@dataclass(frozen=True)
class Fitted:
    """A fitted sensor; misfits are rms in 8-bit counts."""

    sensor: LitSensor
    untouched: float
    before: float  # the same before the fit
    presses: float | None = None  # of the change under the presses, all of them seen by this fit
    deeper: float = 1.0  # factor on all given depths
    unseen: "Unseen | None" = None  # None: too few presses to hold any out
    ridge: float | None = None  # weight of the sensor file's values that suits unseen presses best
    determined: Mapping[str, float] = field(default_factory=dict)  # share of each parameter, see unseen.determined


def rms(parts: list[Array]) -> float:
    """Root mean square over arrays of any shapes."""
    return float(np.sqrt(np.mean(np.concatenate([p.ravel() for p in parts]) ** 2)))


def rgb(row: Array) -> tuple[float, float, float]:
    """Three plain numbers."""
    return float(row[0]), float(row[1]), float(row[2])


def digits(value: Any) -> Any:
    """Numbers with four significant digits."""
    if isinstance(value, tuple):
        return [digits(v) for v in value]
    return float(f"{value:.4g}")


def moduli(layer: Layer) -> Iterator[str]:
    """The keys of a layer's moduli; forces are proportional to all of them together."""
    for key in type(layer).model_fields:
        if key.endswith("_mpa") and getattr(layer, key) is not None:
            yield key


def write_sensor(path: Path, sensor: Sensor, changes: Mapping[KeyPath, Any], out: Path, head: str = "") -> None:
    """Write a sensor file with changes below a `head`; comments are kept, and the path of a solid gel is adapted to the
    new place."""
    changes = dict(changes)
    if sensor.gel.solid is not None:
        solid = assets.mesh_path(sensor.gel.solid.file, path.parent)
        changes[loading.SOLID] = os.path.relpath(solid.resolve(), out.parent.resolve())
    output_file.put(out, (head + yaml_source.edited(path, changes)).encode(), overwrite=True)
