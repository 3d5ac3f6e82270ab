"""Markers and flow of a sheared gel against Mitsuba's paths through the layers."""

from typing import NamedTuple

import numpy as np
import pytest
from helpers.tiny import sensor

from tacgen.calibrate import solved_presses
from tacgen.optics import coating
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.drawn_face import DrawnFace
from tacgen.optics.material_flow import Flow, MaterialPoints
from tacgen.optics.surface_grid import Sheet, Surface, Untouched
from tacgen.recipe import assets, loading, plan
from tacgen.recipe.model import Recipe
from tacgen.render import mitsuba_path
from tacgen.render.mitsuba_variants import SCALAR_VARIANT
from tacgen.sensor.model import LitSensor, Sensor

Array = np.ndarray
SHEAR = 0.5  # [mm]
DEPTHS = {"gelsight_mini": 1.0, "digit": 0.8, "ninedtact": 0.8}  # of a ball of 4 mm, before the shear [mm]
SPACING, SHEET = 0.05, 0.1  # distance of nodes [mm] of the traced face, and of tacgen's


class Error(NamedTuple):
    """In pixels: the largest motion, the largest error of markers, rms and largest of the flow."""

    moved: float
    markers_most: float
    flow_rms: float
    flow_most: float


def sheared(name: str) -> tuple[Sensor, Surface, Surface]:
    """A shipped sensor, its untouched face, and its face pressed and sheared by a ball."""
    sensor = loading.read_sensor(assets.sensor_path(name))[0]
    recipe = {
        "tacgen": 1, "name": "shear", "sensor": name, "indenter": {"shape": "sphere", "radius_mm": 4.0},
        "contact": {"friction": 2.0}, "outputs": ["force"], "quality": "draft",
        "trajectory": [{"press": {"depth_mm": DEPTHS[name], "frames": 1}}, {"slide": {"x_mm": SHEAR, "frames": 1}}],
    }  # fmt: skip
    (row,) = plan.expand(loading.checked(Recipe.model_validate(recipe), sensor)).rows
    untouched, _, moved = solved_presses.faces(row)
    return sensor, untouched, moved


def rest(sensor: LitSensor, sheet: Sheet, surface: Surface, spp: int, variant: str) -> Array:
    """Where the coating's point behind each pixel rests (H, W, 2) [mm], as Mitsuba's paths find it through the layers.

    The coating radiates its own UV, beside a constant by which losses on the way are divided out; nothing else does,
    and paths are only as long as the straight one. A layer that scatters is taken as clear.
    """
    mi = mitsuba_path.mitsuba(variant)
    layers = tuple(layer.model_copy(update={"scattering": None}) for layer in sensor.gel.layers)
    clear = sensor.model_copy(update={"gel": sensor.gel.model_copy(update={"layers": layers}), "leds": ()})
    scene, _ = mitsuba_path.description(clear, sheet, False)
    surfaces = 1 + sum(name.startswith("into_") for name in scene)
    scene["integrator"] |= {"max_depth": surfaces, "rr_depth": surfaces + 1}
    scene["sensor"]["sampler"] = {"type": "stratified", "sample_count": spp}
    glow = {"type": "area", "radiance": {"type": "mesh_attribute", "name": "vertex_uv1"}}
    face = mitsuba_path.mesh(mi, sheet.at(surface), sheet.faces, {"emitter": glow})
    face.add_attribute("vertex_uv1", 3, np.column_stack([sheet.uv, np.ones(len(sheet.uv))]).astype(np.float32).ravel())
    built = mi.load_dict(mitsuba_path.realise(mi, scene) | {"face": face})
    u, v, one = np.moveaxis(np.array(mi.render(built, spp=spp), dtype=np.float64), -1, 0)
    with np.errstate(invalid="ignore"):  # off the pad nothing radiates
        return np.asarray((np.stack([u, v], axis=-1) / one[..., None] - 0.5) * sheet.size)


def measure(sensor: LitSensor, untouched: Surface, moved: Surface) -> Error:
    """Errors of marker positions and of dense flow; a sensor without markers gets a grid of 1 mm."""
    camera, fine, own = PinholeCamera.from_sensor(sensor), *(Sheet.over(sensor.gel, d) for d in (SPACING, SHEET))
    before, after = (rest(sensor, fine, face, 100, SCALAR_VARIANT) for face in (untouched, moved))
    if sensor.markers is not None:
        dots = coating.centers(sensor.markers)
    else:
        dots = np.stack(np.meshgrid(np.arange(-7.0, 8.0), np.arange(-6.0, 7.0)), -1).reshape(-1, 2)
    face = DrawnFace(own, moved, camera)
    pixels, seen = MaterialPoints(dots, untouched, camera).at(face)
    flow = Flow(DrawnFace(own, untouched, camera)).at(face)
    h, w = camera.shape
    at = np.stack(np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5), -1)
    off = [_off(after, pixels[seen], dots[seen]), _off(after, (at + flow).reshape(-1, 2), before.reshape(-1, 2))]
    sizes = [np.linalg.norm(e[np.isfinite(e).all(1)], axis=1) for e in off]
    moved, rms = np.nanmax(np.linalg.norm(flow, axis=-1)), np.sqrt(np.mean(sizes[1] ** 2))
    return Error(float(moved), float(sizes[0].max()), float(rms), float(sizes[1].max()))


def _off(traced: Array, pixels: Array, rest: Array) -> Array:
    """Distance (n, 2) [px] of `pixels` (n, 2) from where a traced picture (h, w, 2) shows the points `rest` (n, 2)."""
    from scipy.ndimage import map_coordinates

    at = pixels.T[::-1] - 0.5

    def there(picture: Array) -> Array:
        return np.asarray(map_coordinates(picture, at, order=1, mode="constant", cval=np.nan))

    found = np.stack([there(traced[..., k]) for k in range(2)], -1)
    slope = np.stack([np.stack([there(d) for d in np.gradient(traced[..., k])[::-1]], -1) for k in range(2)], -2)
    whole = np.isfinite(found).all(1) & np.isfinite(slope).all((1, 2)) & np.isfinite(rest).all(1)
    off = np.full(pixels.shape, np.nan)
    off[whole] = np.linalg.solve(slope[whole], (rest - found)[whole, :, None])[..., 0]
    return -off


class Sheared:
    """A dent 0.6 mm deep in the middle of a shear of 0.5 mm, that fade together."""

    def at(self, xy: np.ndarray) -> np.ndarray:
        x, y = np.asarray(xy, float).T
        bump = np.exp(-((x - 0.5) ** 2 + (y + 0.3) ** 2) / 4)
        return np.column_stack([x + 0.5 * bump, y - 0.2 * bump, -0.6 * bump])


@pytest.mark.slow
def test_a_shear_of_half_a_millimetre_is_right_to_a_twentieth_of_a_pixel() -> None:
    model = sensor(camera={"mm_per_px": 0.08, "width_px": 100, "height_px": 80})
    error = measure(model, Untouched(), Sheared())
    assert error.moved > 6
    assert error.markers_most < 0.05
    assert error.flow_rms < 0.02
    assert error.flow_most < 0.1  # a tenth of it the noise of the paths


@pytest.mark.parametrize(
    "camera",
    [
        {"tilt_deg": (5, 0)},
        {"tilt_deg": (0, -5)},
        {"roll_deg": 7},
        {"crop_mm": (0.5, -0.3)},
        {"tilt_deg": (4, -3), "roll_deg": 5, "crop_mm": (0.4, -0.2), "center_mm": (0.3, 0.2)},
    ],
)
def test_a_camera_that_is_not_straight_sees_what_path_sees(camera: dict) -> None:
    model = sensor(camera=camera, gel={"corner_radius_mm": 0.0})
    sheet, dent = Sheet.over(model.gel, 0.1), Sheared()
    own, traced = (
        DrawnFace(sheet, dent, PinholeCamera.from_sensor(model)).behind(sheet.rest),
        rest(model, sheet, dent, 64, SCALAR_VARIANT),
    )
    off = (own - traced) / model.camera.mm_per_px
    assert np.sqrt(np.nanmean(off**2)) < 0.02
    straight = DrawnFace(sheet, dent, PinholeCamera.from_sensor(sensor())).behind(sheet.rest)
    assert np.nanmax(np.abs(straight - own)) > 0.25  # so it does say something


@pytest.mark.slow
@pytest.mark.parametrize("name", DEPTHS)
def test_on_the_shipped_sensors(name: str) -> None:
    model, untouched, moved = sheared(name)
    error = measure(model, untouched, moved)
    assert error.moved > 5
    assert error.markers_most < 0.05
    assert error.flow_rms < 0.02
