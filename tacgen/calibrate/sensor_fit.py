"""Whether a fit is plausible, and the sensor file written from it: every `calibrate` command writes its fit here."""

import os
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from tacgen.base import output_file
from tacgen.base.errors import UserError
from tacgen.recipe import assets, loading, sensor_checks
from tacgen.sensor import usual_values, yaml_source
from tacgen.sensor.layers import Layer
from tacgen.sensor.model import LIGHT_FIELDS, LitSensor, Sensor
from tacgen.sensor.validation_messages import Issue, report
from tacgen.sensor.yaml_source import KeyPath, Source, Tree, format_path

Array = np.ndarray
FORCE_ERROR_FLOOR = 0.05  # of the largest force: errors of smaller forces are relative to this
# rms error of the fitted forces over the rms force, from which they do not follow the measured ones
MAX_RMS_FORCE_ERROR = 0.3
MAX_DENT_RESIDUAL_RATIO = 0.5  # of the change that a drift leaves: the most that dents may leave to count as seen
# relative error of one force, after that which the method expects of it, from which it is no scatter
MAX_SINGLE_FORCE_ERROR = 3.0


@dataclass(frozen=True)
class Evidence:
    """Grounds on which a fit is judged; each is left out where a fit has none of it."""

    force: tuple[Array, Array, Array | float] | None = None  # fitted, measured (n,) [N]; factors on expected errors
    pictures: tuple[float, float] | None = None  # shares of their change explained by dents, and by a drift alone
    unseen: str = ""  # why the fit is no better than its start on measurements that it has not seen


@dataclass(frozen=True)
class SensorFit(ABC):
    """A fit: the sensor file it starts from, and the values of it that it changes."""

    path: Path
    sensor: Sensor  # before the fit
    changes: dict[KeyPath, Any]  # None: the key is removed

    @abstractmethod
    def lines(self) -> Iterator[str]:
        """Report in text."""

    @abstractmethod
    def plain(self) -> dict[str, Any]:
        """Report as JSON values."""

    @abstractmethod
    def draw(self, out: Path) -> None:
        """Draw the fit over what was measured into `out`."""

    @abstractmethod
    def evidence(self) -> Evidence:
        """Grounds on which the fit is judged."""

    @property
    def interrupted(self) -> str:
        """Note on what Ctrl-C has left out of the fit; empty if it is complete."""
        return ""

    @property
    def changed(self) -> dict[str, Any]:
        """The changed values by their paths as text."""
        return {format_path(path): value for path, value in self.changes.items()}

    def head(self) -> Iterator[str]:
        """Lines of a comment at the head of the written file."""
        yield from ()

    def problem(self) -> str:
        """Why the fit should not be used, in a line; empty for a plausible one."""
        return "; ".join((*_of_file(self), *_of_evidence(self.evidence())))

    def refuse(self, out: Path) -> None:
        """Raise UserError if there is a problem with the fit that was to be written to `out`."""
        if said := self.problem():
            raise UserError(f"{out}: not written: {said}; --anyway writes it")

    def write(self, out: Path, *, anyway: bool = False) -> None:
        """Write the changed sensor file; comments are kept. Raises UserError: there is a problem, and no `anyway`."""
        if not anyway:
            self.refuse(out)
        notes = [self.interrupted, *self.head()] if self.interrupted else self.head()
        write_sensor(self.path, self.sensor, self.changes, out, "".join(f"# {line}\n" for line in notes))


def off(fitted: Array, measured: Array) -> Array:
    """Relative errors of fitted forces (n,); forces below FORCE_ERROR_FLOOR of the largest are compared with that."""
    return np.asarray((fitted - measured) / np.maximum(np.abs(measured), FORCE_ERROR_FLOOR * np.abs(measured).max()))


def no_dents(dents: float, drift: float) -> str:
    """Why pictures show no presses, from the shares of their change explained by dents and by a drift; or ""."""
    if 1 - dents < MAX_DENT_RESIDUAL_RATIO * (1 - drift):
        return ""
    return (f"dents explain {100 * dents:.0f} % of the pictures' change, and light that drifts {100 * drift:.0f} %: see"
            " that the contacts' rims show, and press lightly and hard in turn, at several places")  # fmt: skip


def _of_file(fit: SensorFit) -> Iterator[str]:
    """Changed values that no gel has, or that make a sensor file which `validate` refuses."""
    text = yaml_source.edited(fit.path, fit.changes)
    tree = yaml_source.parse(text, Source(str(fit.path), tuple(text.splitlines()), fit.path.parent))
    made, wrong = sensor_checks.check(tree.data, loading.solid_folder(tree))
    if made is not None:
        wrong = [issue for issue in usual_values.unusual(made.gel) if issue.path in fit.changes]
    yield from (f"{format_path(issue.path)}: {issue.message}" for issue in wrong)


def _of_evidence(known: Evidence) -> Iterator[str]:
    if known.force is not None:
        fitted, measured, doubt = known.force
        each = np.abs(off(fitted, measured)) / doubt
        worst, whole = int(each.argmax()), float(np.linalg.norm(fitted - measured) / np.linalg.norm(measured))
        if whole > MAX_RMS_FORCE_ERROR or each[worst] > MAX_SINGLE_FORCE_ERROR:
            yield (f"the fitted forces do not follow the measured ones: off by {100 * whole:.0f} % rms, and"
                   f" {fitted[worst]:.3g} N where {measured[worst]:.3g} N was measured")  # fmt: skip
    if known.pictures is not None and (said := no_dents(*known.pictures)):
        yield said
    if known.unseen:
        yield known.unseen


def lit_sensor(path: Path) -> tuple[LitSensor, Tree]:
    """The sensor of a file, and its text. Raises UserError: lights are missing."""
    sensor, tree = loading.read_sensor(path)
    if not sensor.lit:
        missing = next(part for part in LIGHT_FIELDS if getattr(sensor, part) is None)
        problem = Issue((missing,), "is missing: a fit starts from a file with all its lights, roughly placed")
        raise report([(problem, tree)])
    return cast(LitSensor, sensor), tree


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
        changes[loading.SOLID_FILE_KEY] = os.path.relpath(solid.resolve(), out.parent.resolve())
    output_file.put(out, (head + yaml_source.edited(path, changes)).encode(), overwrite=True)
