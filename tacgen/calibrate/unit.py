"""Calibration of a sensor file to one unit: gel thickness, modulus, zero of the gauge and lights from ball presses."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base.errors import UserError
from tacgen.calibrate import (
    contrast_fit,
    cross_validation,
    dent_family,
    indentation_fit,
    photometric_fit,
    press_localisation,
    sensor_fit,
    steps,
)
from tacgen.calibrate import photos as reading
from tacgen.calibrate.contrast_fit import ContrastFit
from tacgen.calibrate.cross_validation import Fitted
from tacgen.calibrate.dent_tables import with_thickness
from tacgen.calibrate.indentation_fit import Gauge, GaugedPresses, HeldOutForces, IndentationFit
from tacgen.calibrate.optics import changes_of
from tacgen.calibrate.photometric_model import FitLimits
from tacgen.calibrate.photos import PRESS_TABLE_FILE, GaugedPhotos, PhotographedPress, Photos
from tacgen.calibrate.press_localisation import PressView
from tacgen.calibrate.sensor_fit import Evidence, SensorFit, digits, moduli
from tacgen.optics.surface_grid import Untouched
from tacgen.recipe import assets
from tacgen.report import fit_figures
from tacgen.sensor.model import LitSensor
from tacgen.sensor.yaml_source import KeyPath

Array = np.ndarray
UNIT_SOURCE = "by tacgen calibrate unit"
MIN_EXPLAINED_SHARE = 0.3  # least share of the pictures' changes that dents of the given balls explain
# contact radius that is solved, over the largest rough one; and its steps
CONTACT_RADIUS_MARGIN, CONTACT_RADIUS_RATIO = 1.2, 1.25
LIGHT_FIT_PRESSES = 6  # presses to which lights are fitted
LIGHT_FIT_STEPS = 2  # Jacobians at most, for each ridge: lights may start where they look right by eye
MIN_LIGHT_FIT_DEPTH = 0.4  # of the deepest press: least depth of those
SCAN_S = 0.8  # expected work of finding a press at all thicknesses [s of a core]
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
    contrast: ContrastFit | None = None
    dents_error: float = 0.0  # largest relative error of solved forces by their interpolation
    note: str = ""  # what Ctrl-C has left out

    @property
    def interrupted(self) -> str:
        """Note on what Ctrl-C has left out of the fit."""
        return self.note

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
        if self.note:
            yield self.note
        if self.dents_error:
            yield f"solved presses: interpolated in the thickness, their forces to {100 * self.dents_error:.1f} %"
        yield (f"pictures: dents of these balls explain {100 * fitted.scan.explained:.0f} % of the change, light that"
               f" drifts {100 * self.drift:.0f} %")  # fmt: skip
        off, most = np.abs(fitted.force - self.gauge.force).mean(), self.gauge.force.max()
        yield f"forces that the fit has seen: off by {off:.2f} N in the mean (from 0 to {most:.3g} N)"
        yield from self.unseen()
        if self.lights is not None:
            yield f"untouched: off by {self.lights.untouched:.1f} counts rms (before the fit: {self.lights.before:.1f})"
            told = self.lights.unseen or "too few presses to hold any out"
            kept = "" if self.lit else ": NOT BETTER, the file's lights are kept (see tacgen calibrate optics)"
            yield f"pictures of presses not seen by the fit of the lights: {told}{kept}"
        if self.contrast is not None:
            yield str(self.contrast)

    def found(self) -> Iterator[str]:
        """Each number with its interval."""
        fitted, gel = self.fitted, self.sensor.gel
        thickness = fitted.thickness.told("thickness", " mm")
        yield thickness if self.asked.thickness else f"thickness: {gel.thickness_mm:g} mm, the file's"
        yield fitted.modulus.told("moduli", " times the file's")
        yield from fitted.modulus.told_of(self.changes)
        yield fitted.zero.told("zero of the gauge", " N")
        names = self.photos.recordings
        for k, lag in fitted.lags.items():
            yield lag.told(f"lag of the gauge in recording {names[k]}", " s")

    def unseen(self) -> Iterator[str]:
        """Errors of forces that a fit has not seen, beside what they would be without pictures and at best."""
        if not self.judged and self.note:
            return
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
            "contrast": None if self.contrast is None else self.contrast.plain(),
            "changes": self.changed,
        }  # fmt: skip

    def head(self) -> Iterator[str]:
        """Numbers that were found, and how well."""
        yield f"Fitted {UNIT_SOURCE} to {self.said}:"
        yield from (f"  {line}" for line in self.found())
        yield from self.unseen()
        if self.contrast is not None:
            yield str(self.contrast)

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
        seen = list(zip(self.gauge.force.tolist(), self.fitted.force.tolist(), strict=True))
        unseen = [pair for one in self.judged for pair in zip(one.force, one.predicted, strict=True)]
        fit_figures.computed_over_measured(seen, unseen, out)


def unit(name: str, folder: Path, asked: Asked | None = None) -> Unit:
    """Fit a sensor file, given by name or path, to the presses in a folder.

    Raises:
        UserError: presses that are missing, cannot be used, or do not determine a number, a line each.
    """
    asked, path, table = asked or Asked(), assets.sensor_path(name), folder / PRESS_TABLE_FILE
    if not 0 <= asked.friction <= 10:  # nor nan
        raise UserError(f"--friction: must be from 0 to 10 (got {asked.friction:g})")
    sensor, _ = sensor_fit.lit_sensor(path)
    if sensor.gel.solid is not None or any(layer.scattering for layer in sensor.gel.clear_layers):
        raise UserError(f"{path}: gel: must be a pad that is clear: the rim of a contact shows on such a gel alone")
    photos = reading.read_gauged(folder, sensor.camera)
    presses = _with_solved_dents(sensor, photos, asked)
    steps.expect(SCAN_S * len(photos.presses) * (5 if asked.thickness else 1))
    try:
        steps.begin("depths, places and thickness from the pictures", SCAN_S * len(photos.presses))
        raw = indentation_fit.fit(indentation_fit.thickness_scan(presses), presses)
    except ValueError as error:
        raise UserError(f"{table}: {error}") from None
    drift = press_localisation.drift(presses.pictures, presses.gauge.recording, presses.gauge.time)
    wrong = [*_too_deep(raw, photos, presses), *_without_rim(raw, photos, presses), *_undetermined(raw, table)]
    if wrong:
        no_dents = sensor_fit.no_dents(raw.scan.explained, drift)
        raise UserError(f"{table}: {no_dents}" if no_dents else wrong)
    made = Unit(path, sensor, {}, photos, presses.gauge, drift, asked, raw, (), None, None, presses.error)
    try:
        steps.begin("the method's own error, from rendered presses", 2 * SCAN_S * len(photos.presses))
        made = replace(made, fitted=indentation_fit.corrected(raw, _at_thickness(sensor, raw, asked), presses))
        made = replace(made, judged=_held_out(photos, presses))
        if asked.lights:
            now = _at_thickness(sensor, made.fitted, asked)
            lights = _lights(now, made.fitted, photos, presses, asked.limits)
            made = replace(made, lights=lights)
            made = replace(made, **_contrasted(made, now, lights, presses))
    except KeyboardInterrupt:
        left = "lights" if made.judged else "judgement and lights" if made.fitted is not raw else "all but a first fit"
        made = replace(made, note=f"{steps.INTERRUPTED}: without {left}")
    return replace(made, changes=_changes(made, _at_thickness(sensor, made.fitted, asked)))


def _with_solved_dents(sensor: LitSensor, photos: GaugedPhotos, asked: Asked) -> GaugedPresses:
    """Solve presses of each ball at each tried thickness; minutes, unless they are in the cache.

    Raises UserError: presses that cannot be solved.
    """
    view, number = PressView(sensor), {name: k for k, name in enumerate(photos.recordings)}
    pictures = [view.picture(p.picture, p.untouched, p.ball, number[p.recording]) for p in photos.presses]
    readings = [(p.force, number[p.recording], p.time) for p in photos.presses]
    gauge = Gauge(*(np.array(part) for part in zip(*readings, strict=True)))
    rough = view.starts(pictures)
    step = sensor.gel.thickness_mm / 2  # rounded, so that other presses of the unit find them in the cache
    x, y = (float(step * np.round(v / step)) for v in np.median(rough[:, 1:], axis=0))
    widest = {}
    for ball in sorted({picture.ball for picture in pictures}):
        deepest = max(depth for depth, picture in zip(rough[:, 0], pictures, strict=True) if picture.ball == ball)
        contact = CONTACT_RADIUS_MARGIN * np.sqrt(1.6 * ball * deepest)
        widest[ball] = round(float(CONTACT_RADIUS_RATIO ** np.ceil(np.log(contact) / np.log(CONTACT_RADIUS_RATIO))), 3)
    tried = indentation_fit.THICKNESS_FACTORS if asked.thickness else (1.0,)
    dents, error = dent_family.solved(sensor, widest, (x, y), tried, asked.friction, asked.quality)
    return GaugedPresses(view, pictures, gauge, dents, error)


def _at_thickness(sensor: LitSensor, fitted: IndentationFit, asked: Asked) -> LitSensor:
    """The sensor with the fitted thickness."""
    return with_thickness(sensor, fitted.thickness.value) if asked.thickness else sensor


def _too_deep(found: IndentationFit, photos: GaugedPhotos, presses: GaugedPresses) -> Iterator[str]:
    """A line on each press that is deeper than what is solved."""
    for press, depth in zip(photos.presses, found.depth, strict=True):
        if depth > DEEPEST_SOLVED_SHARE * (deepest := presses.dents[found.scan.below][press.ball].depth[-1]):
            yield (f"{photos.folder / press.name}: is pressed deeper than {deepest:.3g} mm, the most that a"
                   f" gel of {found.thickness.value:.3g} mm is solved for: leave it out")  # fmt: skip


def _without_rim(found: IndentationFit, photos: GaugedPhotos, presses: GaugedPresses) -> Iterator[str]:
    """A line on each press whose contact is as wide as the picture: slopes inside are the ball's at any depth."""
    for press, depth, at in zip(photos.presses, found.depth, found.scan.located[found.scan.below].at, strict=True):
        contact = presses.dents[found.scan.below][press.ball].contact_at(float(depth))
        if contact > np.hypot(*(presses.view.level - at[1:]).T).max():
            yield (f"{photos.folder / press.name}: its contact, {contact:.3g} mm in radius, covers the picture, and its"
                   " depth shows at the rim alone: leave it out")  # fmt: skip


def _held_out(photos: GaugedPhotos, presses: GaugedPresses) -> tuple[HeldOutForces, ...]:
    """Judgements by recordings that a fit has not seen, or by presses if there is one recording alone."""
    names = photos.recordings
    group = presses.gauge.recording if len(names) > 1 else np.arange(len(presses.pictures))
    groups = cross_validation.folds(int(group.max()) + 1)
    each = groups if max(map(len, groups)) == 1 else groups[-1:]  # each takes a scan of all thicknesses
    held = [np.isin(group + 1, some) for some in each]
    said = [names[some[0] - 1] if len(some) == 1 and len(names) > 1 else f"{where.sum()} held out"
            for some, where in zip(each, held, strict=True)]  # fmt: skip
    texts = [f"forces of presses that the fit has not seen: {one}" for one in said]
    jobs, seconds = [(presses, where) for where in held], 2 * SCAN_S * len(presses.pictures) / len(held)
    found = zip(steps.on_workers(_forces_of, jobs, texts, seconds), said, strict=True)
    return tuple(replace(one, name=name) for one, name in found if one is not None)


def _forces_of(presses: GaugedPresses, where: Array) -> HeldOutForces | None:
    """Judgement by some presses; None if the others are too few for a fit."""
    with suppress(ValueError):
        return indentation_fit.held_out_forces(presses, where)
    return None


def _lights(
    sensor: LitSensor, fitted: IndentationFit, photos: GaugedPhotos, presses: GaugedPresses, limits: FitLimits
) -> Fitted:
    """The lights of the sensor with the fitted thickness, fitted to how some of the presses at their found depths
    change the first untouched picture, which, with its glare, can be the background of rendered pictures."""
    deep = [k for k in np.argsort(fitted.depth) if fitted.depth[k] > MIN_LIGHT_FIT_DEPTH * fitted.depth.max()]
    some = [int(deep[round(k)]) for k in np.linspace(0, len(deep) - 1, min(LIGHT_FIT_PRESSES, len(deep)))]
    first, untouched, camera = photos.presses[0].untouched, Untouched.of(sensor.gel), presses.view.camera
    faces, shown = [fitted.face(untouched, presses, k) for k in some], []
    for k, face in zip(some, faces, strict=True):
        press, (depth, x, y) = photos.presses[k], face.press
        right, down = camera.project([[x, y, -depth]])[0].tolist()
        contact = presses.dents[fitted.scan.below][press.ball].contact_at(depth) / camera.mm_per_px
        picture = np.clip(first + (press.picture.astype(float) - press.untouched), 0, 255).astype(np.uint8)
        shown.append(
            PhotographedPress(press.name, picture, press.ball, (right, down), contact, depth, aspect=camera.aspect)
        )
    return photometric_fit.fit_faces(sensor, Photos(photos.folder, first, tuple(shown)), faces, limits, changes=True)


def _contrasted(made: Unit, now: LitSensor, lights: Fitted, presses: GaugedPresses) -> dict[str, Any]:
    """The lights with the contrast that suits the forces, and that contrast; `now` has the fitted thickness.

    Lights that are no better than the file's are not used, and their contrast is not fitted.
    """
    if not made.lit:
        return {}
    changes = [press.picture.astype(float) - press.untouched for press in made.photos.presses]
    found = contrast_fit.fit(photometric_fit.at_scale(now, lights.sensor), made.fitted, presses, changes)
    return {"lights": replace(lights, sensor=contrast_fit.scaled(lights.sensor, found.factors)), "contrast": found}


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
    thickness, modulus, thick = fitted.thickness, fitted.modulus, ""
    if made.asked.thickness:
        reach = f"{thickness.low:.3g} to {thickness.high:.3g} with 95 %"
        thick = f"the gel's thickness {thickness.value:.3g} mm ({reach}), "
    for k, (layer, new) in enumerate(zip(made.sensor.gel.layers, now.gel.layers, strict=True)):
        here: KeyPath = ("gel", "layers", k)
        if made.asked.thickness:
            out[*here, "thickness_mm"] = digits(new.thickness_mm)
        out |= {(*here, key): digits(modulus.value * getattr(layer, key)) for key in moduli(layer)}
        out[*here, "source"] = f"{layer.source}; {thick}moduli {modulus.times}, fitted to {made.said} {UNIT_SOURCE}"
    for k, led in enumerate(now.leds):
        if led.center_mm != made.sensor.leds[k].center_mm:
            out.setdefault(("leds", k, "center_mm"), [round(v, 3) for v in led.center_mm])
    return out
