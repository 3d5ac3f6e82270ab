"""Comparison of rendered with photographed presses: the change of colour per slope of the ball's surface, and the error
of normals in photographs by a network that was trained on rendered pictures (network: Wang et al. 2021)."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from tacgen.calibrate import integrable_normals, normal_net
from tacgen.calibrate.normal_net import NormalNet
from tacgen.calibrate.photos import PhotographedPress
from tacgen.calibrate.solved_presses import mean_curvature
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.camera_view import CameraView
from tacgen.optics.hertz_dent import BallDent
from tacgen.optics.surface_grid import Surface
from tacgen.render.images import Renderer
from tacgen.sensor.model import LitSensor

Array = np.ndarray
SLOPE_CONTACT_SHARE = 0.95  # contact radii within which the slopes are the ball's
MIN_CONTRAST_CHANGE = 15.0  # changes below this are too noisy for a ratio [counts per slope]
CORRELATED_CONTACT_RADII = 1.7  # contact radii within which changes are correlated
TRAINING_DENTS = 192  # rendered dents that a network is trained on
# radii [mm], contact radius over that, at most [mm]
TRAINING_BALL_RADII_MM, TRAINING_CONTACT_SHARES, MAX_TRAINING_CONTACT_MM = (1.5, 5.5), (0.3, 0.75), 3.5
LIKENESS_SPP = 16  # samples a pixel
EVEN_LEVEL_COUNTS = 100.0  # about that of untouched pictures [counts]


class PressPixels(NamedTuple):
    """Pixels inside one contact circle, as a network sees them."""

    features: Array  # (n, 5), see normal_net.features
    slopes: Array  # x and y of the ball's unit normals (n, 2)
    where: Array  # the pixels (H, W) bool
    aspect: float = 1.0  # height of a pixel over its width

    @property
    def steepest(self) -> float:
        """Largest slope: hardly less than the contact radius over the ball's."""
        return float(np.linalg.norm(self.slopes, axis=1).max())

    def off(self, net: NormalNet) -> float:
        """Mean angle [deg] between the ball's normals and those of the surface that a network finds."""
        found = integrable_normals.integrable(net.normals(self.features), self.where, self.aspect)
        return float(normal_net.degrees_apart(self.slopes, found).mean())


@dataclass(frozen=True)
class PictureOfPress:
    """One press in a picture."""

    change: Array  # against the untouched picture (H, W, 3) [counts]
    untouched: Array  # that picture (H, W, 3) [counts]
    where: Array  # (H, W) bool: inside the contact circle
    slopes: Array  # x and y of the ball's unit normals there, (n, 2)
    flat: Array  # the same of the untouched face, (n, 2)
    aspect: float = 1.0  # height of a pixel over its width

    @property
    def pixels(self) -> PressPixels:
        """All pixels inside the contact circle."""
        inputs = normal_net.features(self.change, self.untouched, self.where)
        return PressPixels(inputs, self.slopes, self.where, self.aspect)

    @property
    def steep(self) -> float:
        """Mean angle [deg] between the ball's normals and those of the untouched face."""
        return float(normal_net.degrees_apart(self.slopes, self.flat).mean())

    def per_slope(self) -> Array:
        """Change per slope [counts] along x and y (3, 2) inside the contact circle, by least squares."""
        table = np.column_stack([np.ones(len(self.slopes)), self.slopes - self.flat])
        return np.asarray(np.linalg.lstsq(table, self.change[self.where], rcond=None)[0][1:].T)


@dataclass(frozen=True)
class Likeness:
    """Rendered compared with photographed presses, per channel (3,); angles in degrees."""

    # change per slope, rendered over real, median of presses where the real one is not MIN_CONTRAST_CHANGE
    contrast: Array
    direction: Array  # angle between the two, median
    correlation: Array  # of the change around the contact, median
    normals: float  # mean error of normals in photographs, by a network trained on rendered pictures
    noisy: float  # the same for the presses rendered with noise: what a perfect sensor file would reach
    flat: float  # the same for the untouched face
    each: Array  # error of normals in each photograph, (presses,)

    @classmethod
    def over(cls, parts: "Sequence[Likeness]") -> "Likeness":
        """Likeness of several groups of presses together: medians of the ratios, means of the angles."""
        sizes = [len(one.each) for one in parts]
        contrast, direction = (
            np.nanmedian([getattr(one, k) for one in parts], axis=0) for k in ("contrast", "direction")
        )
        noisy, flat = (float(np.average([getattr(one, k) for one in parts], weights=sizes)) for k in ("noisy", "flat"))
        each = np.concatenate([one.each for one in parts])
        alike = np.median([one.correlation for one in parts], axis=0)
        return cls(contrast, direction, alike, float(each.mean()), noisy, flat, each)

    def __str__(self) -> str:
        normals = f"real normals off by {self.normals:.1f} deg (rendered ones: {self.noisy:.1f}, flat: {self.flat:.1f})"
        return f"{of_change(self.contrast, self.correlation)}, {normals}"

    def plain(self) -> dict[str, Any]:
        """As JSON values."""
        return {"normals": self.normals, "noisy": self.noisy, "flat": self.flat} | {
            name: getattr(self, name).tolist() for name in ("contrast", "direction", "correlation")
        }


@dataclass(frozen=True)
class ChangeLikeness:
    """Likeness on a gel that scatters, whose colours follow its thickness: rendered over real change, correlation."""

    contrast: Array
    correlation: Array

    @classmethod
    def of(cls, real: Array, made: Array) -> "ChangeLikeness":
        """From changes (n, 3) against the untouched picture."""
        return cls((real * made).sum(axis=0) / (real**2).sum(axis=0), _correlation(real, made))

    def __str__(self) -> str:
        return of_change(self.contrast, self.correlation)

    def plain(self) -> dict[str, Any]:
        """As JSON values."""
        return {name: getattr(self, name).tolist() for name in ("contrast", "correlation")}


def of_change(contrast: Array, correlation: Array) -> str:
    """Both as text."""
    shown, alike = (" / ".join(f"{v:.2f}" for v in one) for one in (contrast, correlation))
    return f"contrast {shown} of the real (red / green / blue), correlation {alike}"


class Comparison:
    """Compares the renderer of a sensor with photographs."""

    def __init__(self, sensor: LitSensor) -> None:
        self.sensor, self._renderer = sensor, Renderer(sensor, LIKENESS_SPP, 0, markers=False)
        self._view = CameraView(sensor, self._renderer.sheet, markers=False)
        self.flat = self._renderer.develop(self._renderer.flat())  # untouched picture (H, W, 3)
        self._level = self._slopes(self._renderer.untouched)

    def photographed(self, press: PhotographedPress, face: Surface, untouched: Array) -> PictureOfPress:
        """A photographed press against the photograph of the untouched unit."""
        return self._seen(press.picture, untouched, face, press.center, press.contact or 0.0)

    def rendered(
        self, press: PhotographedPress, face: Surface, random: np.random.Generator | None = None
    ) -> PictureOfPress:
        """A rendered picture of a press, with the camera's noise if `random` is given."""
        return self._seen(self.picture(face, random), self.flat, face, press.center, press.contact or 0.0)

    def picture(self, face: Surface, random: np.random.Generator | None = None) -> Array:
        """Rendered picture (H, W, 3) of 8 bit of a face, with the camera's noise if `random` is given."""
        return self._renderer.develop(self._renderer.image(face), random)

    def net(self, presses: Sequence[PhotographedPress]) -> NormalNet:
        """A network trained on rendered dents with the camera's noise, at least as deep as presses."""
        return learned(dent.pixels for dent in self.dents(self.deepest(presses), TRAINING_DENTS))

    def deepest(self, presses: Sequence[PhotographedPress]) -> float:
        """Contact radius over the ball's that dents reach which stand for presses."""
        shares = [(press.contact or 0.0) * self.sensor.camera.mm_per_px / press.ball for press in presses]
        return max(TRAINING_CONTACT_SHARES[1], *shares)

    def likeness(
        self, presses: Sequence[PhotographedPress], faces: Sequence[Surface], untouched: Array,
        net: NormalNet | None = None,
    ) -> Likeness:  # fmt: skip
        """Likeness over presses with known contact circles.

        `net`: that of the presses, for changes over the untouched picture. Without one, changes are over an even level,
        so that lamps of a wrong power count as an error of normals.
        """
        each = list(zip(presses, faces, strict=True))
        real = [self.photographed(press, face, untouched) for press, face in each]
        made = [self.rendered(press, face) for press, face in each]
        per = np.array([[one.per_slope() for one in pair] for pair in zip(real, made, strict=True)])
        size, angle = np.linalg.norm(per, axis=3), np.degrees(np.arctan2(per[..., 1], per[..., 0]))
        turn = np.abs((angle[:, 1] - angle[:, 0] + 180) % 360 - 180)
        seen = ((size[:, 0] >= MIN_CONTRAST_CHANGE) | (size[:, 0] == size[:, 0].max(axis=0))) & (size[:, 0] > 0)
        around = [near(press, CORRELATED_CONTACT_RADII) for press in presses]
        alike = [_correlation(a.change[w], b.change[w]) for a, b, w in zip(real, made, around, strict=True)]
        random = np.random.default_rng(0)
        noisy = [self.rendered(press, face, random) for press, face in each]
        if net is None:
            level = np.full(untouched.shape, EVEN_LEVEL_COUNTS)
            dents = self.dents(self.deepest(presses), TRAINING_DENTS)
            net = learned(replace(one, untouched=level).pixels for one in dents)
            real, noisy = ([replace(one, untouched=level) for one in part] for part in (real, noisy))
        off, off_noisy = (np.array([one.pixels.off(net) for one in part]) for part in (real, noisy))
        return Likeness(
            _median(size[:, 1] / np.where(seen, size[:, 0], 1.0), seen), _median(turn, seen),
            np.median(alike, axis=0), float(off.mean()), float(off_noisy.mean()),
            float(np.mean([one.steep for one in real])), off,
        )  # fmt: skip

    def dents(self, deepest: float, count: int, seed: int = 0) -> Iterator[PictureOfPress]:
        """Rendered dents of balls of random size and place with the camera's noise; `deepest`: largest contact radius
        over the ball's."""
        random, camera = np.random.default_rng(seed), PinholeCamera.from_sensor(self.sensor)
        bend, untouched = mean_curvature(self.sensor.gel), self._renderer.untouched
        for _ in range(count):
            ball = float(np.exp(random.uniform(*np.log(TRAINING_BALL_RADII_MM))))
            reach = min(ball * random.uniform(TRAINING_CONTACT_SHARES[0], deepest), MAX_TRAINING_CONTACT_MM)
            x, y = (float(random.uniform(0, side)) for side in camera.shape[::-1])
            face = BallDent.seen(camera, ball, (x, y), reach / camera.mm_per_px, untouched, bend)
            yield self._seen(self.picture(face, random), self.flat, face, (x, y), reach / camera.mm_per_px)

    def _seen(
        self, picture: Array, untouched: Array, face: Surface, center: tuple[float, float], contact: float
    ) -> PictureOfPress:
        slopes, aspect = self._slopes(face), self.sensor.camera.aspect
        inside = circle(untouched.shape[:2], center, SLOPE_CONTACT_SHARE * contact, aspect)
        where = inside & np.isfinite(slopes + self._level).all(axis=2)
        change = picture.astype(float) - untouched
        return PictureOfPress(change, untouched, where, slopes[where], self._level[where], aspect)

    def _slopes(self, face: Surface) -> Array:
        """Slopes of the face behind each pixel: x and y of its unit normals (H, W, 2)."""
        return self._view.look(face).normal[:, :2].reshape(*self._view.shape, 2)


def learned(seen: Iterable[PressPixels]) -> NormalNet:
    """A network trained inside the contact circles of presses."""
    return NormalNet.trained([(one.features, one.slopes) for one in seen])


def circle(shape: tuple[int, ...], center: tuple[float, float], radius: float, aspect: float = 1.0) -> Array:
    """Pixels (H, W) bool whose centres are within a circle, its radius in pixel widths; `aspect`: their height over
    that."""
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    return np.asarray(np.hypot(x - center[0], (y - center[1]) * aspect) < radius)


def near(press: PhotographedPress, reach: float) -> Array:
    """Pixels within `reach` contact radii of a press's middle, (H, W) bool."""
    return circle(press.picture.shape, press.center, reach * (press.contact or 0.0), press.aspect)


def _correlation(real: Array, made: Array) -> Array:
    """Correlation (3,) of changes (n, 3) in each channel."""
    return np.array([np.corrcoef(a, b)[0, 1] for a, b in zip(real.T, made.T, strict=True)])


def _median(values: Array, where: Array) -> Array:
    """Median of each column of values (n, 3) over the rows chosen (n, 3); nan where none is."""
    return np.array([np.median(v[w]) if w.any() else np.nan for v, w in zip(values.T, where.T, strict=True)])
