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
from scipy.interpolate import CubicSpline
from scipy.optimize import isotonic_regression
from scipy.stats import t as student

from tacgen.calibrate.dent_tables import HERTZ_FORCE_POWER, Dents
from tacgen.calibrate.material_fit import CONFIDENCE_LEVEL, MAX_MODULUS_FACTOR, Estimate, Unknown, estimated
from tacgen.calibrate.press_localisation import (
    LocatedPresses,
    PressPicture,
    PressView,
    colours_vary,
    located,
    located_with_best_blur,
)
from tacgen.optics.surface_grid import Surface
from tacgen.render.images import Renderer
from tacgen.sensor.model import LitSensor

Array = np.ndarray
Pictures = Sequence[PressPicture]
Tried = Sequence[Mapping[float, Dents]]  # for each thickness, in rising order, by the ball's radius [mm]
THICKNESS_FACTORS = (0.5, 0.63, 0.8, 1.0, 1.26, 1.6, 2.0)  # thicknesses that are tried, over the file's
MISFIT_POINTS = 2000  # points between them at which the misfit is interpolated
# standard error of the thickness's logarithm that the method has by itself, from synthetic units
THICKNESS_METHOD_ERROR = 0.05
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
            here = np.flatnonzero(self.recording == k)
            here = here[np.argsort(self.time[here])]
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
            here = np.flatnonzero(self.recording == k)
            here = here[np.argsort(self.time[here])]
            out[here] = np.interp(self.time[here] - lag, self.time[here], force[here])
        return out


@dataclass(frozen=True)
class ThicknessScan:
    """Pictures placed at each tried thickness: where the misfit is least, and with what error."""

    thickness: Array  # (t,) [mm]
    placed: tuple[LocatedPresses, ...]
    rich: bool  # whether colours vary over the picture
    best: float  # logarithm of the thickness
    spread: float  # its standard error
    freedom: int  # degrees of freedom of that

    @property
    def explained(self) -> float:
        """Share of the pictures' changes that the best thickness explains."""
        return float(1 - self.mixed([one.misfit.sum() for one in self.placed]) / self.placed[0].change)

    @property
    def blur(self) -> float:
        """Blur [mm] of the slopes at the best thickness."""
        return float(self.mixed([one.blur for one in self.placed]))

    def between(self, at: float) -> tuple[int, float]:
        """The tried thickness below exp(at), and the weight of the next one."""
        logs = np.log(self.thickness)
        if len(logs) == 1:
            return 0, 0.0
        k = int(np.clip(np.searchsorted(logs, at) - 1, 0, len(logs) - 2))
        return k, float(np.clip((at - logs[k]) / (logs[k + 1] - logs[k]), 0.0, 1.0))

    def parts(self, each: Sequence[Any], at: float | None = None) -> tuple[tuple[Any, float], ...]:
        """The elements for the two tried thicknesses around exp(at), by default the best, each with its weight."""
        k, w = self.between(self.best if at is None else at)
        return (each[k], 1 - w), (each[min(k + 1, len(each) - 1)], w)

    def mixed(self, values: Sequence[Any], at: float | None = None) -> Any:
        """Values at thickness exp(at), by default the best, from those at each tried one."""
        return sum(share * value for value, share in self.parts(values, at))


def thickness_scan(view: PressView, pictures: Pictures, dents: Tried, *, rich: bool | None = None) -> ThicknessScan:
    """The thickness that suits the pictures best.

    Args:
        dents: for each tried thickness, in rising order, by the ball's radius.
        rich: whether colours vary over the picture; None: as suits unseen presses best.
    """
    rich = colours_vary(view, pictures, dents[len(dents) // 2]) if rich is None else rich
    found: list[LocatedPresses] = []
    for each in dents:
        found.append(located_with_best_blur(view, pictures, each, rich, found[-1] if found else None))
    thickness = np.array([next(iter(each.values())).thickness for each in dents])
    if len(dents) == 1:
        return ThicknessScan(thickness, tuple(found), rich, float(np.log(thickness[0])), 0.0, 1)
    misfit = np.array([one.misfit for one in found])  # (t, n, SECTORS)
    groups = np.array([one.recording for one in pictures])
    parts = np.array([misfit[:, groups == g].sum(axis=1) for g in np.unique(groups)])  # (recordings, t, SECTORS)
    parts = np.moveaxis(parts, 1, 0).reshape(len(thickness), -1)
    whole, n = parts.sum(axis=1), parts.shape[1]
    without = np.array([_lowest(thickness, whole - parts[:, k]) for k in range(n)])
    spread = np.sqrt((n - 1) / n * ((without - without.mean()) ** 2).sum())
    return ThicknessScan(
        thickness, tuple(found), rich, _lowest(thickness, whole), float(np.hypot(spread, THICKNESS_METHOD_ERROR)), n - 1
    )


def _lowest(thickness: Array, misfit: Array) -> float:
    """Logarithm of the thickness with the smallest misfit."""
    logs = np.log(thickness)
    fine = np.linspace(logs[0], logs[-1], MISFIT_POINTS)
    return float(fine[np.argmin(CubicSpline(logs, misfit)(fine))])


@dataclass(frozen=True)
class DentFace:
    """The face under a ball, from solved presses at two thicknesses."""

    untouched: Surface
    dents: Sequence[tuple[Dents, float]]  # and the weight of each
    at_: tuple[float, float, float]  # depth, x, y [mm]
    blur: float  # of the slopes [mm]

    def at(self, xy: Array) -> Array:
        """Current positions (n, 3) [mm] of rest positions (n, 2) [mm]; points move along z alone."""
        depth, x, y = self.at_
        now = np.array(self.untouched.at(xy))
        away = np.hypot(now[:, 0] - x, now[:, 1] - y)
        r = np.linspace(0.0, float(away.max()), 800)
        drop = np.zeros_like(r)
        for dents, share in self.dents:
            sharp, slope = dents.face(depth, r, self.blur)
            if self.blur:  # the drop of the smoothed slopes, from far away inwards
                steps = np.diff(r) * (slope[1:] + slope[:-1]) / 2
                sharp = sharp[-1] - np.append(np.cumsum(steps[::-1])[::-1], 0.0)
            drop += share * sharp
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

    def face(self, untouched: Surface, dents: Tried, ball: float, press: int, blur: float = 0.0) -> DentFace:
        """The face under a press, given by its number and its ball's radius [mm]; `blur` [mm]: of its slopes."""
        both = self.scan.parts([each[ball] for each in dents])
        _, x, y = self.scan.placed[self.scan.between(self.scan.best)[0]].at[press]
        return DentFace(untouched, both, (float(self.depth[press]), float(x), float(y)), blur)


def fit(scan: ThicknessScan, pictures: Pictures, dents: Tried, gauge: Gauge) -> IndentationFit:
    """All numbers of a unit. Raises ValueError: fewer presses than numbers to find, and one more."""
    half = float(student.ppf((1 + CONFIDENCE_LEVEL) / 2, scan.freedom)) * scan.spread
    low, high = np.log(scan.thickness[[0, -1]])
    out = half > 0 and (not low < scan.best < high or (scan.best - half <= low and scan.best + half >= high))
    value, least, most = np.exp(scan.best + half * np.array([0, -1, 1])).tolist()
    thickness = Estimate("thickness", value, least, most, open=bool(out))
    estimates, values = _forces(scan, pictures, dents, gauge, scan.best)
    modulus, share = estimates[0], 0.0
    if half and not out:  # the thickness's error is carried over
        ends = np.clip(scan.best + np.array([-1, 1]) * scan.spread, low, high)
        moved = [np.log(_forces(scan, pictures, dents, gauge, float(end))[0][0].value) for end in ends]
        share = half * (moved[1] - moved[0]) / float(ends[1] - ends[0])
    reach = [np.exp(np.log(modulus.value) + side * np.hypot(np.log(end / modulus.value), share))
            for side, end in ((-1, modulus.low), (1, modulus.high))]  # fmt: skip
    unsure = not 2 / MAX_MODULUS_FACTOR < modulus.value < MAX_MODULUS_FACTOR / 2 or modulus.open
    modulus = Estimate("modulus", modulus.value, float(reach[0]), float(reach[1]), modulus.bound, unsure)
    lags = dict(zip(gauge.timed, estimates[2:], strict=True))
    depth = scan.mixed([one.at[:, 0] for one in scan.placed])
    return IndentationFit(scan, thickness, modulus, estimates[1], lags, values, depth)


def _forces(
    scan: ThicknessScan, pictures: Pictures, dents: Tried, gauge: Gauge, at: float
) -> tuple[tuple[Estimate, ...], Array]:
    """Estimates of modulus, zero and lags at one thickness, and the fitted readings (n,) [N]."""
    unit = unit_forces(scan, scan.placed, pictures, dents, at)
    most = float(np.abs(gauge.force).max())
    names = ["modulus", "zero", *(f"lag {k}" for k in gauge.timed)]
    if len(gauge.force) <= len(names):
        raise ValueError(f"{len(gauge.force)} presses are too few to find {len(names)} numbers and their bounds")
    zero, factor = np.linalg.lstsq(np.column_stack([np.ones_like(unit), unit]), gauge.force, rcond=None)[0]
    begin, widest = (
        float(np.log(np.clip(factor, 2 / MAX_MODULUS_FACTOR, MAX_MODULUS_FACTOR / 2))),
        float(np.log(MAX_MODULUS_FACTOR)),
    )
    unknowns = [Unknown("modulus", begin, -widest, widest, np.exp),
                Unknown("zero", float(np.clip(zero, -most / 2, most / 2)), -most, most),
                *(Unknown(name, 0.0, -MAX_GAUGE_LAG_S, MAX_GAUGE_LAG_S) for name in names[2:])]  # fmt: skip

    def force(v: Array) -> Array:
        return np.asarray(v[1] + np.exp(v[0]) * gauge.lagged(unit, dict(zip(gauge.timed, v[2:], strict=True))))

    estimates, _, best = estimated(force, gauge.force, unknowns, gauge.error_factors)
    return estimates, force(best)


def unit_forces(
    scan: ThicknessScan, seen: Sequence[LocatedPresses | None], pictures: Pictures, dents: Tried, at: float
) -> Array:
    """Forces (n,) [N] at the file's moduli of presses placed at each thickness (next to `at` at least), at thickness
    exp(at) [mm]."""
    rooted = [np.zeros(len(pictures)) if one is None else np.array([
        float(each[p.ball].force_at(d)) ** HERTZ_FORCE_POWER for p, d in zip(pictures, one.at[:, 0], strict=True)])
        for one, each in zip(seen, dents, strict=True)]  # fmt: skip
    return np.asarray(scan.mixed(rooted, at) ** (1 / HERTZ_FORCE_POWER))


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


def predict(fitted: IndentationFit, view: PressView, pictures: Pictures, dents: Tried) -> tuple[Array, Array]:
    """Forces (n,) [N] of unseen pictures, without the gauge's zero: with colours fitted to these pictures if there are
    enough of them, and with the colours of the seen pictures.

    Contrast varies over the pad: presses at one place do not determine it at another.
    """
    scan, start = fitted.scan, view.starts(pictures)
    near = scan.between(scan.best)[0]
    seen: list[LocatedPresses | None] = [None] * len(dents)
    for k in {near, min(near + 1, len(dents) - 1)}:
        one = scan.placed[k]
        seen[k] = located(view, pictures, dents[k], start, one.blur, scan.rich, one.colours)
    own = seen
    if len(pictures) >= MIN_OWN_COLOUR_PICTURES:
        own = [None if one is None else located(view, pictures, each, one.at, one.blur, scan.rich)
               for one, each in zip(seen, dents, strict=True)]  # fmt: skip
    forces = [fitted.modulus.value * unit_forces(scan, one, pictures, dents, scan.best) for one in (own, seen)]
    return forces[0], forces[1]


def held_out_forces(view: PressView, pictures: Pictures, dents: Tried, gauge: Gauge, held: Array) -> HeldOutForces:
    """Fit the presses that are not `held` (n,) bool, and judge those."""
    seen, unseen = ([p for p, chosen in zip(pictures, w, strict=True) if chosen] for w in (~held, held))
    known, asked = gauge.part(~held), gauge.part(held)
    fitted = fit(thickness_scan(view, seen, dents), seen, dents, known)
    said, foreign = (fitted.zero.value + forces for forces in predict(fitted, view, unseen, dents))
    late = _aligned(asked, said)
    order = np.argsort(late, kind="stable")
    rising = np.empty_like(late)
    rising[order] = isotonic_regression(asked.force[order]).x
    floor = np.full(len(late), known.force.mean())
    return HeldOutForces(asked.force, late, said, _aligned(asked, foreign), floor, rising)


def _aligned(gauge: Gauge, said: Array) -> Array:
    """Forces as the gauge reads them, with the lag of each timed recording with which they are nearest its readings."""
    tried, lags = np.linspace(-MAX_GAUGE_LAG_S, MAX_GAUGE_LAG_S, 161), {}
    for k in gauge.timed:
        off = [np.abs(gauge.lagged(said, {k: lag}) - gauge.force).sum() for lag in tried]
        lags[k] = float(tried[int(np.argmin(off))])
    return gauge.lagged(said, lags)


def corrected(
    found: IndentationFit, sensor: LitSensor, view: PressView, pictures: Pictures, dents: Tried, gauge: Gauge
) -> IndentationFit:
    """The fit less the error that the method makes on pictures whose numbers are known.

    The polynomial of the colours is not the light's exact response, which shifts thickness and depths, alike in
    rendered and in photographed pictures. The presses are rendered with the sensor file, `sensor` with the fitted
    thickness, and fitted once more; thickness, modulus and zero are corrected by what comes out wrong.
    """
    steady = Gauge(gauge.force, gauge.recording, np.full(len(gauge.force), np.nan))
    again = _again(found, sensor, view, pictures, dents, steady, 0.0)
    mine, lights = found.scan.blur, again.scan.blur
    if mine > MAX_LIGHT_BLUR_RATIO * lights:  # the real rims are softer than the solved ones
        again = _again(found, sensor, view, pictures, dents, steady, float(np.sqrt(mine**2 - lights**2)))
    thickness, modulus = (_ratio(one, other.value) for one, other in
                          ((found.thickness, again.thickness), (found.modulus, again.modulus)))  # fmt: skip
    shift = found.zero.value - again.zero.value
    half = np.hypot((found.zero.high - found.zero.low) / 2, 2 * CORRECTION_ERROR_SHARE * shift)
    value = found.zero.value + shift
    zero = replace(found.zero, value=value, low=float(value - half), high=float(value + half))
    return replace(found, thickness=thickness if len(dents) > 1 else found.thickness, modulus=modulus, zero=zero)


def _again(
    found: IndentationFit,
    sensor: LitSensor,
    view: PressView,
    pictures: Pictures,
    dents: Tried,
    gauge: Gauge,
    blur: float,
) -> IndentationFit:
    """The fit to rendered pictures of the presses as found, with forces as of the file's moduli times the found."""
    camera, random = Renderer(sensor, BIAS_SPP, 0, markers=False), np.random.default_rng(0)
    flat, made, forces = camera.develop(camera.flat(), random), [], []
    for n, picture in enumerate(pictures):
        face = found.face(camera.untouched, dents, picture.ball, n, blur)
        made.append(view.picture(camera.develop(camera.image(face), random), flat, picture.ball, picture.recording))
        rooted = sum(share * float(one.force_at(found.depth[n])) ** HERTZ_FORCE_POWER for one, share in face.dents)
        forces.append(rooted ** (1 / HERTZ_FORCE_POWER))
    read = found.zero.value + found.modulus.value * np.array(forces)
    return fit(thickness_scan(view, made, dents, rich=found.scan.rich), made, dents, replace(gauge, force=read))


def _ratio(one: Estimate, again: float) -> Estimate:
    """An estimate over the ratio by which the second fit is off, with an interval that is wider by its doubt."""
    shift = float(np.log(one.value / again))
    half = [np.hypot(np.log(end / one.value), 2 * CORRECTION_ERROR_SHARE * shift) for end in (one.low, one.high)]
    value = one.value * np.exp(shift)
    return replace(one, value=float(value), low=float(value * np.exp(-half[0])), high=float(value * np.exp(half[1])))
