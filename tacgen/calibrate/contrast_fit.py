"""Contrast of rendered pictures, fitted to forces: a factor on the lights, what it takes from them being stray light.

Lights that are fitted to pictures of one press after the other leave open how strongly a slope changes the colours: what
they cannot explain (glare, dirt, dimples) is read as noise, or as contrast. What a reader of rendered pictures would
take for the force of the photographed presses tells it: depths and places are found with the colours by slope that
rendered pictures of the presses have, times a factor, and the factor with the right forces is the contrast.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacgen.calibrate import indentation_fit, press_localisation, steps
from tacgen.calibrate.cross_validation import rgb
from tacgen.calibrate.indentation_fit import GaugedPresses, IndentationFit
from tacgen.calibrate.press_localisation import located
from tacgen.render.images import Renderer
from tacgen.sensor.model import LitSensor

Array = np.ndarray
CONTRAST_SPP = 16  # samples a pixel, of gels that scatter light
TRIED_CONTRASTS = (0.6, 0.7, 0.8, 0.9, 1.0, 1.12, 1.26, 1.42, 1.6)  # factors on the contrast of the lights
CONTRAST_POINTS = 201  # factors between them at which errors are interpolated
LOCATED_S = 0.1  # expected work of finding a press with given colours [s of a core]


@dataclass(frozen=True)
class ContrastFit:
    """A factor on the lights, and forces read with the colours of rendered pictures."""

    factor: float
    error: float  # mean absolute error of the forces with this factor [N]
    before: float  # the same with the lights as they were [N]
    unseen: tuple[float, ...]  # of each recording with the factor of the others, if there are several [N]
    bias: tuple[float, ...]  # mean of read less measured forces of the same [N]

    def __str__(self) -> str:
        told = f"times {self.factor:.2f}: forces read by rendered colours are off by {self.error:.2f} N"
        told += f" (before: {self.before:.2f} N"
        if self.unseen:
            each = ", ".join(f"{one:.2f}" for one in self.unseen)
            told += f"; each recording by the factor of the others: {each} N"
        return f"{told})"


def fit(sensor: LitSensor, fitted: IndentationFit, presses: GaugedPresses) -> ContrastFit:
    """The factor on a sensor's contrast with which forces read by its rendered pictures are least off."""
    steps.expect(LOCATED_S * len(presses.pictures) * (len(TRIED_CONTRASTS) + 1))
    steps.begin("colours by slope of rendered presses", LOCATED_S * len(presses.pictures))
    colours = rendered_colours(sensor, fitted, presses)
    forces = []
    for factor in TRIED_CONTRASTS:
        steps.begin(f"forces read with {factor:g} times the contrast", LOCATED_S * len(presses.pictures))
        forces.append(_read(fitted, presses, [factor * one for one in colours]))
    gauge, logs = presses.gauge, np.log(TRIED_CONTRASTS)
    fine = np.linspace(logs[0], logs[-1], CONTRAST_POINTS)
    off = np.array([np.interp(fine, logs, part) for part in np.array([gauge.aligned(f) for f in forces]).T])
    off -= gauge.force[:, None]  # (presses, factors)
    groups = np.unique(gauge.recording)

    def best(where: Array) -> int:
        return int(np.argmin(np.abs(off[where]).mean(axis=0)))

    k, one = best(np.ones(len(off), bool)), int(np.argmin(np.abs(fine)))
    apart = [(gauge.recording == g, best(gauge.recording != g)) for g in groups] if len(groups) > 1 else []
    unseen = tuple(float(np.abs(off[here, at]).mean()) for here, at in apart)
    bias = tuple(float(off[here, at].mean()) for here, at in apart)
    errors = np.abs(off).mean(axis=0)
    return ContrastFit(float(np.exp(fine[k])), float(errors[k]), float(errors[one]), unseen, bias)


def rendered_colours(sensor: LitSensor, fitted: IndentationFit, presses: GaugedPresses) -> list[Array]:
    """Colours by slope of rendered pictures of the presses, with the solved presses of each thickness around the
    gel's."""
    camera, view, made = Renderer(sensor, CONTRAST_SPP, 0, markers=False), presses.view, []
    flat = camera.develop(camera.flat())
    for n, picture in enumerate(presses.pictures):
        shown = camera.develop(camera.image(fitted.face(camera.untouched, presses, n)))
        made.append(view.picture(shown, flat, picture.ball, picture.recording))
    out = []
    for dents, one in _around(fitted, presses):
        tables = [view.columns(dents[p.ball], at, one.blur, False) for p, at in zip(made, one.at, strict=True)]
        out.append(press_localisation.colours_of(tables, made, False))
    return out


def _around(fitted: IndentationFit, presses: GaugedPresses) -> Sequence[tuple[dict, press_localisation.LocatedPresses]]:
    pairs = list(zip(presses.dents, fitted.scan.located, strict=True))
    return [pair for pair, _ in fitted.scan.around(pairs)]


def _read(fitted: IndentationFit, presses: GaugedPresses, colours: Sequence[Array]) -> Array:
    """Forces (n,) [N] of the presses found with these colours, for each thickness around the gel's."""
    pairs, rooted = list(zip(presses.dents, fitted.scan.located, strict=True)), np.zeros(len(presses.pictures))
    for ((dents, seen), share), own in zip(fitted.scan.around(pairs), colours, strict=True):
        one = located(presses.view, presses.pictures, dents, seen.at, seen.blur, False, own)
        rooted += share * indentation_fit.rooted_forces(one, presses.pictures, dents)
    forces = fitted.modulus.value * rooted ** (1 / indentation_fit.HERTZ_FORCE_POWER)
    return np.asarray(fitted.zero.value + forces)


def scaled(sensor: LitSensor, factor: float) -> LitSensor:
    """The sensor with its lights times a factor, and stray light for what the untouched picture would lose in the
    mean, as far as there is any."""
    camera = Renderer(sensor, CONTRAST_SPP, 0, markers=False)
    shown = camera.flat().astype(float).mean(axis=(0, 1))
    stray = np.array(sensor.camera.ambient)
    left = np.maximum(stray + (1 - factor) * (shown - stray), 0.0)
    leds = tuple(
        led.model_copy(update={"radiance": rgb(factor * np.array(led.light)), "power": 1.0}) for led in sensor.leds
    )
    eye = sensor.camera.model_copy(update={"ambient": rgb(left)})
    return sensor.model_copy(update={"leds": leds, "camera": eye})
