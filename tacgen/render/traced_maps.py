"""Maps that are traced once for a sensor and cached: how light travels in a gel that scatters."""

import hashlib
import json
from collections.abc import Sequence
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tacgen.base import array_cache
from tacgen.optics import scattering
from tacgen.optics.camera_view import CameraView
from tacgen.optics.hertz_dent import BallDent
from tacgen.optics.surface_grid import Sheet, Untouched
from tacgen.render.mitsuba_path import (
    MAX_PATH_VERTICES,
    MAX_SCATTERING_PATH_VERTICES,
    SHEET_SPACING_MM,
    PathTracer,
    Window,
)
from tacgen.sensor.imperfections import COATING_PATTERN_FIELDS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.sensor.model import LitSensor

    Floats = NDArray[np.float64]

FLAT_SPACING_MM = 1.0  # of the nodes of a sheet that stays flat [mm]
MAP_WIDTH_PX = 40  # width of a traced map [px], whatever the image's
PATHS_PER_SAMPLE = 64  # paths in a pixel of a map for each sample a pixel (spp)
# the same under a dent: `reach` is then sure to 0.03 mm (0.06 with PATHS_PER_SAMPLE) at the largest spp
DENT_PATHS_PER_SAMPLE = 4 * PATHS_PER_SAMPLE
MAX_MAP_SPP = 24  # largest spp that counts for maps: two minutes on one slow core
MAP_BLUR_PX = 3.5  # standard deviation of the Gaussian that removes a map's noise [map pixels]
LINEAR_CAMERA_FIELDS = {
    "blur_mm",
    "exposure",
    "auto_exposure",
    "ambient",
    "vignette_mm",
    "colour_matrix",
    "response",
    "noise",
    "glare",
    "drift",
    "jpeg_quality",
}  # of the camera: what is laid over a picture's light
MAP_VERSION = 10  # of how the maps are made; part of their cache key
SCATTERED_VERSION = 2  # of how `scattered` is made; part of its key in the cache
MIN_DENT_CHANGE = 0.01  # share of the thickness by which a dent that is traced has changed a pixel, at least


class Scattered(NamedTuple):
    """How light travels in a gel that scatters."""

    alone: (
        "Floats"  # untouched images (leds, h, w, 3) by each LED alone, of unit radiance, so that their light can vary
    )
    bright: scattering.Brightness  # by thickness, from gels of uniform thickness
    reach: float  # lateral spread of light [mm], from a dent; assumed to be the same for all LEDs


def scattered(sensor: "LitSensor", spp: int, variant: str) -> Scattered:
    """Traced with Mitsuba's `variant`, or from the cache; more than MAX_MAP_SPP paths a pixel (`spp`) count as
    MAX_MAP_SPP.
    """
    coarse, untouched, spp = zoomed(sensor, MAP_WIDTH_PX), Untouched.of(sensor.gel), min(spp, MAX_MAP_SPP)
    shares, flat, leds = (
        np.array(scattering.THICKNESS_SHARES),
        Sheet.over(sensor.gel, FLAT_SPACING_MM),
        range(len(sensor.leds)),
    )

    def trace() -> "Floats":
        """Where colours are treated alike, three LEDs at a time, with the noise of each alone."""

        def radiance(lit: "LitSensor", seed: int) -> "Floats":
            return smooth(
                PathTracer(lit, flat, False, variant).radiance(untouched, spp * PATHS_PER_SAMPLE // 4, seed),
                MAP_BLUR_PX,
            )

        if not grey(sensor):
            return np.array([radiance(lit_by(coarse, {k}), k) for k in leds])
        threes = [leds[k : k + 3] for k in leds[::3]]
        made = [radiance(coloured(coarse, three), three[0])[..., : len(three)] for three in threes]
        return np.repeat(np.moveaxis(np.concatenate(made, axis=-1), -1, 0)[..., None], 3, axis=-1)

    def tabulate() -> "Floats":
        tracer = PathTracer(lit_by(zoomed(sensor, 8), set(leds)), flat, False, variant)
        faces = [scattering.UniformFace(sensor.gel, share) for share in shares]
        return np.array([tracer.radiance(face, spp * PATHS_PER_SAMPLE, 0).mean(axis=(0, 1)) for face in faces])

    def fitted_reach() -> "Floats":
        clear, sheet = scattering.depths(sensor.gel)[1], Sheet.over(sensor.gel, SHEET_SPACING_MM)
        middle = np.add(sensor.camera.center_mm, sensor.camera.crop_mm)
        size, contact = (share * clear for share in scattering.CALIBRATION_DENT)
        dent = BallDent(size, contact, (middle[0], middle[1]), untouched, clear)
        at = CameraView(coarse, sheet, False).look(dent)
        share = scattering.thickness(sensor.gel, at.position).reshape(alone.shape[1:3])
        window = around(np.abs(share - 1) > MIN_DENT_CHANGE, round(clear / coarse.camera.mm_per_px))
        evenly = lit_by(coarse, set(leds))
        traced = PathTracer(evenly, sheet, False, variant).windows(at.nodes, [window], spp * DENT_PATHS_PER_SAMPLE, 1)
        level = alone.sum(axis=0)
        ratio = np.divide(traced, level, out=np.ones_like(level), where=level > 0)  # past the gel all is dark
        return np.array(scattering.fitted_reach(bright, share, coarse.camera.mm_per_px, ratio))

    name = key(sensor, variant, spp, scattering.THICKNESS_SHARES, scattering.CALIBRATION_DENT, SCATTERED_VERSION)
    alone = array_cache.kept_one("untouched", name, trace)
    bright = scattering.Brightness.through(shares, array_cache.kept_one("brightness", name, tabulate))
    return Scattered(alone, bright, float(array_cache.kept_one("wander", name, fitted_reach)))


def around(there: "NDArray[np.bool_]", margin: int) -> Window:
    """The window of all pixels (h, w) that are `there`, and `margin` more on each side; of all pixels if none is."""
    rows, columns = np.nonzero(there)
    if not len(rows):
        return 0, 0, there.shape[1], there.shape[0]
    top, left = max(int(rows.min()) - margin, 0), max(int(columns.min()) - margin, 0)
    bottom, right = (min(int(n.max()) + 1 + margin, most) for n, most in zip((rows, columns), there.shape, strict=True))
    return left, top, right - left, bottom - top


def zoomed(sensor: "LitSensor", columns: int) -> "LitSensor":
    """The sensor with a coarser camera of the same field of view, with square pixels."""
    eye = sensor.camera
    scale = eye.width_px / columns
    rows = max(1, round(eye.height_px * eye.aspect / scale))
    size = {"width_px": columns, "height_px": rows, "mm_per_px": eye.mm_per_px * scale, "pixel_aspect": None}
    return sensor.model_copy(update={"camera": eye.model_copy(update=size)})


def lit_by(sensor: "LitSensor", numbers: set[int]) -> "LitSensor":
    """The sensor with unit radiance of some LEDs; the others are dark."""
    leds = enumerate(sensor.leds)
    lit = [led.model_copy(update={"radiance": (float(k in numbers),) * 3, "power": 1.0}) for k, led in leds]
    return sensor.model_copy(update={"leds": tuple(lit)})


def coloured(sensor: "LitSensor", numbers: Sequence[int]) -> "LitSensor":
    """The sensor with up to three LEDs of unit radiance, one in each colour channel; the others are dark."""
    light = np.zeros((len(sensor.leds), 3))
    light[numbers, np.arange(len(numbers))] = 1.0
    pairs = zip(sensor.leds, light.tolist(), strict=True)
    lit = [led.model_copy(update={"radiance": tuple(rgb), "power": 1.0}) for led, rgb in pairs]
    return sensor.model_copy(update={"leds": tuple(lit)})


def grey(sensor: "LitSensor") -> bool:
    """Whether all that light meets treats its colours alike."""
    albedos = [layer.scattering.albedo for layer in sensor.gel.clear_layers if layer.scattering]
    return all(len(set(albedo)) == 1 for albedo in (*albedos, sensor.coating.albedo))


def smooth(picture: "Floats", sigma: float) -> "Floats":
    """A map (h, w, 3) without its noise."""
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(picture, (sigma, sigma, 0), mode="nearest"))


def spread(coarse: "Floats", shape: tuple[int, int]) -> "Floats":
    """A smooth map (h, w, 3) over the same field of view at a finer shape (H, W, 3), by cubic splines."""
    from scipy.ndimage import map_coordinates

    scale = coarse.shape[1] / shape[1]  # rows share it: the coarse camera keeps the field of view in x
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    at = [
        (y - shape[0] / 2) * scale + coarse.shape[0] / 2 - 0.5,
        (x - shape[1] / 2) * scale + coarse.shape[1] / 2 - 0.5,
    ]
    return np.stack([map_coordinates(coarse[..., c], at, order=3, mode="nearest") for c in range(3)], axis=-1)


def key(sensor: "LitSensor", variant: str | None, *more: object) -> str:
    """The hash of what maps depend on: the sensor's optics and, where they are traced, Mitsuba's variant and version.

    Not the gel's mechanics, nor what acts on light linearly: the LEDs' power and colour, and the camera's response.
    """
    parts_seen = {"plate", "coating", "walls", "leds", "camera", "gel"}
    linear: Any = {
        "leds": {"__all__": {"radiance", "power"}},
        "camera": LINEAR_CAMERA_FIELDS,
        "coating": set(COATING_PATTERN_FIELDS),
    }
    seen = sensor.model_dump(mode="json", exclude_none=True, include=parts_seen, exclude=linear)
    from tacgen.sensor.layers import LayerBase

    optical = LayerBase.model_fields  # the law's own fields are not among them
    seen["gel"]["layers"] = [{k: v for k, v in layer.items() if k in optical} for layer in seen["gel"]["layers"]]
    how = [
        MAP_VERSION,
        MAP_WIDTH_PX,
        PATHS_PER_SAMPLE,
        DENT_PATHS_PER_SAMPLE,
        MAP_BLUR_PX,
        SHEET_SPACING_MM,
        MAX_PATH_VERTICES,
        MAX_SCATTERING_PATH_VERTICES,
    ]
    parts = [seen, variant, variant and version("mitsuba"), how, more]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:32]
