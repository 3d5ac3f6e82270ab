"""Trial sensors with a clear gel against photographs: direct light, its reflection in the plate, and interreflection.

The picture is linear in the LEDs' radiance: for each trial of the other parameters, radiance and stray light follow
from non-negative least squares. The other parameters vary within their tolerances, with a penalty on the distance from
the sensor file. Presses are compared by their change against the untouched picture, so that marks on the coating and
errors of the background do not affect them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.optimize import nnls

from tacgen.base.errors import UserError
from tacgen.calibrate.cross_validation import rgb
from tacgen.calibrate.photos import PhotographedPress, Photos
from tacgen.optics import camera_response, coating, strip_light
from tacgen.optics.camera_view import CameraView, Samples
from tacgen.optics.direct_light import heights
from tacgen.optics.housing import bottom_depth, frame
from tacgen.optics.interreflection import Glow, Radiosity
from tacgen.optics.shadows import Terrain
from tacgen.optics.surface_grid import Sheet, Surface, Untouched
from tacgen.render import photograph, traced_maps
from tacgen.sensor import optics_checks
from tacgen.sensor.model import Camera, Led, LitSensor

Array = np.ndarray
PHOTO_PX_PER_FIT_PX = 4  # pixels of the photograph per pixel of the fit
MIN_FIT_WIDTH_PX = 40  # width of the fit's pictures at least [px]
TRIAL_SHEET_SPACING_MM = 0.2  # node spacing of the face [mm]
# largest distance of the points that stand for an LED, along and across it [mm]
MAX_LED_POINT_SPACING_ALONG_MM, MAX_LED_POINT_SPACING_ACROSS_MM = 3.0, 1.5
CONTACT_SHARE_COMPARED = 0.97  # contact radii within which a press is compared: there the face is the ball's surface
# the same for a press of known depth, whose face is solved and right beyond the contact too [mm]
DEPTH_PRESS_REACH_MM = 3.7
# contact radii, at least, within which such a press is compared if its contact is known too
MIN_DEPTH_PRESS_REACH = 1.4
PRESS_PIXEL_WEIGHT = 2.0  # weight of a press's pixel over one of the untouched picture
STRAY_LIGHT_PRIOR = 0.02  # change of stray light that costs the same [full scale]
RADIANCE_PRIOR = 0.5  # change of radiance that costs the same, over the LED's strongest channel
# sets of parameters whose light is kept: those about which derivatives are taken, and trials of steps
CACHED_LIGHTS = 4
UNTOUCHED_PIXELS = 1200  # pixels of the untouched picture that are compared, about, beside those of the presses
MAX_COMPARED_LIGHT = 0.95  # of full scale; brighter pixels are not compared
# largest slope of the response, which limits the weight of dark pixels [counts per unit of light]
MAX_RESPONSE_SLOPE = 1500.0
# length of an LED, over that of another one of its colour, below which it stands for light that comes back from walls:
# real LEDs of one colour are about as long as one another [-]
MAX_REFLECTION_LENGTH_RATIO = 0.5
LED_PARAMETERS = 6  # parameters of an LED: position, tilt about its length, turn about its upright, log of its length
SPECULAR, FACTOR = 0.1, 1.5  # tolerance of the specular weight; factor of an LED's length, roughness and vignette
MIN_LED_CLEARANCE_MM = 0.02  # smallest distance of LEDs from the housing and the untouched face [mm]


@dataclass(frozen=True)
class FitLimits:
    """Limits of a fit around the sensor file."""

    mm: float = 0.5  # tolerance of the LEDs' positions and of the crop [mm]; 0: radiances alone are fitted
    deg: float = 5.0  # tolerance of the LEDs' directions [deg]
    bare: bool = False  # the photographed gel has no markers, whatever the sensor file says
    steps: int = 1  # Jacobians at most, for each ridge


@dataclass(frozen=True)
class Picture:
    """A photograph at the fit's scale."""

    name: str
    light: Array  # (pixels, 3), linear, relative to full scale
    slope: Array  # (pixels, 3) [counts] per unit of light
    counts: Array  # (pixels,) bool: pixels that are compared
    face: Surface


@dataclass(frozen=True)
class ViewedFace:
    """Where the camera's rays meet the face of a picture."""

    view: CameraView
    at: Samples
    toward: Array  # unit directions in the gel to the camera, (pixels, 3)
    passed: Array  # transmission from the gel to the camera, (pixels,)
    terrain: Terrain


def _points(one: tuple[Led, ...]) -> strip_light.StripPoints:
    """The points that stand for a single LED."""
    wide, tall = one[0].size_mm
    along = max(6, int(np.ceil(wide / MAX_LED_POINT_SPACING_ALONG_MM)))
    across = max(2, int(np.ceil(tall / MAX_LED_POINT_SPACING_ACROSS_MM)))
    return strip_light.points(one, along, across)


def _reflection(led: Led, leds: Sequence[Led]) -> bool:
    """Whether an LED stands for light that another one's surroundings give back: a longer one has the same colour. Few
    pixels see it, so its radiance alone is fitted."""
    return any(
        np.argmax(led.light) == np.argmax(one.light) and led.size_mm[0] < MAX_REFLECTION_LENGTH_RATIO * one.size_mm[0]
        for one in leds
    )


class PhotometricModel:
    """Misfit between photographs and trial sensors."""

    def __init__(
        self, sensor: LitSensor, photos: Photos, faces: Sequence[Surface], limits: FitLimits, untouched: float = 1.0
    ) -> None:
        """`faces`: those of the presses; `untouched`: weight of a pixel of that picture."""
        self.limits = limits
        columns = max(min(MIN_FIT_WIDTH_PX, sensor.camera.width_px), sensor.camera.width_px // PHOTO_PX_PER_FIT_PX)
        self.sensor = traced_maps.zoomed(sensor, columns)
        self.sheet, rest = Sheet.over(sensor.gel, TRIAL_SHEET_SPACING_MM), Untouched.of(sensor.gel)
        self._bounce = Radiosity(self.sensor)
        sides = np.array([sensor.gel.width_mm, sensor.gel.height_mm]) / 2 + sensor.walls.margin_mm
        # half the housing's sides, and its depth [mm]
        self._room = np.array([*sides, bottom_depth(sensor)]) - MIN_LED_CLEARANCE_MM
        self._look = lru_cache(CACHED_LIGHTS * (1 + len(faces)))(self._looked)
        self._around = lru_cache(CACHED_LIGHTS * len(sensor.leds))(self._bounced)
        self._column = lru_cache(CACHED_LIGHTS * len(sensor.leds) * (1 + len(faces)))(self._lit)
        eye = self.sensor.camera
        self._glare = None
        if eye.glare is not None:
            self._glare = camera_response.expose(camera_response.glare(eye), eye).reshape(-1, 3)
        self._sparse = max(1, round(np.sqrt(eye.width_px * eye.height_px / UNTOUCHED_PIXELS)))
        self._even, self._first_weight = self._grid(), untouched * self._sparse
        near = [self._near(press) for press in photos.presses]
        needed = np.any([self._even, *near], axis=0)
        self.pictures = [self._picture("untouched", photos.untouched, needed, rest)]
        for press, face, here in zip(photos.presses, faces, near, strict=True):
            self.pictures.append(self._picture(press.name, press.picture, here, face))
        if not limits.bare and sensor.markers is not None:
            for number, picture in enumerate(self.pictures):
                points = self._look(number, (0.0, 0.0)).at.rest
                dots = coating.paint(sensor.markers, points, 3 * eye.mm_per_px)
                np.logical_and(picture.counts, np.nan_to_num(dots, nan=1.0) == 0, out=picture.counts)
        empty = [picture.name for picture in self.pictures if not picture.counts.any()]
        if empty:
            why = "no pixel can be compared: all are bright, under markers or outside the picture"
            raise UserError(f"{photos.folder}: {name}: {why}" for name in empty)
        self._least, self._most, self._start = self._ranges()
        leds = self.sensor.leds
        self.own = np.column_stack([np.array([led.light for led in leds]).T, eye.ambient])
        strongest = self.own[:, :-1].max(axis=0)
        lit = np.where(strongest > 0, strongest, strongest.max() or 1.0)
        self._power = np.tile(np.append(RADIANCE_PRIOR * lit, STRAY_LIGHT_PRIOR), (3, 1))

    def _picture(self, name: str, picture: Array, counts: Array, face: Surface) -> Picture:
        eye = self.sensor.camera
        light = camera_response.linear(picture / 255.0, eye)
        light = photograph.shrunk(light, eye.width_px, eye.height_px).reshape(-1, 3)
        counts = counts & (light < MAX_COMPARED_LIGHT).all(axis=1)
        slope = np.minimum(255 * camera_response.slope(light, eye), MAX_RESPONSE_SLOPE)
        return Picture(name, light, slope, counts, face)

    def _grid(self) -> Array:
        """The pixels of the untouched picture that are compared, on an even grid (pixels,) bool; each stands for the
        square of `_sparse`."""
        eye = self.sensor.camera
        y, x = np.mgrid[: eye.height_px, : eye.width_px]
        return np.asarray(((x % self._sparse == self._sparse // 2) & (y % self._sparse == self._sparse // 2)).ravel())

    def _near(self, press: PhotographedPress) -> Array:
        eye = self.sensor.camera
        shrink = press.picture.shape[1] / eye.width_px
        y, x = np.mgrid[: eye.height_px, : eye.width_px] + 0.5
        away = np.hypot(x * shrink - press.center[0], y * shrink - press.center[1] * press.aspect)
        contact = press.contact or 0.0
        reach = CONTACT_SHARE_COMPARED * contact
        if press.solved:
            reach = max(DEPTH_PRESS_REACH_MM / eye.mm_per_px * shrink, MIN_DEPTH_PRESS_REACH * contact)
        return np.asarray((away < reach).ravel())

    def _ranges(self) -> tuple[Array, Array, Array]:
        """Bounds and start of every parameter: those of the LEDs, then specular weight, roughness, vignette, crop."""
        mm, coat, eye = self.limits.mm, self.sensor.coating, self.sensor.camera
        rad, gloss, factor = (np.radians(self.limits.deg), SPECULAR, FACTOR) if mm > 0 else (0.0, 0.0, 1.0)
        led = np.array([*[(-mm, mm, 0.0)] * 3, *[(-rad, rad, 0.0)] * 2, (-np.log(factor), np.log(factor), 0.0)])
        rest = [
            (max(0.0, coat.specular - gloss), min(1.0, coat.specular + gloss), coat.specular),
            (coat.roughness / factor, min(1.0, coat.roughness * factor), coat.roughness),
            *((r / factor, r * factor, r) for r in eye.vignette_mm or (1.0, 1.0, 1.0)),
            *[(-mm, mm, 0.0)] * 2,
        ]
        each = [led * (not _reflection(one, self.sensor.leds)) for one in self.sensor.leds]
        least, most, start = np.concatenate([*each, rest]).T
        return least, most, start

    def moved(self, led: Led, parts: tuple[float, ...]) -> Led:
        """An LED changed by LED_PARAMETERS parameters, and moved back if it would leave the housing."""
        axes = frame(led.normal, led.up)
        for share in (1.0, 0.75, 0.5, 0.25):
            *by, tilt, turn, longer = share * np.array(parts)
            normal = axes[:, 2] * np.cos(tilt) * np.cos(turn) + axes[:, 1] * np.sin(tilt) + axes[:, 0] * np.sin(turn)
            size = np.minimum([led.size_mm[0] * np.exp(longer), led.size_mm[1]], 2 * self._room[:2].max())
            reach = np.abs(frame(normal, led.up)[:, :2] * size / 2).sum(axis=1)
            place = np.clip(np.add(led.center_mm, by), [*(reach[:2] - self._room[:2]), reach[2] - self._room[2]],
                            [*(self._room[:2] - reach[:2]), -reach[2] - MIN_LED_CLEARANCE_MM])  # fmt: skip
            numbers = {"center_mm": place, "normal": normal / np.linalg.norm(normal), "size_mm": size}
            tried = led.model_copy(update={key: tuple(float(c) for c in value) for key, value in numbers.items()})
            if not optics_checks.wrong_led(self.sensor, tried):  # at a round end or a dome the box is too large
                return tried
        return led

    def _looked(self, picture: int, crop: tuple[float, ...]) -> "ViewedFace":
        eye = self.sensor.camera
        moved = eye.model_copy(update={"crop_mm": tuple(np.add(eye.crop_mm, crop))})
        sensor = self.sensor.model_copy(update={"camera": moved})
        view = CameraView(sensor, self.sheet, False)
        at = view.look(self.pictures[picture].face)
        terrain = Terrain.of(heights(self.sheet, at.nodes), self.sheet.size)
        return ViewedFace(view, at, view.toward_camera(), view.transmission(), terrain)

    def _lit(self, picture: int, led: int, parts: tuple[float, ...], rough: float, crop: tuple[float, ...]) -> Array:
        """Direct light of one LED of unit radiance on a diffuse white coating and on a specular one, and its
        interreflection (RGB): (compared pixels, 5)."""
        seen, here = self._look(picture, crop), self.pictures[picture].counts
        one = (self.moved(self.sensor.leds[led], parts),)
        at, normal, toward = (part[here] for part in (seen.at.position, seen.at.normal, seen.toward))
        slab, panels = strip_light.Slab.of(self.sensor), strip_light.Panels.of(one)
        lights = _points(one)
        straight = strip_light.gather(at, normal, toward, lights, 1, slab, panels, rough, seen.terrain)[:, 0]
        bounced = self._around(led, parts, crop).at(seen.at.normal)[here]
        return np.column_stack([np.nan_to_num(straight * seen.passed[here, None]), bounced])

    def _bounced(self, led: int, parts: tuple[float, ...], crop: tuple[float, ...]) -> Glow:
        """Interreflection of one LED of unit radiance, with the coating of the file."""
        one = self.sensor.model_copy(update={"leds": (self.moved(self.sensor.leds[led], parts),)})
        added = self._bounce.added(one, _points(one.leds))[:, 0]
        return self._bounce.glow(added, self._look(0, crop).view)

    def columns(self, v: Array, picture: int) -> Array:
        """Light in each channel per unit radiance of each LED and of uniform stray light, in red, then green, then
        blue: (3, compared pixels, 3 (LEDs + 1))."""
        leds, coat = len(self.sensor.leds), self.sensor.coating
        parts = [tuple(p) for p in v[: LED_PARAMETERS * leds].reshape(leds, LED_PARAMETERS)]
        gloss, rough = v[LED_PARAMETERS * leds : LED_PARAMETERS * leds + 2]
        camera, crop = self._camera(v), tuple(v[-2:])
        lights = np.array([self._column(picture, k, parts[k], rough, crop) for k in range(leds)])
        made = [
            (1 - gloss) * albedo * lights[..., 0]
            + gloss * coating.METAL_REFLECTANCE * lights[..., 1]
            + lights[..., 2 + c]
            for c, albedo in enumerate(coat.albedo)
        ]
        fall = camera_response.vignette(camera).reshape(-1, 3)[self.pictures[picture].counts]
        lit = np.pad(camera.exposure * np.swapaxes(made, 1, 2), ((0, 0), (0, 0), (0, 1)), constant_values=1.0)
        mixed = np.repeat(camera_response.colours(camera)[..., None], leds + 1, axis=2)
        mixed[..., -1] = np.eye(3)  # stray light is not mixed by the colour matrix
        return np.asarray(np.einsum("dnk,cdk,nc->cndk", lit, mixed, fall).reshape(3, len(fall), -1))

    def _camera(self, v: Array) -> Camera:
        eye, (right, down) = self.sensor.camera, (float(x) for x in v[-2:])
        moved: dict[str, Any] = {"crop_mm": (eye.crop_mm[0] + right, eye.crop_mm[1] + down)}
        return eye.model_copy(update=moved | ({"vignette_mm": rgb(v[-5:-2])} if eye.vignette_mm else {}))

    def rows(self, v: Array, chosen: list[int]) -> list[Array]:
        """Equations of the chosen pictures for the radiances, in counts: by picture (3 pixels, 3 (LEDs + 1) + 1), red
        pixels first; the last column is the photograph."""
        out, first, untouched = [], self.pictures[0], self.columns(v, 0)
        for k in chosen:
            picture = self.pictures[k]
            here = picture.counts & (first.counts if k else self._even)
            change, wanted = (self.columns(v, k) if k else untouched)[:, here[picture.counts]], picture.light[here]
            if k:
                change, wanted = change - untouched[:, here[first.counts]], wanted - first.light[here]
            elif self._glare is not None:
                wanted = wanted - self._glare[here]
            slope = picture.slope[here]
            channels = [np.column_stack([change[c] * slope[:, c, None], wanted[:, c] * slope[:, c]]) for c in range(3)]
            out.append(np.concatenate(channels))
        return out

    def weighed(self, rows: list[Array], chosen: list[int]) -> Array:
        """Equations of the chosen pictures, one under the other, as the fit weighs them."""
        weights = [PRESS_PIXEL_WEIGHT if k else self._first_weight for k in chosen]
        return np.concatenate([weight * row for weight, row in zip(weights, rows, strict=True)])

    def lights(self, rows: list[Array], chosen: list[int], ridge: float) -> Array:
        """Best radiances (3, LEDs + 1), stray light last, held to the file's."""
        hold = np.column_stack([np.diag(ridge / self._power.ravel()), (ridge * self.own / self._power).ravel()])
        stacked = np.concatenate([self.weighed(rows, chosen), hold])
        return np.asarray(nnls(stacked[:, :-1], stacked[:, -1])[0].reshape(3, -1))

    def _names(self) -> list[str]:
        """Names of the parameters, and of the radiances and stray light of each channel."""
        leds = [led.name for led in self.sensor.leds]
        parts = [f"{led} {part}" for led in leds for part in ("x", "y", "z", "tilt", "turn", "length")]
        rest = ["specular", "roughness", "vignette red", "vignette green", "vignette blue", "crop x", "crop y"]
        lights = [f"{one} {c}" for c in ("red", "green", "blue") for one in (*leds, "stray light")]
        return [*parts, *rest, *lights]

    def _sensor(self, v: Array, lights: Array) -> LitSensor:
        """The sensor of a trial with its radiances, at the fit's scale."""
        leds = []
        for k, led in enumerate(self.sensor.leds):
            moved = self.moved(led, tuple(v[LED_PARAMETERS * k : LED_PARAMETERS * (k + 1)]))
            leds.append(moved.model_copy(update={"radiance": rgb(lights[:, k]), "power": 1.0}))
        gloss, rough = (float(x) for x in v[LED_PARAMETERS * len(leds) :][:2])
        eye = self._camera(v).model_copy(update={"ambient": rgb(lights[:, -1])})
        coat = self.sensor.coating.model_copy(update={"specular": gloss, "roughness": rough})
        return self.sensor.model_copy(update={"leds": tuple(leds), "camera": eye, "coating": coat})
