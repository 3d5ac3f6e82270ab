"""Fit of a sensor whose gel scatters light.

The untouched photograph gives the LEDs' light, by least squares on maps traced with one LED at a time. Presses give the
gain by thickness: how the photographs change, over how transport says they should, on faces that are solved at depths
that may all be off by one factor.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

from tacgen.calibrate import press_faces
from tacgen.calibrate.likeness import ChangeLikeness
from tacgen.calibrate.photos import PhotographedPress, Photos
from tacgen.calibrate.result import Fitted, rgb, rms
from tacgen.errors import UserError
from tacgen.optics import camera_response, scattering
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.camera_view import CameraView
from tacgen.optics.surface_grid import Surface
from tacgen.recipe import background_photo
from tacgen.render import images, traced_maps
from tacgen.sensor.model import Camera as Eye
from tacgen.sensor.model import LitSensor, ThicknessResponse
from tacgen.sensor.yaml_source import KeyPath

Array = np.ndarray
CHANGES = (-2.1, -1.6, -1.2, -0.8, -0.4, -0.15, 0.0, 0.08, 0.16, 0.24, 0.32, 0.45)  # of thickness, for the gain [mm]
FACTORS = (0.92, 0.94, 0.96, 0.98, 1.0, 1.02, 1.04, 1.06, 1.08)  # tried factors on all depths
REACH = 9.0  # distance from a press within which pixels are compared [mm]
SPP = 64  # paths, as in render.Renderer
FIXED = 1e5  # weight of gain 1 at no change of thickness, over that of a pixel


@dataclass(frozen=True)
class RenderedPress:
    """A press rendered at one depth, over the whole picture (pixels, 3), and which pixels are `near` (pixels,)."""

    change: Array  # change of thickness (pixels,) [mm]
    own: Array  # rendered picture over the rendered untouched one
    wanted: Array  # photograph over the untouched photograph
    near: Array

    def off(self, table: Array, untouched: Array, camera: Eye) -> Array:
        """Misfit [counts] (k, 3) for a table of gains and an untouched picture of linear light (pixels, 3)."""
        response = ThicknessResponse(change_mm=CHANGES, gain=tuple(rgb(row) for row in table), source="fit")
        wanted, made = self.changes(response, untouched, camera)
        return np.asarray(made - wanted)

    def changes(self, response: ThicknessResponse | None, untouched: Array, camera: Eye) -> tuple[Array, Array]:
        """Change of counts (k, 3) as photographed, and as rendered with a gain, on an untouched picture (pixels, 3)."""
        gain = 1.0 if response is None else scattering.gain(response, self.change)
        lights = (untouched, untouched * self.wanted, untouched * self.own * gain)
        before, wanted, made = (255 * camera_response.encoded(light, camera)[self.near] for light in lights)
        return wanted - before, made - before


def fit(
    sensor: LitSensor, photos: Photos, held_out: list[int], folders: dict[KeyPath, Path]
) -> tuple[Fitted, tuple[ChangeLikeness, ...]]:
    """Fit radiances and the response to thickness; also the likeness of held-out presses, which count from 1.

    Raises:
        UserError: a press of unknown depth.
    """
    shallow = [press.name for press in photos.presses if press.depth is None]
    if shallow:
        raise UserError(
            f"{photos.folder / name}: needs depth_mm: through a gel that scatters no edge shows" for name in shallow
        )
    press_faces.check(sensor, photos, FACTORS[-1])
    light = images.Renderer(sensor, SPP, 0, False).light
    assert isinstance(light, images.Cloudy)
    maps = light.maps
    lights = powers(sensor, maps, photos.untouched)
    leds = zip(sensor.leds, lights, strict=True)
    made = sensor.model_copy(
        update={"leds": tuple(led.model_copy(update={"radiance": rgb(row), "power": 1.0}) for led, row in leds)}
    )
    now, before = (_off(s, maps, photos.untouched) for s in (made, sensor))
    if not photos.presses:
        return Fitted(made, now, before), ()
    bare = made.model_copy(update={"thickness_response": None})
    renderer, linear = (
        images.Renderer(bare, SPP, 0, False),
        camera_response.linear(photos.untouched / 255.0, sensor.camera).reshape(-1, 3),
    )
    seen = [_seen(bare, renderer, photos, press, folders) for press in photos.presses]  # by press, then by factor
    chosen = [k for k in range(len(seen)) if k + 1 not in held_out]
    best: tuple[float, Array, int] = (np.inf, np.zeros(0), 0)
    for i in range(len(FACTORS)):
        here = [seen[k][i] for k in chosen]
        table = gains(np.concatenate([s.change for s in here]), np.concatenate([s.wanted / s.own for s in here]))
        off = rms([s.off(table, linear, sensor.camera) for s in here])
        best = min(best, (off, table, i), key=lambda tried: tried[0])
    off, table, i = best
    rest = [seen[k - 1][i].off(table, linear, sensor.camera) for k in held_out]
    response_ = ThicknessResponse(change_mm=CHANGES, gain=tuple(rgb(row) for row in table), source="fit")
    whole = made.model_copy(update={"thickness_response": response_})
    fitted = Fitted(whole, now, before, off, rms(rest) if rest else None, FACTORS[i])
    if not held_out:
        return fitted, ()
    alike = []
    for response, k in ((sensor.thickness_response, FACTORS.index(1.0)), (response_, i)):
        judges = [seen[j - 1][k] for j in held_out]
        pairs = [judge.changes(response, linear, sensor.camera) for judge in judges]
        alike.append(ChangeLikeness.of(*(np.concatenate(part) for part in zip(*pairs, strict=True))))
    return fitted, tuple(alike)


def powers(sensor: LitSensor, maps: Array, untouched: Array) -> Array:
    """Radiances (leds, 3) with which maps (leds, h, w, 3) of unit radiance sum to a photograph (H, W, 3)."""
    h, w = maps.shape[1:3]
    wanted = background_photo.shrunk(camera_response.linear(untouched / 255.0, sensor.camera), w, h)
    shown = np.array([camera_response.expose(one, traced_maps.zoomed(sensor, w).camera) for one in maps])
    return np.asarray(
        np.array([nnls(shown[..., c].reshape(len(maps), -1).T, wanted[..., c].ravel())[0] for c in range(3)]).T
    )


def gains(change: Array, wanted: Array) -> Array:
    """Least-squares gain (changes, 3) at CHANGES, slightly smooth, through 1 at no change."""
    known = np.array(CHANGES)
    there = np.isfinite(change) & np.isfinite(wanted).all(axis=1)
    hat = np.array([np.interp(change[there], known, row) for row in np.eye(len(known))]).T
    bend = np.zeros((len(known) - 2, len(known)))
    for k in range(len(known) - 2):
        a, b = known[k + 1] - known[k], known[k + 2] - known[k + 1]
        bend[k, k : k + 3] = [1 / a, -1 / a - 1 / b, 1 / b]
    rows = np.vstack([hat, bend, FIXED * np.eye(len(known))[known == 0]])
    right = [np.concatenate([w, np.zeros(len(bend)), [FIXED]]) for w in wanted[there].T]
    return np.asarray(np.maximum(np.array([np.linalg.lstsq(rows, b, rcond=None)[0] for b in right]).T, 0.0))


def _seen(
    sensor: LitSensor, renderer: images.Renderer, photos: Photos, press: PhotographedPress, folders: dict[KeyPath, Path]
) -> list[RenderedPress]:
    """A press rendered at each of FACTORS times its depth."""
    assert press.depth is not None
    view, camera, flat = (
        CameraView(sensor, renderer.sheet, False),
        PinholeCamera.from_sensor(sensor),
        renderer.flat().astype(float),
    )
    before, after = (
        camera_response.linear(np.maximum(p, 1) / 255.0, sensor.camera).reshape(-1, 3)
        for p in (photos.untouched, press.picture)
    )

    def at(face: Surface) -> RenderedPress:
        seen = view.look(face)
        change = seen.position[:, 2] - renderer.untouched.at(seen.position[:, :2])[:, 2]
        own = (renderer.image(face).astype(float) / np.maximum(flat, 1e-12)).reshape(-1, 3)
        away = np.hypot(*(camera.project(seen.position) - press.center).T) * camera.mm_per_px
        return RenderedPress(change, own, after / before, away < REACH)

    depths = [factor * press.depth for factor in FACTORS]
    return [at(face) for face in press_faces.solved(sensor, press, depths, folders)]


def _off(sensor: LitSensor, maps: Array, untouched: Array) -> float:
    """Misfit [counts] of the untouched picture, rms, at the maps' scale."""
    h, w = maps.shape[1:3]
    made = np.einsum("khwc,kc->hwc", maps, [led.light for led in sensor.leds])
    shown = camera_response.expose(made, traced_maps.zoomed(sensor, w).camera)
    wanted = background_photo.shrunk(camera_response.linear(untouched / 255.0, sensor.camera), w, h)
    made, real = (camera_response.encoded(light, sensor.camera) for light in (shown, wanted))
    return rms([255 * (made - real)])
