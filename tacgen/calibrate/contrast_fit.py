"""Contrast of rendered pictures, fitted to forces: a factor on the lights, what it takes from them being stray light.

Lights that are fitted to a few pictures leave the contrast open by a tenth or two: what they cannot explain (glare,
dirt, dimples) counts as noise, or as contrast. How each colour changes per slope inside of contacts, photographed over
rendered, tells their ratios; the forces tell the rest. A network learns them from rendered pictures of presses alone,
as users train theirs, and reads the photographs: with a wrong contrast all its forces are too small, or too large. Each
recording is judged by the factors of the others.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from tacgen.calibrate import press_localisation, steps
from tacgen.calibrate.cross_validation import rgb
from tacgen.calibrate.dent_tables import HERTZ_FORCE_POWER
from tacgen.calibrate.indentation_fit import DentFace, GaugedPresses, IndentationFit
from tacgen.calibrate.normal_net import NormalNet
from tacgen.calibrate.press_localisation import PressPicture
from tacgen.render.images import Renderer
from tacgen.sensor.model import LitSensor

Array = np.ndarray
CONTRAST_SPP = 16  # samples a pixel, of gels that scatter light
READER_PRESSES = 260  # rendered presses that the network learns from
READER_COPIES, READER_NOISE_COUNTS = 4, 1.0  # copies of each, with noise of this standard deviation [counts]
READER_CELLS = 20  # cells of the picture along each side that the network sees
READER_DEPTH_RATIO = 1.3  # deepest rendered press over the deepest photographed one
READER_UNIT_COUNTS = 10.0  # change of colour that is scaled to 1 at the input [counts]
LEAST_CONTRAST, LARGEST_CONTRAST, CONTRASTS = 0.5, 2.0, 121  # tried factors on the contrast of the lights
READER_S = 40.0  # expected work of the network [s of a core]


@dataclass(frozen=True)
class ContrastFit:
    """A factor on the lights, and the errors of forces [N] that a network reads which knows rendered pictures alone."""

    factor: float  # by the forces
    colours: tuple[float, float, float]  # by the change of each colour per slope: further factors
    error: float  # mean absolute error with these factors
    before: float  # the same with the lights as they were
    unseen: tuple[float, ...]  # of each recording with the factors of the others, if there are several
    bias: tuple[float, ...]  # mean of read less measured forces of the same

    @property
    def factors(self) -> Array:
        """Factors on red, green and blue light (3,)."""
        return self.factor * np.array(self.colours)

    def __str__(self) -> str:
        told = f"a network that knows rendered pictures alone reads forces off by {self.error:.2f} N"
        if self.unseen:
            each = ", ".join(
                f"{off:.2f} N (bias {bias:+.2f})" for off, bias in zip(self.unseen, self.bias, strict=True)
            )
            told += f", each recording with the contrast of the others {each}"
        times = " / ".join(f"{one:.2f}" for one in self.factors)
        return f"contrast times {times} (red / green / blue): {told}; before {self.before:.2f} N"

    def plain(self) -> dict[str, Any]:
        """As JSON values."""
        errors = {
            "mae_n": self.error,
            "before_n": self.before,
            "unseen_n": list(self.unseen),
            "bias_n": list(self.bias),
        }
        return {"factors": self.factors.tolist(), **errors}


def fit(sensor: LitSensor, fitted: IndentationFit, presses: GaugedPresses, changes: list[Array]) -> ContrastFit:
    """The factors on a sensor's contrast with which forces read from photographs are least off.

    Args:
        sensor: with the fitted thickness and lights.
        changes: of the photographs against the untouched ones (H, W, 3) [counts].
    """
    steps.expect(READER_S)
    net, ratios = _reader(sensor, fitted, presses), ContrastByColour(sensor, fitted, presses)
    gauge, tried = presses.gauge, np.geomspace(LEAST_CONTRAST, LARGEST_CONTRAST, CONTRASTS)
    groups, every = np.unique(gauge.recording), np.ones(len(changes), bool)

    def off(colours: Array) -> Array:
        """Errors of forces with each of the tried factors (presses, factors)."""
        seen = np.array([_seen(change / colours) for change in changes])
        read = [net.normals(seen / factor)[:, 0] for factor in tried]  # lights so much stronger show the same change
        forces = [fitted.zero.value + _force(one, presses) for one in read]
        return np.asarray(np.array([gauge.aligned(one) for one in forces]).T - gauge.force[:, None])

    plain = off(np.ones(3))

    def best(where: Array) -> tuple[Array, Array, int]:
        """Factors by the colours of some presses, if they suit their forces better than none, all errors with them, and
        the number of the factor that suits these forces."""
        own = ratios.over(where)
        both = (own, off(own)), (np.ones(3), plain)
        colours, errors = min(both, key=lambda one: float(np.abs(one[1][where]).mean(axis=0).min()))
        return colours, errors, int(np.argmin(np.abs(errors[where]).mean(axis=0)))

    apart = [(gauge.recording == g, *best(gauge.recording != g)[1:]) for g in groups] if len(groups) > 1 else []
    unseen = tuple(float(np.abs(errors[here, at]).mean()) for here, errors, at in apart)
    bias = tuple(float(errors[here, at].mean()) for here, errors, at in apart)
    colours, errors, k = best(every)
    before = float(np.abs(plain[:, CONTRASTS // 2]).mean())
    return ContrastFit(float(tried[k]), rgb(colours), float(np.abs(errors[:, k]).mean()), before, unseen, bias)


class ContrastByColour:
    """How colours change per slope inside of contacts, photographed over rendered, by one polynomial at one place."""

    def __init__(self, sensor: LitSensor, fitted: IndentationFit, presses: GaugedPresses) -> None:
        scan, view = fitted.scan, presses.view
        camera, near, self._rich = Renderer(sensor, CONTRAST_SPP, 0, markers=False), scan.located[scan.below], scan.rich
        flat, self._tables, self._made = camera.develop(camera.flat()), list[Array](), list[PressPicture]()
        self._real = presses.pictures
        for k, one in enumerate(presses.pictures):
            shown = camera.develop(camera.image(fitted.face(camera.untouched, presses, k, near.blur)))
            self._made.append(view.picture(shown, flat, one.ball, one.recording))
            at = np.array([fitted.depth[k], *near.at[k, 1:]])
            self._tables.append(view.columns(presses.dents[scan.below][one.ball], at, near.blur, scan.rich))

    def over(self, where: Array) -> Array:
        """Factors (3,) by the presses at which `where` (n,) is true; 1 for a colour that the lights hardly change."""
        some = np.flatnonzero(where).tolist()
        real, made = (
            press_localisation.best_colours([self._tables[k] for k in some], [seen[k] for k in some], self._rich)[:2]
            for seen in (self._real, self._made)
        )
        size = (made**2).sum(axis=0)
        ratio = np.where(size > 0, (real * made).sum(axis=0) / np.maximum(size, 1e-9), 1.0)
        return np.asarray(np.clip(ratio, LEAST_CONTRAST, LARGEST_CONTRAST))


def _force(read: Array, presses: GaugedPresses) -> Array:
    """Forces (n,) [N] from the network's output (n,)."""
    return np.asarray(np.maximum(read, 0.0) ** (1 / HERTZ_FORCE_POWER) * np.abs(presses.gauge.force).max())


def _reader(sensor: LitSensor, fitted: IndentationFit, presses: GaugedPresses) -> NormalNet:
    """A network from rendered changes of colour to the force over the largest measured one, to HERTZ_FORCE_POWER."""
    random, camera = np.random.default_rng(0), Renderer(sensor, CONTRAST_SPP, 0, markers=False)
    flat, seen, roots = camera.develop(camera.flat()).astype(float), [], []
    places = np.array([one.at for one in fitted.scan.located])[fitted.scan.below]
    low, high = places[:, 1:].min(axis=0), places[:, 1:].max(axis=0)
    room = presses.view.half / 4  # beyond the photographed places
    most = float(np.abs(presses.gauge.force).max())
    steps.begin("presses rendered for a network that reads forces", READER_S / 2)
    for k in range(READER_PRESSES):
        ball = presses.pictures[int(random.integers(len(presses.pictures)))].ball
        around = fitted.scan.around([each[ball] for each in presses.dents])
        depth = random.uniform(0.0, READER_DEPTH_RATIO * fitted.depth.max())
        depth = float(np.clip(depth, 1e-3, min(dents.depth[-1] for dents, _ in around)))
        x, y = random.uniform(low - room, high + room)
        face = DentFace(camera.untouched, around, (depth, float(x), float(y)), 0.0)
        seen.append(_seen(camera.develop(camera.image(face), random).astype(float) - flat))
        force = sum(share * float(dents.force_at(np.array([depth]))[0]) ** HERTZ_FORCE_POWER for dents, share in around)
        roots.append(force * (fitted.modulus.value / most) ** HERTZ_FORCE_POWER)
        if k % 20 == 0:
            steps.go_on(f"{k} of {READER_PRESSES}")
    steps.begin("a network that reads forces", READER_S / 2)
    inputs = np.tile(np.array(seen), (READER_COPIES, 1))
    inputs += random.normal(0, READER_NOISE_COUNTS / READER_UNIT_COUNTS, inputs.shape)
    wanted = np.tile(np.array(roots), READER_COPIES)
    return NormalNet.trained([(inputs, np.column_stack([wanted, np.zeros_like(wanted)]))])


def _seen(change: Array) -> Array:
    """The network's inputs from a change (H, W, 3) [counts]: means over READER_CELLS cells a side, smooth."""
    sides = np.array(change.shape[:2]) / READER_CELLS
    smooth = gaussian_filter(change, (*(sides / 2), 0))
    rows, columns = ((np.arange(READER_CELLS) + 0.5) * side for side in sides)
    return np.asarray(smooth[np.ix_(rows.astype(int), columns.astype(int))].ravel() / READER_UNIT_COUNTS)


def scaled(sensor: LitSensor, factors: Array) -> LitSensor:
    """The sensor with its red, green and blue light times factors (3,), and stray light for what the untouched picture
    would lose in the mean, as far as there is any."""
    camera = Renderer(sensor, CONTRAST_SPP, 0, markers=False)
    shown, stray = camera.flat().astype(float).mean(axis=(0, 1)), np.array(sensor.camera.ambient)
    left = np.maximum(stray + (1 - factors) * (shown - stray), 0.0)
    leds = tuple(led.model_copy(update={"radiance": rgb(factors * np.array(led.light)), "power": 1.0})
                 for led in sensor.leds)  # fmt: skip
    eye = sensor.camera.model_copy(update={"ambient": rgb(left)})
    return sensor.model_copy(update={"leds": leds, "camera": eye})
