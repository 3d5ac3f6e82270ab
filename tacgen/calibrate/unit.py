"""Calibration of a sensor file to one unit: gel thickness, modulus, zero of the gauge and lights from ball presses."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from tacgen.calibrate import plausible
from tacgen.calibrate.led_fit import FitLimits, changes_of
from tacgen.calibrate.plausible import Evidence, SensorFit
from tacgen.calibrate.result import digits, moduli
from tacgen.errors import UserError
from tacgen.recipe import assets, loading
from tacgen.sensor.model import LIGHTS, LitSensor
from tacgen.sensor.validation_messages import Issue, report
from tacgen.sensor.yaml_source import KeyPath, format_path

if TYPE_CHECKING:
    from tacgen.calibrate.fit_material import Estimate
    from tacgen.calibrate.fit_unit import Gauge, Judged, UnitFit
    from tacgen.calibrate.result import Fitted
    from tacgen.calibrate.unit_photos import UnitPhotos

BY = "by tacgen calibrate unit"
EXPLAINED = 0.3  # least share of the pictures' changes that dents of the given balls explain
DEEP = 0.999  # of the largest depth that is solved
MEASURE = {
    "thickness": "press until the contact is wider than the gel is thick, also with a larger ball, or give"
    " --keep-thickness and the thickness in the sensor file",
    "modulus": "press to larger and more different forces",
    "zero": "press lightly as well as hard",
    "lag": "record the press and its release with more pictures, or leave time_s out",
}


@dataclass(frozen=True)
class Asked:
    """Choice of the numbers that are fitted, and assumed ones."""

    friction: float = 0.5  # of the balls on the gel
    quality: str = "draft"  # of the solved presses
    thickness: bool = True  # find it; else the file's holds
    lights: bool = True  # fit them, too
    limits: FitLimits = field(default_factory=FitLimits)


@dataclass(frozen=True)
class Unit(SensorFit):
    """A fitted unit, and its judgement on presses that fits have not seen."""

    sensor: LitSensor
    photos: "UnitPhotos"
    gauge: "Gauge"
    drift: float  # share of the pictures' changes that drifting light alone explains, without a dent
    asked: Asked
    fitted: "UnitFit"
    judged: "tuple[Judged, ...]"  # each of some held-out presses
    lights: "Fitted | None"

    @property
    def lit(self) -> bool:
        """Whether the fitted lights are used: they are better on presses that their fit has not seen."""
        return self.lights is not None and self.lights.unseen is not None and self.lights.unseen.better

    @property
    def said(self) -> str:
        """The photographs in words."""
        count, balls = len(self.photos.presses), sorted({press.ball for press in self.photos.presses})
        radii = " and ".join(f"{ball:g}" for ball in balls)
        return f"{count} presses of balls of radius {radii} mm with forces ({self.photos.folder.resolve().name})"

    def lines(self) -> Iterator[str]:
        """Report in text."""
        fitted = self.fitted
        yield f"{self.sensor.name}: fitted to {self.said}"
        yield from (f"  {line}" for line in self.found())
        yield f"  friction {self.asked.friction:g}: assumed"
        yield (f"pictures: dents of these balls explain {100 * fitted.optics.explained:.0f} % of the change, light that"
               f" drifts {100 * self.drift:.0f} %")  # fmt: skip
        readings = [press.force for press in self.photos.presses]
        off = sum(abs(a - b) for a, b in zip(fitted.force, readings, strict=True)) / len(readings)
        yield f"forces that the fit has seen: off by {off:.2f} N in the mean (from 0 to {max(readings):.3g} N)"
        yield from self.unseen()
        if self.lights is not None:
            yield f"untouched: off by {self.lights.untouched:.1f} counts rms (before the fit: {self.lights.before:.1f})"
            told = self.lights.unseen or "too few presses to hold any out"
            kept = "" if self.lit else ": NOT BETTER, the file's lights are kept (see tacgen calibrate optics)"
            yield f"pictures of presses not seen by the fit of the lights: {told}{kept}"
        for key, value in self.changes.items():
            if key[-1] in ("thickness_mm", *(k for layer in self.sensor.gel.layers for k in moduli(layer))):
                yield f"{format_path(key)}: {value}"

    def found(self) -> Iterator[str]:
        """Each number with its interval."""
        fitted, gel = self.fitted, self.sensor.gel
        yield _shown(fitted.thickness, "thickness", " mm") if self.asked.thickness else (
            f"thickness: {gel.thickness_mm:g} mm, the file's")  # fmt: skip
        yield _shown(fitted.modulus, "moduli", " times the file's")
        for layer in gel.layers:
            for key in moduli(layer):
                low, value, high = (getattr(layer, key) * m for m in (
                    fitted.modulus.low, fitted.modulus.value, fitted.modulus.high))  # fmt: skip
                yield f"{layer.name} {key}: {value:.4g} (95 %: {low:.4g} to {high:.4g})"
        yield _shown(fitted.zero, "zero of the gauge", " N")
        names = self.photos.recordings
        for k, lag in fitted.lags.items():
            yield _shown(lag, f"lag of the gauge in recording {names[k]}", " s")

    def unseen(self) -> Iterator[str]:
        """Errors of forces held out from a fit, beside the errors without pictures and the least possible ones."""
        if not self.judged:
            yield "not judged: too few presses to hold any out"
            return
        for one in self.judged:
            others = {"as recorded, without alignment in time": one.unaligned,
                      "with the colours of the seen presses": one.foreign}  # fmt: skip
            beside = [f"{how}: {one.mae(said):.2f}" for how, said in others.items() if (said != one.predicted).any()]
            told = f" ({'; '.join(beside)})" if beside else ""
            yield (f"forces of {len(one.force)} presses not seen by the fit ({one.name}): off by"
                   f" {one.mae(one.predicted):.2f} N{told}; mean of the seen forces: {one.mae(one.floor):.2f} N; best"
                   f" rising curve over the found depth: {one.mae(one.ceiling):.2f} N")  # fmt: skip

    def plain(self) -> dict[str, Any]:
        """Report as JSON values."""
        fitted = self.fitted
        every = {"thickness_mm": fitted.thickness, "modulus": fitted.modulus, "zero_n": fitted.zero}
        every |= {f"lag_s {self.photos.recordings[k]}": lag for k, lag in fitted.lags.items()}
        return {
            "sensor": self.sensor.name, "explained": fitted.optics.explained, "drift": self.drift,
            "estimates": {name: {"value": e.value, "low": e.low, "high": e.high} for name, e in every.items()},
            "presses": [{"file": press.name, "force_n": press.force, "fitted_n": float(force), "depth_mm": float(depth)}
                        for press, force, depth in zip(self.photos.presses, fitted.force, fitted.depth, strict=True)],
            "unseen": [one.plain() for one in self.judged],
            "lights": None if self.lights is None else {"untouched": self.lights.untouched,
                                                        "before": self.lights.before, "used": self.lit},
            "changes": {format_path(key): value for key, value in self.changes.items()},
        }  # fmt: skip

    def head(self) -> Iterator[str]:
        """Numbers that were found, and how well."""
        yield f"Fitted {BY} to {self.said}:"
        yield from (f"  {line}" for line in self.found())
        yield from self.unseen()

    def evidence(self) -> Evidence:
        """Forces, pictures, and forces of unseen presses against the mean of the seen ones."""
        fitted, no_better = self.fitted, ""
        if self.judged:
            each = [(one.mae(one.predicted), one.mae(one.floor)) for one in self.judged]
            error, guess = (sum(part) / len(each) for part in zip(*each, strict=True))
            if error >= guess:
                no_better = (f"forces of presses that it has not seen are off by {error:.2f} N, and the mean of the"
                             f" seen forces by {guess:.2f} N")  # fmt: skip
        forces = fitted.force, self.gauge.force, self.gauge.doubt
        return Evidence(forces, (fitted.optics.explained, self.drift), no_better)

    def draw(self, out: Path) -> None:
        """Plot fitted over measured forces, seen and unseen, into `out`."""
        from tacgen.report import unit_figure

        seen = [
            (press.force, float(force)) for press, force in zip(self.photos.presses, self.fitted.force, strict=True)
        ]
        unseen = [pair for one in self.judged for pair in zip(one.force, one.predicted, strict=True)]
        unit_figure.draw(seen, unseen, out)


def _shown(one: "Estimate", name: str, unit: str) -> str:
    reach = "at the end of its range" if one.bound else f"95 %: {one.low:.4g} to {one.high:.4g}"
    return f"{name}: {one.value:.4g}{unit} ({reach})"


def unit(name: str, folder: Path, asked: Asked | None = None) -> Unit:
    """Fit a sensor file, given by name or path, to the presses in a folder.

    Raises:
        UserError: presses that are missing, cannot be used, or do not determine a number, a line each.
    """
    from tacgen.calibrate import unit_fitting, unit_photos
    from tacgen.calibrate.drift import share
    from tacgen.calibrate.photos import TABLE

    asked, path = asked or Asked(), assets.sensor_path(name)
    if not 0 <= asked.friction <= 10:  # nor nan
        raise UserError(f"--friction: must be from 0 to 10 (got {asked.friction:g})")
    sensor, tree = loading.read_sensor(path)
    if not sensor.lit:
        missing = next(part for part in LIGHTS if getattr(sensor, part) is None)
        raise report(
            [(Issue((missing,), "is missing: a fit starts from a file with all its lights, roughly placed"), tree)]
        )
    if sensor.gel.solid is not None or any(layer.scattering for layer in sensor.gel.clear_layers):
        raise UserError(f"{path}: gel: must be a pad that is clear: the rim of a contact shows on such a gel alone")
    lit, photos = cast(LitSensor, sensor), unit_photos.read(folder, sensor.camera)
    work = unit_fitting.Work.of(lit, photos, asked)
    raw, drift = work.fitted(), share(work.pictures, work.gauge)
    if wrong := [*work.too_deep(raw), *_undetermined(raw, folder / TABLE)]:
        no_dents = plausible.no_dents(raw.optics.explained, drift)
        raise UserError(f"{folder / TABLE}: {no_dents}" if no_dents else wrong)
    fitted = work.corrected(raw)
    judged, lights = work.judged(), work.lights(fitted) if asked.lights else None
    made = Unit(path, lit, {}, photos, work.gauge, drift, asked, fitted, judged, lights)
    return replace(made, changes=_changes(made, work.at_thickness(fitted)))


def _undetermined(fitted: "UnitFit", table: Path) -> Iterator[str]:
    """A line on each number that the presses do not determine, and what to measure."""
    if (share := fitted.optics.explained) < EXPLAINED:
        yield (f"{table}: dents of these balls explain {100 * share:.0f} % of the pictures' change: are"
               " radii, mm_per_px and the untouched picture right?")  # fmt: skip
        return
    tried = fitted.optics.thickness
    for name in fitted.open:
        reach = f" within {tried[0]:.3g} to {tried[-1]:.3g} mm" if name == "thickness" else ""
        yield f"{table}: {name}: is not determined{reach} by these presses: {MEASURE[name.split()[0]]}"


def _changes(made: Unit, now: LitSensor) -> dict[KeyPath, Any]:
    """Changed values of the sensor file by path; `now` has the fitted thickness."""
    fitted, out = made.fitted, dict[KeyPath, Any]()
    if made.lit and made.lights is not None:
        out |= changes_of(now, made.lights, f"presses of one unit ({made.photos.folder.resolve().name})",
                          bare=made.asked.limits.bare)  # fmt: skip
    thickness, modulus = fitted.thickness, fitted.modulus
    for k, (layer, new) in enumerate(zip(made.sensor.gel.layers, now.gel.layers, strict=True)):
        here: KeyPath = ("gel", "layers", k)
        if made.asked.thickness:
            out[*here, "thickness_mm"] = digits(new.thickness_mm)
        out |= {(*here, key): digits(modulus.value * getattr(layer, key)) for key in moduli(layer)}
        thick = (
            f"the gel's thickness {thickness.value:.3g} mm ({thickness.low:.3g} to {thickness.high:.3g} with 95 %), "
        )
        out[*here, "source"] = (
            f"{layer.source}; {thick if made.asked.thickness else ''}moduli times {modulus.value:.4g}"
            f" ({modulus.low:.3g} to {modulus.high:.3g} with 95 %), fitted to {made.said} {BY}"
        )
    for k, led in enumerate(now.leds):
        if led.center_mm != made.sensor.leds[k].center_mm:
            out.setdefault(("leds", k, "center_mm"), [round(v, 3) for v in led.center_mm])
    return out
