"""The error that the method makes on pictures whose numbers are known: rendered ones of the presses as fitted.

The polynomial of the colours is not the light's exact response, which shifts thickness and depths, alike in rendered
and in photographed pictures. The presses are rendered with the sensor file and fitted once more, and the estimates are
corrected by what comes out wrong.
"""

from dataclasses import dataclass, replace

import numpy as np

from tacgen.calibrate import fit_unit
from tacgen.calibrate.ball_dents import POWER, Dents
from tacgen.calibrate.fit_material import Estimate
from tacgen.calibrate.fit_unit import Gauge, Pictures, Tried, UnitFit
from tacgen.calibrate.press_colours import PressView
from tacgen.optics.surface_grid import Surface
from tacgen.render.images import Renderer
from tacgen.sensor.model import LitSensor

Array = np.ndarray
SPP = 16
SURE = 0.5  # of a correction: standard error that it adds
LIGHTS = 1.5  # blur over that of rendered sharp rims, up to which it comes from the lights alone


@dataclass(frozen=True)
class DentFace:
    """The face under a ball, from solved presses at two thicknesses."""

    untouched: Surface
    dents: tuple[Dents, Dents]
    weight: float  # of the second
    at_: tuple[float, float, float]  # depth, x, y [mm]
    blur: float  # of the slopes [mm]

    def at(self, xy: Array) -> Array:
        """Current positions (n, 3) [mm] of rest positions (n, 2) [mm]; points move along z alone."""
        depth, x, y = self.at_
        now = np.array(self.untouched.at(xy))
        away = np.hypot(now[:, 0] - x, now[:, 1] - y)
        r = np.linspace(0.0, float(away.max()), 800)
        drop = np.zeros_like(r)
        for dents, share in zip(self.dents, (1 - self.weight, self.weight), strict=True):
            sharp, slope = dents.face(depth, r, self.blur)
            if self.blur:  # the drop of the smoothed slopes, from far away inwards
                steps = np.diff(r) * (slope[1:] + slope[:-1]) / 2
                sharp = sharp[-1] - np.append(np.cumsum(steps[::-1])[::-1], 0.0)
            drop += share * sharp
        now[:, 2] += np.interp(away, r, drop)
        return now


def corrected(
    found: UnitFit, sensor: LitSensor, view: PressView, pictures: Pictures, dents: Tried,
    gauge: Gauge,
) -> UnitFit:  # fmt: skip
    """The fit with thickness, modulus and zero corrected; `sensor` has the fitted thickness."""
    steady = Gauge(gauge.force, gauge.recording, np.full(len(gauge.force), np.nan))
    again = _again(found, sensor, view, pictures, dents, steady, 0.0)
    mine, lights = _blur(found), _blur(again)
    if mine > LIGHTS * lights:  # the real rims are softer than the solved ones
        again = _again(found, sensor, view, pictures, dents, steady, float(np.sqrt(mine**2 - lights**2)))
    thickness, modulus = (_ratio(one, other.value) for one, other in
                          ((found.thickness, again.thickness), (found.modulus, again.modulus)))  # fmt: skip
    shift = found.zero.value - again.zero.value
    half = np.hypot((found.zero.high - found.zero.low) / 2, 2 * SURE * shift)
    value = found.zero.value + shift
    zero = replace(found.zero, value=value, low=float(value - half), high=float(value + half))
    return replace(found, thickness=thickness if len(dents) > 1 else found.thickness, modulus=modulus, zero=zero)


def _again(
    found: UnitFit, sensor: LitSensor, view: PressView, pictures: Pictures, dents: Tried,
    gauge: Gauge, blur: float,
) -> UnitFit:  # fmt: skip
    """A second fit, to rendered pictures of the fitted presses, with forces of the fitted moduli."""
    k, w = found.optics.between(found.optics.best)
    near = dents[k], dents[min(k + 1, len(dents) - 1)]
    camera, random = Renderer(sensor, SPP, 0, markers=False), np.random.default_rng(0)
    flat, made, forces = camera.develop(camera.flat(), random), [], []
    for picture, depth, place in zip(pictures, found.depth, found.optics.placed[k].at, strict=True):
        both = near[0][picture.ball], near[1][picture.ball]
        face = DentFace(camera.untouched, both, w, (float(depth), float(place[1]), float(place[2])), blur)
        made.append(view.picture(camera.develop(camera.image(face), random), flat, picture.ball, picture.recording))
        rooted = [float(one.force_at(np.array(depth))) ** POWER for one in both]
        forces.append(((1 - w) * rooted[0] + w * rooted[1]) ** (1 / POWER))
    read = found.zero.value + found.modulus.value * np.array(forces)
    optics = fit_unit.optics(view, made, dents, rich=found.optics.rich)
    return fit_unit.fit(optics, made, dents, replace(gauge, force=read))


def _blur(fitted: UnitFit) -> float:
    """The blur [mm] at the best thickness."""
    k, w = fitted.optics.between(fitted.optics.best)
    placed = fitted.optics.placed
    return float((1 - w) * placed[k].blur + w * placed[min(k + 1, len(placed) - 1)].blur)


def _ratio(one: Estimate, again: float) -> Estimate:
    """An estimate divided by the second fit's relative error; the interval is widened by the correction's error."""
    shift = float(np.log(one.value / again))
    half = [np.hypot(np.log(end / one.value), 2 * SURE * shift) for end in (one.low, one.high)]
    value = one.value * np.exp(shift)
    return replace(one, value=float(value), low=float(value * np.exp(-half[0])), high=float(value * np.exp(half[1])))
