"""Fit of a sensor whose gel scatters light.

The untouched photograph gives the LEDs' light, by least squares on maps traced with one LED at a time. Presses give the
gain by thickness and how far it spreads sideways: how the photographs change, over how transport says they should, on
faces that are solved at depths that may all be off by one factor. The gain is held to the sensor file's by a ridge,
whose weight suits unseen presses best.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from tacgen.base.errors import UserError
from tacgen.calibrate import cross_validation as judging
from tacgen.calibrate import solved_presses, steps
from tacgen.calibrate.cross_validation import Fitted, HeldOutPresses, folds, rgb, rms
from tacgen.calibrate.photos import PhotographedPress, Photos
from tacgen.calibrate.render_comparison import ChangeLikeness
from tacgen.optics import camera_response, scattering
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.camera_view import CameraView
from tacgen.optics.surface_grid import Surface
from tacgen.render import images, photograph, traced_maps
from tacgen.sensor.model import Camera as Eye
from tacgen.sensor.model import LitSensor, ThicknessResponse
from tacgen.sensor.yaml_source import KeyPath

Array = np.ndarray
Choice = tuple[ThicknessResponse | None, int]  # response to thickness, number of the factor on depths
# of thickness, for the gain [mm]
GAIN_THICKNESS_CHANGES_MM = (-2.1, -1.6, -1.2, -0.8, -0.4, -0.15, 0.0, 0.04, 0.08, 0.16, 0.24, 0.32, 0.45)
DEPTH_FACTORS = (0.92, 0.94, 0.96, 0.98, 1.0, 1.02, 1.04, 1.06, 1.08)  # tried factors on all depths
GAIN_SPREADS_MM = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5)  # tried spreads of the gain [mm]
PRESS_REACH_MM = 9.0  # distance from a press within which pixels are compared [mm]
FIT_SPP = 64  # paths, as in render.Renderer
GAIN_RIDGES = (1.0, 0.1, 0.01, 0.001)  # tried weights of the file's gain, over that of all pixels

SOLVES_S, RENDERS_S = 12.0, 12.0  # expected work of a press at all depths [s of a core]


class Sums(NamedTuple):
    """Normal equations of the gain at GAIN_THICKNESS_CHANGES_MM, over pixels."""

    left: Array  # (changes, changes)
    right: Array  # (changes, 3)
    pixels: int


@dataclass(frozen=True)
class RenderedPress:
    """A press rendered at one depth, over the whole picture (pixels, 3), and which pixels are `near` (pixels,)."""

    change: Array  # change of thickness (h, w) [mm], nan off the pad
    mm_per_px: float
    own: Array  # rendered picture over the rendered untouched one
    wanted: Array  # photograph over the untouched photograph, as at a fixed exposure
    near: Array

    @property
    def gain(self) -> Array:
        """Photographed change over the rendered one (pixels, 3)."""
        return np.asarray(self.wanted / self.own)

    def weights(self, spread: float) -> Array:
        """Weights (k, changes) of the gains at GAIN_THICKNESS_CHANGES_MM where there is gel, spread sideways by
        `spread` [mm].
        """
        hats = _hats(np.nan_to_num(self.change).ravel()).reshape(*self.change.shape, -1)
        spread_hats = scattering.spread(hats, spread / self.mm_per_px)
        return np.asarray(spread_hats.reshape(self.change.size, -1)[self._there])

    def sums(self, spread: float) -> Sums:
        """The normal equations of its gains at GAIN_THICKNESS_CHANGES_MM, spread by `spread` [mm]."""
        hats = self.weights(spread)
        return Sums(hats.T @ hats, hats.T @ self.gain[self._there], len(hats))

    @property
    def _there(self) -> Array:
        return np.asarray(np.isfinite(self.change).ravel() & np.isfinite(self.gain).all(axis=1))

    def changes(self, response: ThicknessResponse | None, untouched: Array, camera: Eye) -> tuple[Array, Array]:
        """Change of counts (k, 3) as photographed, and as rendered with a gain, on an untouched picture (pixels, 3)."""
        gain: Array | float = 1.0
        if response is not None:
            gain = scattering.gains(response, self.change, self.mm_per_px).reshape(-1, 3)
        lights = (untouched, untouched * self.wanted, untouched * self.own * gain)
        before, wanted, made = (255 * camera_response.encoded(light, camera)[self.near] for light in lights)
        return wanted - before, made - before


def fit(sensor: LitSensor, photos: Photos, folders: dict[KeyPath, Path]) -> Fitted:
    """Fit radiances and the response to thickness, with the ridge that suits unseen presses best.

    Raises:
        UserError: a press of unknown depth.
    """
    shallow = [press.name for press in photos.presses if press.depth is None]
    if shallow:
        raise UserError(
            f"{photos.folder / name}: needs depth_mm: through a gel that scatters no edge shows" for name in shallow
        )
    solved_presses.check(sensor, photos, DEPTH_FACTORS[-1])
    light = images.Renderer(sensor, FIT_SPP, 0, False).light
    assert isinstance(light, images.Cloudy)
    each = zip(sensor.leds, powers(sensor, light.maps, photos.untouched), strict=True)
    leds = tuple(led.model_copy(update={"radiance": rgb(row), "power": 1.0}) for led, row in each)
    made = sensor.model_copy(update={"leds": leds})
    now, before = (_off(s, light.maps, photos.untouched) for s in (made, sensor))
    if not photos.presses:
        return Fitted(made, now, before)
    renders, groups = Renders.of(made, photos, folders), folds(len(photos.presses))
    ridge, unseen = _held_out(renders, sensor, photos, groups) if groups else (GAIN_RIDGES[-1], None)
    off, response, i = renders.best(list(range(len(photos.presses))), ridge)
    sure = renders.determined(i, ridge) if unseen else {}
    return Fitted(renders.sensor(response), now, before, off, DEPTH_FACTORS[i], unseen, ridge, sure)


def _held_out(
    renders: "Renders", sensor: LitSensor, photos: Photos, groups: list[list[int]]
) -> tuple[float, HeldOutPresses]:
    """The ridge that suits unseen presses best, and the scores of its fits, each to all but one group of presses."""
    held_out = [k - 1 for group in groups for k in group]
    tried: list[list[Choice]] = []
    seen = [[k for k in range(len(photos.presses)) if k + 1 not in group] for group in groups]
    for ridge in GAIN_RIDGES:
        fits: list[Choice] = [renders.best(some, ridge)[1:] for some in seen]
        tried.append([fit for fit, group in zip(fits, groups, strict=True) for _ in group])
    start: list[Choice] = [(sensor.thickness_response, DEPTH_FACTORS.index(1.0))] * len(held_out)
    counts = np.array([
        [renders.off(k, *fit) for k, fit in zip(held_out, choices, strict=True)]
        for choices in (start, *tried)
    ])  # fmt: skip
    number = int(np.argmin(counts[1:].mean(axis=1)))
    before, after = (renders.likeness(held_out, choices) for choices in (start, tried[number]))
    faces = tuple(renders.faces[k][i] for k, (_, i) in zip(held_out, tried[number], strict=True))
    sensors = tuple(renders.sensor(response) for response, _ in tried[number])
    presses = tuple(photos.presses[k] for k in held_out)
    return GAIN_RIDGES[number], HeldOutPresses(presses, faces, sensors, counts[[0, number + 1]], (before, after))


@dataclass
class Renders:
    """All presses rendered at each of DEPTH_FACTORS times their depths."""

    made: LitSensor  # with fitted radiances, without a response to thickness
    linear: Array  # untouched photograph (pixels, 3)
    file: Array  # gain of the sensor file (changes, 3)
    spread: float  # of that gain [mm]
    faces: Sequence[Sequence[Surface]]  # by press, then by factor
    seen: Sequence[Sequence[RenderedPress]]
    _kept: dict[tuple[int, int, float], Sums] = field(default_factory=dict)

    @classmethod
    def of(cls, made: LitSensor, photos: Photos, folders: dict[KeyPath, Path]) -> "Renders":
        """Solve and render the presses. `made`: the sensor with fitted radiances, and the response of its file."""
        file, known = made.thickness_response, np.array(GAIN_THICKNESS_CHANGES_MM)
        gain = np.ones((len(known), 3)) if file is None else scattering.gain(file, known)
        made = made.model_copy(update={"thickness_response": None})
        linear = camera_response.linear(photos.untouched / 255.0, made.camera).reshape(-1, 3)
        depths = [[factor * (press.depth or 0.0) for factor in DEPTH_FACTORS] for press in photos.presses]
        each = zip(photos.presses, depths, strict=True)
        texts = [f"{press.name}: solved at {len(DEPTH_FACTORS)} depths" for press in photos.presses]
        steps.expect((SOLVES_S + RENDERS_S) * len(texts))
        jobs = [(made, press, tried, folders) for press, tried in each]
        faces = steps.on_workers(solved_presses.solved, jobs, texts, SOLVES_S)
        fixed = made.model_copy(update={"camera": made.camera.model_copy(update={"auto_exposure": 0.0})})
        renderer, pairs = images.Renderer(fixed, FIT_SPP, 0, False), zip(photos.presses, faces, strict=True)
        seen = [_seen(made, renderer, photos, *pair) for pair in pairs]
        return cls(made, linear, gain, 0.0 if file is None else file.spread_mm, faces, seen)

    def sensor(self, response: ThicknessResponse | None) -> LitSensor:
        """The sensor with fitted radiances and a response to thickness."""
        return self.made.model_copy(update={"thickness_response": response})

    def best(self, chosen: list[int], ridge: float) -> tuple[float, ThicknessResponse, int]:
        """Misfit [counts], response, and number of the factor that suits the chosen presses best.

        The factor is chosen at the file's spread, and then the spread.
        """
        at = min(range(len(DEPTH_FACTORS)), key=lambda i: self._fitted(chosen, ridge, self.spread, i)[0])
        return min((self._fitted(chosen, ridge, spread, at) for spread in GAIN_SPREADS_MM), key=lambda one: one[0])

    def _fitted(self, chosen: list[int], ridge: float, spread: float, i: int) -> tuple[float, ThicknessResponse, int]:
        parts = [self._sums(k, i, spread) for k in chosen]
        table = gains(Sums(*(sum(part[1:], part[0]) for part in zip(*parts, strict=True))), self.file, ridge)
        rows = tuple(rgb(row) for row in table)
        response = ThicknessResponse(change_mm=GAIN_THICKNESS_CHANGES_MM, gain=rows, spread_mm=spread, source="fit")
        return rms([np.array([self.off(k, response, i)]) for k in chosen]), response, i

    def _sums(self, press: int, factor: int, spread: float) -> Sums:
        key = press, factor, spread
        if key not in self._kept:
            self._kept[key] = self.seen[press][factor].sums(spread)
        return self._kept[key]

    def off(self, press: int, response: ThicknessResponse | None, factor: int) -> float:
        """Misfit [counts] of a press."""
        wanted, made = self.seen[press][factor].changes(response, self.linear, self.made.camera)
        return rms([made - wanted])

    def likeness(self, presses: list[int], fits: list[Choice]) -> ChangeLikeness:
        """Likeness of presses, each with a response and the number of a factor."""
        pairs = zip(presses, fits, strict=True)
        shown = [self.seen[k][i].changes(response, self.linear, self.made.camera) for k, (response, i) in pairs]
        return ChangeLikeness.of(*(np.concatenate(part) for part in zip(*shown, strict=True)))

    def determined(self, factor: int, ridge: float) -> dict[str, float]:
        """Share of the gain at each of GAIN_THICKNESS_CHANGES_MM that the photographs determine."""
        hat = np.concatenate([press[factor].weights(self.spread) for press in self.seen])
        names = [f"gain at {change:+g} mm" for change in GAIN_THICKNESS_CHANGES_MM]
        return dict(zip(names, map(float, judging.determined(hat, np.sqrt(ridge * len(hat)))), strict=True))


def powers(sensor: LitSensor, maps: Array, untouched: Array) -> Array:
    """Radiances (leds, 3) with which maps (leds, h, w, 3) of unit radiance sum to a photograph (H, W, 3)."""
    shown, wanted = _at_scale(sensor, maps, untouched)
    each = [nnls(shown[..., c].reshape(len(maps), -1).T, wanted[..., c].ravel())[0] for c in range(3)]
    return np.array(each).T


def gains(sums: Sums, file: Array, ridge: float) -> Array:
    """Least-squares gain (changes, 3) at GAIN_THICKNESS_CHANGES_MM, slightly smooth, through 1 at no change, held to
    the file's.
    """
    known = np.array(GAIN_THICKNESS_CHANGES_MM)
    bend = np.zeros((len(known) - 2, len(known)))
    for k in range(len(known) - 2):
        a, b = known[k + 1] - known[k], known[k + 2] - known[k + 1]
        bend[k, k : k + 3] = [1 / a, -1 / a - 1 / b, 1 / b]
    hold, table, free = ridge * sums.pixels, np.ones((len(known), 3)), known != 0
    left, right = sums.left + bend.T @ bend + hold * np.eye(len(known)), sums.right + hold * file
    table[free] = np.linalg.solve(left[free][:, free], right[free] - left[free][:, ~free] @ table[~free])
    return np.maximum(table, 0.0)


def _hats(change: Array) -> Array:
    """Linear interpolation weights (n, changes) of changes of thickness (n,) [mm] at GAIN_THICKNESS_CHANGES_MM."""
    rows = np.eye(len(GAIN_THICKNESS_CHANGES_MM))
    return np.array([np.interp(change, GAIN_THICKNESS_CHANGES_MM, row) for row in rows]).T


def _seen(
    sensor: LitSensor, renderer: images.Renderer, photos: Photos, press: PhotographedPress, faces: Sequence[Surface]
) -> list[RenderedPress]:
    """A press rendered with each of its faces."""
    view, camera = CameraView(sensor, renderer.sheet, False), PinholeCamera.from_sensor(sensor)
    flat = renderer.flat().astype(float)
    before, after = (
        camera_response.linear(np.maximum(p, 1) / 255.0, sensor.camera).reshape(-1, 3)
        for p in (photos.untouched, press.picture)
    )
    share = sensor.camera.auto_exposure  # the mean has changed by its power 1 - share
    after *= (after.mean() / before.mean()) ** (share / (1 - share))

    def at(face: Surface) -> RenderedPress:
        steps.begin(f"{press.name}: rendered", RENDERS_S / len(faces))
        seen = view.look(face)
        change = seen.position[:, 2] - renderer.untouched.at(seen.position[:, :2])[:, 2]
        own = (renderer.image(face).astype(float) / np.maximum(flat, 1e-12)).reshape(-1, 3)
        away = np.hypot(*(camera.project(seen.position) - press.center).T) * camera.mm_per_px
        change, near = change.reshape(view.shape), away < PRESS_REACH_MM
        return RenderedPress(change, sensor.camera.mm_per_px, own, after / before, near)

    return [at(face) for face in faces]


def _off(sensor: LitSensor, maps: Array, untouched: Array) -> float:
    """Misfit [counts] of the untouched picture, rms, at the maps' scale."""
    lit = np.einsum("khwc,kc->hwc", maps, [led.light for led in sensor.leds])
    (shown,), wanted = _at_scale(sensor, lit[None], untouched)
    made, real = (camera_response.encoded(light, sensor.camera) for light in (shown, wanted))
    return rms([255 * (made - real)])


def _at_scale(sensor: LitSensor, maps: Array, untouched: Array) -> tuple[Array, Array]:
    """Maps (n, h, w, 3) as the camera exposes them, and the linear photograph (H, W, 3) in their size."""
    h, w = maps.shape[1:3]
    camera = traced_maps.zoomed(sensor, w).camera
    wanted = photograph.shrunk(camera_response.linear(untouched / 255.0, sensor.camera), w, h)
    return np.array([camera_response.expose(one, camera) for one in maps]), wanted
