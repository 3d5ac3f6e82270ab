"""Calibration of a sensor file to one unit: gel thickness, modulus, zero of the gauge and lights from ball presses."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base.errors import UserError
from tacgen.calibrate import (
    cross_validation,
    dent_tables,
    indentation_fit,
    photometric_fit,
    press_localisation,
    sensor_fit,
)
from tacgen.calibrate import photos as reading
from tacgen.calibrate.cross_validation import Fitted
from tacgen.calibrate.dent_tables import Dents, with_thickness
from tacgen.calibrate.indentation_fit import Gauge, HeldOutForces, IndentationFit
from tacgen.calibrate.optics import changes_of
from tacgen.calibrate.photometric_model import FitLimits
from tacgen.calibrate.photos import PRESS_TABLE_FILE, GaugedPhotos, PhotographedPress, Photos
from tacgen.calibrate.press_localisation import PressPicture, PressView
from tacgen.calibrate.sensor_fit import Evidence, SensorFit, digits, moduli
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.surface_grid import Untouched
from tacgen.recipe import assets
from tacgen.report import fit_figures
from tacgen.sensor.model import LitSensor
from tacgen.sensor.yaml_source import KeyPath, format_path

UNIT_SOURCE = "by tacgen calibrate unit"
MIN_EXPLAINED_SHARE = 0.3  # least share of the pictures' changes that dents of the given balls explain
# contact radius that is solved, over the largest rough one; and its steps
CONTACT_RADIUS_MARGIN, CONTACT_RADIUS_RATIO = 1.2, 1.25
LIGHT_FIT_PRESSES = 6  # presses to which lights are fitted
MIN_LIGHT_FIT_DEPTH = 0.4  # of the deepest press: least depth of those
DEEPEST_SOLVED_SHARE = 0.999  # of the largest depth that is solved
UNIT_MEASURE_HINTS = {
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
    photos: GaugedPhotos
    gauge: Gauge
    drift: float  # share of the pictures' changes that light explains which drifts, without any dent
    asked: Asked
    fitted: IndentationFit
    judged: tuple[HeldOutForces, ...]  # each of some held-out presses
    lights: Fitted | None

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
        yield (f"pictures: dents of these balls explain {100 * fitted.scan.explained:.0f} % of the change, light that"
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
        yield fitted.thickness.told("thickness", " mm") if self.asked.thickness else (
            f"thickness: {gel.thickness_mm:g} mm, the file's")  # fmt: skip
        yield fitted.modulus.told("moduli", " times the file's")
        for layer in gel.layers:
            for key in moduli(layer):
                low, value, high = (getattr(layer, key) * m for m in (
                    fitted.modulus.low, fitted.modulus.value, fitted.modulus.high))  # fmt: skip
                yield f"{layer.name} {key}: {value:.4g} (95 %: {low:.4g} to {high:.4g})"
        yield fitted.zero.told("zero of the gauge", " N")
        names = self.photos.recordings
        for k, lag in fitted.lags.items():
            yield lag.told(f"lag of the gauge in recording {names[k]}", " s")

    def unseen(self) -> Iterator[str]:
        """Errors of forces that a fit has not seen, beside what they would be without pictures and at best."""
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
            "sensor": self.sensor.name, "explained": fitted.scan.explained, "drift": self.drift,
            "estimates": {name: {"value": e.value, "low": e.low, "high": e.high} for name, e in every.items()},
            "presses": [{"file": press.name, "force_n": press.force, "fitted_n": float(force), "depth_mm": float(depth)}
                        for press, force, depth in zip(self.photos.presses, fitted.force, fitted.depth, strict=True)],
            "unseen": [one.plain() for one in self.judged],
            "lights": None if self.lights is None else {"untouched": self.lights.untouched,
                                                        "before": self.lights.before, "used": self.lit},
            "changes": self.changed,
        }  # fmt: skip

    def head(self) -> Iterator[str]:
        """Numbers that were found, and how well."""
        yield f"Fitted {UNIT_SOURCE} to {self.said}:"
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
        forces = fitted.force, self.gauge.force, self.gauge.error_factors
        return Evidence(forces, (fitted.scan.explained, self.drift), no_better)

    def draw(self, out: Path) -> None:
        """Plot fitted over measured forces, seen and unseen, into `out`."""
        seen = [
            (press.force, float(force)) for press, force in zip(self.photos.presses, self.fitted.force, strict=True)
        ]
        unseen = [pair for one in self.judged for pair in zip(one.force, one.predicted, strict=True)]
        fit_figures.computed_over_measured(seen, unseen, out)


@dataclass(frozen=True)
class Inputs:
    """All that the steps share."""

    sensor: LitSensor
    photos: GaugedPhotos
    asked: Asked
    view: PressView
    pictures: tuple[PressPicture, ...]
    gauge: Gauge
    dents: tuple[Mapping[float, Dents], ...]  # by tried thickness, then by the ball's radius

    @classmethod
    def of(cls, sensor: LitSensor, photos: GaugedPhotos, asked: Asked) -> "Inputs":
        """Solve presses of each ball at each tried thickness; minutes, unless they are in the cache.

        Raises UserError: presses that cannot be solved.
        """
        view, number = PressView(sensor), {name: k for k, name in enumerate(photos.recordings)}
        pictures = tuple(view.picture(p.picture, p.untouched, p.ball, number[p.recording]) for p in photos.presses)
        gauge = Gauge(*(np.array(part) for part in zip(
            *((p.force, number[p.recording], p.time) for p in photos.presses), strict=True)))  # fmt: skip
        rough = view.starts(pictures)
        step = sensor.gel.thickness_mm / 2  # rounded, so that other presses of the unit find them in the cache
        x, y = (float(step * np.round(v / step)) for v in np.median(rough[:, 1:], axis=0))
        tried = indentation_fit.THICKNESS_FACTORS if asked.thickness else (1.0,)
        dents = []
        for factor in tried:
            one = with_thickness(sensor, factor * sensor.gel.thickness_mm)
            each = {}
            for ball in sorted({picture.ball for picture in pictures}):
                here = [k for k, picture in enumerate(pictures) if picture.ball == ball]
                widest = np.log(CONTACT_RADIUS_MARGIN * np.sqrt(1.6 * ball * rough[here, 0].max())) / np.log(
                    CONTACT_RADIUS_RATIO
                )
                most = round(float(CONTACT_RADIUS_RATIO ** np.ceil(widest)), 3)
                each[ball] = dent_tables.solved(one, ball, (x, y), most, asked.friction, asked.quality)
            dents.append(each)
        return cls(sensor, photos, asked, view, pictures, gauge, tuple(dents))

    def fitted(self) -> IndentationFit:
        """The fit to all presses. Raises UserError: too few presses."""
        scan = indentation_fit.thickness_scan(self.view, self.pictures, self.dents)
        try:
            return indentation_fit.fit(scan, self.pictures, self.dents, self.gauge)
        except ValueError as error:
            raise UserError(f"{self.photos.folder / PRESS_TABLE_FILE}: {error}") from None

    def too_deep(self, found: IndentationFit) -> Iterator[str]:
        """A line on each press that is deeper than what is solved."""
        k = found.scan.between(found.scan.best)[0]
        for press, picture, depth in zip(self.photos.presses, self.pictures, found.depth, strict=True):
            if depth > DEEPEST_SOLVED_SHARE * (deepest := self.dents[k][picture.ball].depth[-1]):
                yield (f"{self.photos.folder / press.name}: is pressed deeper than {deepest:.3g} mm, the most that a"
                       f" gel of {found.thickness.value:.3g} mm is solved for: leave it out")  # fmt: skip

    def judged(self) -> tuple[HeldOutForces, ...]:
        """Judgements by recordings that a fit has not seen, or by presses if there is one recording alone."""
        names = self.photos.recordings
        group = self.gauge.recording if len(names) > 1 else np.arange(len(self.pictures))
        out = []
        for held in cross_validation.folds(int(group.max()) + 1):
            where = np.isin(group + 1, held)
            name = (
                ", ".join(names[k - 1] for k in held)
                if len(held) == 1 and len(names) > 1
                else f"{where.sum()} held out"
            )
            try:
                found = indentation_fit.held_out_forces(self.view, self.pictures, self.dents, self.gauge, where)
            except ValueError:
                continue  # the others are too few
            out.append(replace(found, name=name))
        return tuple(out)

    def at_thickness(self, fitted: IndentationFit) -> LitSensor:
        """The sensor with the fitted thickness."""
        return with_thickness(self.sensor, fitted.thickness.value) if self.asked.thickness else self.sensor

    def lights(self, fitted: IndentationFit) -> Fitted:
        """The lights of the sensor with the fitted thickness, fitted to how some of the presses at their found depths
        change the picture: the untouched one, with its glare, can be the background of rendered pictures."""
        deep = [k for k in np.argsort(fitted.depth) if fitted.depth[k] > MIN_LIGHT_FIT_DEPTH * fitted.depth.max()]
        some = [int(deep[round(k)]) for k in np.linspace(0, len(deep) - 1, min(LIGHT_FIT_PRESSES, len(deep)))]
        sensor = self.at_thickness(fitted)
        photos = Photos(self.photos.folder, self.photos.presses[0].untouched, self._shown(fitted, some))
        untouched = Untouched.of(sensor.gel)
        faces = [fitted.face(untouched, self.dents, self.pictures[n].ball, n) for n in some]
        return photometric_fit.fit_faces(sensor, photos, faces, self.asked.limits, changes=True)

    def _shown(self, fitted: IndentationFit, some: list[int]) -> tuple[PhotographedPress, ...]:
        """Some presses, shown as changes of the first untouched picture."""
        best, camera = fitted.scan.between(fitted.scan.best)[0], PinholeCamera.from_sensor(self.sensor)
        first, out = self.photos.presses[0].untouched, []
        for k in some:
            press, (_, x, y), depth = self.photos.presses[k], fitted.scan.placed[best].at[k], float(fitted.depth[k])
            center = camera.project([[x, y, -depth]])[0]
            contact = self.dents[best][press.ball].contact_at(depth) / camera.mm_per_px
            shown = np.clip(first + (press.picture.astype(float) - press.untouched), 0, 255).astype(np.uint8)
            at, ball = (float(center[0]), float(center[1])), press.ball
            out.append(PhotographedPress(press.name, shown, ball, at, contact, depth, aspect=camera.aspect))
        return tuple(out)


def unit(name: str, folder: Path, asked: Asked | None = None) -> Unit:
    """Fit a sensor file, given by name or path, to the presses in a folder.

    Raises:
        UserError: presses that are missing, cannot be used, or do not determine a number, a line each.
    """
    asked, path = asked or Asked(), assets.sensor_path(name)
    if not 0 <= asked.friction <= 10:  # nor nan
        raise UserError(f"--friction: must be from 0 to 10 (got {asked.friction:g})")
    sensor, _ = sensor_fit.lit_sensor(path)
    if sensor.gel.solid is not None or any(layer.scattering for layer in sensor.gel.clear_layers):
        raise UserError(f"{path}: gel: must be a pad that is clear: the rim of a contact shows on such a gel alone")
    photos = reading.read_gauged(folder, sensor.camera)
    work = Inputs.of(sensor, photos, asked)
    raw = work.fitted()
    drift = press_localisation.drift(work.pictures, work.gauge.recording, work.gauge.time)
    if wrong := [*work.too_deep(raw), *_undetermined(raw, folder / PRESS_TABLE_FILE)]:
        no_dents = sensor_fit.no_dents(raw.scan.explained, drift)
        raise UserError(f"{folder / PRESS_TABLE_FILE}: {no_dents}" if no_dents else wrong)
    fitted = indentation_fit.corrected(raw, work.at_thickness(raw), work.view, work.pictures, work.dents, work.gauge)
    judged, lights = work.judged(), work.lights(fitted) if asked.lights else None
    made = Unit(path, sensor, {}, photos, work.gauge, drift, asked, fitted, judged, lights)
    return replace(made, changes=_changes(made, work.at_thickness(fitted)))


def _undetermined(fitted: IndentationFit, table: Path) -> Iterator[str]:
    """A line on each number that the presses do not determine, and what to measure."""
    if (share := fitted.scan.explained) < MIN_EXPLAINED_SHARE:
        yield (f"{table}: dents of these balls explain {100 * share:.0f} % of the pictures' change: are"
               " radii, mm_per_px and the untouched picture right?")  # fmt: skip
        return
    tried = fitted.scan.thickness
    for name in fitted.open:
        reach = f" within {tried[0]:.3g} to {tried[-1]:.3g} mm" if name == "thickness" else ""
        yield f"{table}: {name}: is not determined{reach} by these presses: {UNIT_MEASURE_HINTS[name.split()[0]]}"


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
            f" ({modulus.low:.3g} to {modulus.high:.3g} with 95 %), fitted to {made.said} {UNIT_SOURCE}"
        )
    for k, led in enumerate(now.leds):
        if led.center_mm != made.sensor.leds[k].center_mm:
            out.setdefault(("leds", k, "center_mm"), [round(v, 3) for v in led.center_mm])
    return out
