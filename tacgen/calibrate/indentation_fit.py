"""Thickness and modulus of a gel, zero and lag of a gauge from photographed presses of balls with forces.

The shape of the face around the contact depends on the gel's thickness, and not on its modulus or on the forces: the
pictures give thickness, depths and colours. The forces then give the modulus, the gauge's zero and, where the pictures
have times, the lag of the gauge in each recording:

    F(t) = zero + m C(d(t - lag))

C is the force that the sensor file's gel gives at depth d. The errors of the thickness come from the jackknife over
sectors of the pictures of each recording, and are carried over to the modulus.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.optimize import isotonic_regression
from scipy.stats import t as student

from tacgen.calibrate import press_localisation, steps
from tacgen.calibrate.dent_tables import HERTZ_FORCE_POWER, Dents
from tacgen.calibrate.material_fit import (
    CONFIDENCE_LEVEL,
    Estimate,
    Unknown,
    estimated,
    modulus_in_range,
    modulus_unknown,
)
from tacgen.calibrate.press_localisation import LocatedPresses, PressPicture, PressView, located
from tacgen.optics.surface_grid import Surface
from tacgen.render.images import Renderer
from tacgen.sensor.model import LitSensor

Array = np.ndarray
THICKNESS_FACTORS = (0.5, 0.63, 0.8, 1.0, 1.26, 1.6, 2.0)  # thicknesses that are tried, over the file's
MISFIT_POINTS = 2000  # points between them at which the misfit is interpolated
# standard error of the thickness's logarithm that the method has by itself, from synthetic units
THICKNESS_METHOD_ERROR = 0.05
# the same where rims are softer than any blur that is tried, which a thinner gel replaces: those of a golf ball on a
# Wedge give 4.75 mm with blurs up to 0.4 of the thickness, 3.83 up to 0.6
SOFT_RIM_THICKNESS_ERROR = 0.22
# of the largest force: change between readings from which its error by the lag exceeds all others
ABRUPT_FORCE_CHANGE = 0.03
MIN_OWN_COLOUR_PICTURES = 8  # unseen pictures from which they tell their own colours
BIAS_SPP = 16  # samples a pixel of rendered pictures, of gels that scatter light
CORRECTION_ERROR_SHARE = 0.5  # of a correction: standard error that it adds
MAX_LIGHT_BLUR_RATIO = 1.5  # blur over that of rendered sharp rims, up to which it comes from the lights alone
MAX_GAUGE_LAG_S = 0.2  # [s]: largest lag of a gauge, either way


@dataclass(frozen=True)
class Gauge:
    """Readings (n,) [N], the recording (n,) that each belongs to, and its time (n,) [s], nan where none is known."""

    force: Array
    recording: Array
    time: Array

    @property
    def timed(self) -> list[int]:
        """The recordings whose lag can be found."""
        return [int(k) for k in np.unique(self.recording) if np.isfinite(self.time[self.recording == k]).sum() > 2]

    @property
    def error_factors(self) -> Array:
        """Factors (n,) on the errors of readings: a gauge whose lag varies errs most where the force changes fast."""
        out = np.ones(len(self.force))
        for k in self.timed:
            here = self._in_time(k)
            change = np.abs(np.gradient(self.force[here]))
            out[here] = np.hypot(1.0, change / (ABRUPT_FORCE_CHANGE * np.abs(self.force).max()))
        return out

    def part(self, where: Array) -> "Gauge":
        """Some of the readings."""
        return Gauge(self.force[where], self.recording[where], self.time[where])

    def lagged(self, force: Array, lags: Mapping[int, float]) -> Array:
        """Forces (n,) at the times of the pictures, as a gauge with these lags [s] reads them."""
        out = force.astype(float).copy()
        for k, lag in lags.items():
            here = self._in_time(k)
            out[here] = np.interp(self.time[here] - lag, self.time[here], force[here])
        return out

    def aligned(self, force: Array) -> Array:
        """Forces (n,) lagged in each timed recording by the lag with which they are nearest the readings."""
        tried, lags = np.linspace(-MAX_GAUGE_LAG_S, MAX_GAUGE_LAG_S, 161).tolist(), dict[int, float]()
        for k in self.timed:
            lags[k] = min(tried, key=lambda lag: np.abs(self.lagged(force, {k: lag}) - self.force).sum())
        return self.lagged(force, lags)

    def _in_time(self, recording: int) -> Array:
        """Numbers of a recording's readings, in the order of their times."""
        here = np.flatnonzero(self.recording == recording)
        return here[np.argsort(self.time[here])]


@dataclass(frozen=True)
class GaugedPresses:
    """Photographed presses with the readings of a gauge, and solved presses that they are compared with."""

    view: PressView
    pictures: Sequence[PressPicture]
    gauge: Gauge
    dents: Sequence[Mapping[float, Dents]]  # for each tried thickness, in rising order, by the ball's radius [mm]
    error: float = 0.0  # largest relative error of the dents' forces by their interpolation

    def part(self, where: Array) -> "GaugedPresses":
        """The presses at which `where` (n,) is true."""
        pictures = [one for one, chosen in zip(self.pictures, where, strict=True) if chosen]
        return replace(self, pictures=pictures, gauge=self.gauge.part(where))


@dataclass(frozen=True)
class ThicknessScan:
    """Presses located at each tried thickness: where the misfit of their pictures is least, and with what error."""

    thickness: Array  # (t,) [mm]
    located: tuple[LocatedPresses, ...]
    rich: bool  # whether colours vary over the picture
    best: float  # logarithm of the thickness
    spread: float  # its standard error
    freedom: int  # degrees of freedom of that

    @property
    def explained(self) -> float:
        """Share of the pictures' changes that the best thickness explains."""
        return float(1 - self.interpolated([one.misfit.sum() for one in self.located]) / self.located[0].change)

    @property
    def blur(self) -> float:
        """Blur [mm] of the slopes at the best thickness."""
        return float(self.interpolated([one.blur for one in self.located]))

    @property
    def below(self) -> int:
        """Number of the tried thickness below the best one."""
        return self._between(self.best)[0]

    def around(self, each: Sequence[Any], at: float | None = None) -> tuple[tuple[Any, float], ...]:
        """The elements for the tried thicknesses around exp(at), by default the best, each with its weight."""
        k, w = self._between(self.best if at is None else at)
        return ((each[k], 1 - w), (each[k + 1], w)) if w else ((each[k], 1.0),)

    def interpolated(self, values: Sequence[Any], at: float | None = None) -> Any:
        """Values at thickness exp(at), by default the best, from those at each tried one."""
        return sum(share * value for value, share in self.around(values, at))

    def _between(self, at: float) -> tuple[int, float]:
        """The tried thickness below exp(at), and the weight of the next one."""
        logs = np.log(self.thickness)
        if len(logs) == 1:
            return 0, 0.0
        k = int(np.clip(np.searchsorted(logs, at) - 1, 0, len(logs) - 2))
        return k, float(np.clip((at - logs[k]) / (logs[k + 1] - logs[k]), 0.0, 1.0))


def thickness_scan(presses: GaugedPresses, *, rich: bool | None = None) -> ThicknessScan:
    """The thickness that suits the pictures best. `rich`: whether colours vary over the picture; None: as suits unseen
    presses best."""
    view, pictures, dents = presses.view, presses.pictures, presses.dents
    if rich is None:
        rich = press_localisation.colours_vary(view, pictures, dents[len(dents) // 2])
    found: list[LocatedPresses] = []
    for each in dents:
        steps.go_on(f"thickness {len(found) + 1} of {len(dents)}")
        near = found[-1] if found else None
        found.append(press_localisation.located_with_best_blur(view, pictures, each, rich, near))
    thickness = np.array([next(iter(each.values())).thickness for each in dents])
    if len(dents) == 1:
        return ThicknessScan(thickness, tuple(found), rich, float(np.log(thickness[0])), 0.0, 1)
    misfit = np.array([one.misfit for one in found])  # (t, n, MISFIT_SECTORS)
    groups = np.array([one.recording for one in pictures])
    parts = np.hstack([misfit[:, groups == g].sum(axis=1) for g in np.unique(groups)])  # (t, recordings x sectors)
    whole, n = parts.sum(axis=1), parts.shape[1]
    without = np.array([_lowest(thickness, whole - parts[:, k]) for k in range(n)])  # jackknife
    spread = float(np.hypot(np.sqrt((n - 1) * without.var()), THICKNESS_METHOD_ERROR))
    scan = ThicknessScan(thickness, tuple(found), rich, _lowest(thickness, whole), spread, n - 1)
    pairs = zip(found, thickness.tolist(), strict=True)
    if any(press_localisation.blur_at_bound(*pair) for pair, _ in scan.around(list(pairs))):
        return replace(scan, spread=float(np.hypot(spread, SOFT_RIM_THICKNESS_ERROR)))
    return scan


def _lowest(thickness: Array, misfit: Array) -> float:
    """Logarithm of the thickness with the smallest misfit."""
    logs = np.log(thickness)
    fine = np.linspace(logs[0], logs[-1], MISFIT_POINTS)
    return float(fine[np.argmin(CubicSpline(logs, misfit)(fine))])


@dataclass(frozen=True)
class DentFace:
    """The face under a ball, from solved presses at the thicknesses around that of the gel."""

    untouched: Surface
    dents: Sequence[tuple[Dents, float]]  # and the weight of each
    press: tuple[float, float, float]  # depth, x, y [mm]
    blur: float  # of the slopes [mm]

    def at(self, xy: Array) -> Array:
        """Current positions (n, 3) [mm] of rest positions (n, 2) [mm]; points move along z alone."""
        depth, x, y = self.press
        now = np.array(self.untouched.at(xy))
        away = np.hypot(now[:, 0] - x, now[:, 1] - y)
        r = np.linspace(0.0, float(away.max()), 800)
        drop = np.zeros_like(r)
        for dents, share in self.dents:
            one, slope = dents.face(depth, r, self.blur)
            if self.blur:  # the drop of the smoothed slopes, that far away being as solved
                risen = cumulative_trapezoid(slope, r, initial=0)
                one = one[-1] + risen - risen[-1]
            drop += share * one
        now[:, 2] += np.interp(away, r, drop)
        return now


@dataclass(frozen=True)
class IndentationFit:
    """Estimates; the gauge's readings as fitted (n,) [N] and the depths of the presses (n,) [mm]."""

    scan: ThicknessScan
    thickness: Estimate  # [mm]
    modulus: Estimate  # factor on the file's
    zero: Estimate  # [N]
    lags: dict[int, Estimate]  # [s] by recording
    force: Array
    depth: Array

    @property
    def open(self) -> list[str]:
        """Names of the numbers that the presses do not determine."""
        return [one.name for one in (self.thickness, self.modulus, self.zero, *self.lags.values()) if one.open]

    def face(self, untouched: Surface, presses: GaugedPresses, press: int, blur: float = 0.0) -> DentFace:
        """The face under a press, given by its number; `blur` [mm]: of its slopes."""
        around = self.scan.around([each[presses.pictures[press].ball] for each in presses.dents])
        _, x, y = self.scan.located[self.scan.below].at[press]
        return DentFace(untouched, around, (float(self.depth[press]), float(x), float(y)), blur)


def fit(scan: ThicknessScan, presses: GaugedPresses) -> IndentationFit:
    """All numbers of a unit. Raises ValueError: fewer presses than numbers to find, and one more."""
    half = float(student.ppf((1 + CONFIDENCE_LEVEL) / 2, scan.freedom)) * scan.spread
    low, high = np.log(scan.thickness[[0, -1]])
    out = half > 0 and (not low < scan.best < high or (scan.best - half <= low and scan.best + half >= high))
    value, least, most = np.exp(scan.best + half * np.array([0, -1, 1])).tolist()
    thickness = Estimate("thickness", value, least, most, open=bool(out))
    (modulus, zero, *lags), values = _force_fit(scan, presses, scan.best)
    share = 0.0
    if half and not out:  # the thickness's error is carried over
        ends = np.clip(scan.best + np.array([-1, 1]) * scan.spread, low, high)
        moved = [np.log(_force_fit(scan, presses, float(end))[0][0].value) for end in ends]
        share = half * (moved[1] - moved[0]) / float(ends[1] - ends[0])
    least, most = (float(np.exp(np.log(modulus.value) + side * np.hypot(np.log(end / modulus.value), share)))
                   for side, end in ((-1, modulus.low), (1, modulus.high)))  # fmt: skip
    unsure = modulus.open or not modulus_in_range(modulus.value)
    modulus = replace(modulus, low=least, high=most, open=unsure)
    depth = scan.interpolated([one.at[:, 0] for one in scan.located])
    return IndentationFit(
        scan, thickness, modulus, zero, dict(zip(presses.gauge.timed, lags, strict=True)), values, depth
    )


def _force_fit(scan: ThicknessScan, presses: GaugedPresses, at: float) -> tuple[tuple[Estimate, ...], Array]:
    """Estimates of modulus, zero and lags at thickness exp(at), and the fitted readings (n,) [N]."""
    gauge, each = presses.gauge, zip(scan.located, presses.dents, strict=True)
    rooted = [_rooted_forces(one, presses.pictures, dents) for one, dents in each]
    unit = np.asarray(scan.interpolated(rooted, at) ** (1 / HERTZ_FORCE_POWER))  # at the file's moduli
    most = float(np.abs(gauge.force).max())
    lags = [Unknown(f"lag {k}", 0.0, -MAX_GAUGE_LAG_S, MAX_GAUGE_LAG_S) for k in gauge.timed]
    if len(gauge.force) <= 2 + len(lags):
        raise ValueError(f"{len(gauge.force)} presses are too few to find {2 + len(lags)} numbers and their bounds")
    zero, factor = np.linalg.lstsq(np.column_stack([np.ones_like(unit), unit]), gauge.force, rcond=None)[0]
    start = float(np.clip(zero, -most / 2, most / 2))
    unknowns = [modulus_unknown(factor), Unknown("zero", start, -most, most), *lags]

    def force(v: Array) -> Array:
        return np.asarray(v[1] + np.exp(v[0]) * gauge.lagged(unit, dict(zip(gauge.timed, v[2:], strict=True))))

    estimates, _, best = estimated(force, gauge.force, unknowns, gauge.error_factors)
    return estimates, force(best)


def _rooted_forces(one: LocatedPresses, pictures: Sequence[PressPicture], dents: Mapping[float, Dents]) -> Array:
    """Forces (n,) [N] to the HERTZ_FORCE_POWER of presses located at one thickness, at the file's moduli."""
    forces = [float(dents[p.ball].force_at(d)) for p, d in zip(pictures, one.at[:, 0], strict=True)]
    return np.array(forces) ** HERTZ_FORCE_POWER


@dataclass(frozen=True)
class HeldOutForces:
    """Readings (n,) [N] of presses held out from a fit, and their forces predicted from the pictures alone."""

    force: Array
    predicted: Array  # with the gauge's lag of the judged recordings, fitted to their readings, if they have times
    unaligned: Array  # without any lag
    foreign: Array  # with the colours fitted to the seen presses; `predicted` fits them to the judged pictures
    floor: Array  # the mean of the forces that the fit has seen
    ceiling: Array  # a rising curve over the predicted forces, fitted to the judged readings themselves
    name: str = ""  # of what is held out

    def plain(self) -> dict[str, Any]:
        """As JSON values."""
        parts = {key: getattr(self, key) for key in ("predicted", "unaligned", "foreign", "floor", "ceiling")}
        return {"name": self.name, "force_n": self.force.tolist(), "predicted_n": self.predicted.tolist(),
                "mae_n": {key: self.mae(part) for key, part in parts.items()}}  # fmt: skip

    def mae(self, said: Array) -> float:
        """Mean absolute error [N]."""
        return float(np.abs(said - self.force).mean())


def predict(fitted: IndentationFit, presses: GaugedPresses) -> tuple[Array, Array]:
    """Forces (n,) [N] of unseen pictures, without the gauge's zero: with colours fitted to these pictures if there are
    enough of them, and with the colours of the seen pictures.

    Contrast varies over the pad: presses at one place do not determine it at another.
    """
    view, pictures, scan = presses.view, presses.pictures, fitted.scan
    start, own, foreign = view.starts(pictures), np.zeros(len(pictures)), np.zeros(len(pictures))
    for (dents, seen), share in scan.around(list(zip(presses.dents, scan.located, strict=True))):
        one = located(view, pictures, dents, start, seen.blur, scan.rich, seen.colours)
        foreign += share * _rooted_forces(one, pictures, dents)
        if len(pictures) >= MIN_OWN_COLOUR_PICTURES:
            one = located(view, pictures, dents, one.at, seen.blur, scan.rich)
        own += share * _rooted_forces(one, pictures, dents)
    own, foreign = (fitted.modulus.value * rooted ** (1 / HERTZ_FORCE_POWER) for rooted in (own, foreign))
    return own, foreign


def held_out_forces(presses: GaugedPresses, held: Array) -> HeldOutForces:
    """Judge the presses that are `held` (n,) bool by a fit to all others."""
    seen, unseen = presses.part(~held), presses.part(held)
    fitted, gauge = fit(thickness_scan(seen), seen), unseen.gauge
    own, foreign = (fitted.zero.value + forces for forces in predict(fitted, unseen))
    predicted = gauge.aligned(own)
    order = np.argsort(predicted, kind="stable")
    rising = np.empty_like(predicted)
    rising[order] = isotonic_regression(gauge.force[order]).x
    floor = np.full(len(predicted), seen.gauge.force.mean())
    return HeldOutForces(gauge.force, predicted, own, gauge.aligned(foreign), floor, rising)


def corrected(found: IndentationFit, sensor: LitSensor, presses: GaugedPresses) -> IndentationFit:
    """The fit less the error that the method makes on pictures whose numbers are known.

    The polynomial of the colours is not the light's exact response, which shifts thickness and depths, alike in
    rendered and in photographed pictures. The presses are rendered with the sensor file, `sensor` with the fitted
    thickness, and fitted once more; thickness, modulus and zero are corrected by what comes out wrong.
    """
    again = _fit_to_rendered(found, sensor, presses, 0.0)
    mine, lights = found.scan.blur, again.scan.blur
    if mine > MAX_LIGHT_BLUR_RATIO * lights:  # the real rims are softer than the solved ones
        again = _fit_to_rendered(found, sensor, presses, float(np.sqrt(mine**2 - lights**2)))
    thickness = found.thickness if len(presses.dents) == 1 else _corrected(found.thickness, again.thickness)
    shift = found.zero.value - again.zero.value
    half = float(np.hypot((found.zero.high - found.zero.low) / 2, 2 * CORRECTION_ERROR_SHARE * shift))
    value = found.zero.value + shift
    zero = replace(found.zero, value=value, low=value - half, high=value + half)
    return replace(found, thickness=thickness, modulus=_corrected(found.modulus, again.modulus), zero=zero)


def _fit_to_rendered(found: IndentationFit, sensor: LitSensor, presses: GaugedPresses, blur: float) -> IndentationFit:
    """The fit to rendered pictures of the presses as found, with forces without lag of the file's moduli times the
    found factor; `blur` [mm]: of the slopes."""
    camera, random = Renderer(sensor, BIAS_SPP, 0, markers=False), np.random.default_rng(0)
    flat, made, rooted = camera.develop(camera.flat(), random), [], []
    for n, picture in enumerate(presses.pictures):
        face = found.face(camera.untouched, presses, n, blur)
        shown = camera.develop(camera.image(face), random)
        made.append(presses.view.picture(shown, flat, picture.ball, picture.recording))
        each = [share * float(one.force_at(found.depth[n])) ** HERTZ_FORCE_POWER for one, share in face.dents]
        rooted.append(sum(each))
    force = found.zero.value + found.modulus.value * np.array(rooted) ** (1 / HERTZ_FORCE_POWER)
    steady = Gauge(force, presses.gauge.recording, np.full(len(force), np.nan))
    again = replace(presses, pictures=made, gauge=steady)
    return fit(thickness_scan(again, rich=found.scan.rich), again)


def _corrected(one: Estimate, again: Estimate) -> Estimate:
    """An estimate over the ratio by which the second fit is off, with an interval that is wider by its doubt."""
    shift = float(np.log(one.value / again.value))
    half = [np.hypot(np.log(end / one.value), 2 * CORRECTION_ERROR_SHARE * shift) for end in (one.low, one.high)]
    value = one.value * np.exp(shift)
    return replace(one, value=float(value), low=float(value * np.exp(-half[0])), high=float(value * np.exp(half[1])))
