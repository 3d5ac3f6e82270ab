"""Error of marker positions and flow, against Mitsuba's paths through plate and layers to the same deformed face.

Paths give the point of the coating behind each pixel; `markers` and `flow` map points to pixels. Each result is
therefore looked up in the traced picture, and the remaining difference is converted to pixels.
"""

from typing import NamedTuple

import numpy as np

from tacgen.calibrate import solved_presses
from tacgen.optics import coating
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.drawn_face import DrawnFace
from tacgen.optics.material_flow import Flow, MaterialPoints
from tacgen.optics.surface_grid import Sheet, Surface
from tacgen.recipe import assets, loading, plan
from tacgen.recipe.model import Recipe
from tacgen.render import mitsuba_path
from tacgen.sensor.model import LitSensor, Sensor

Array = np.ndarray
SHEAR = 0.5  # [mm]
DEPTHS = {"gelsight_mini": 1.0, "digit": 0.8, "ninedtact": 0.8}  # of a ball of 4 mm, before the shear [mm]
SPACING, SHEET = 0.05, 0.1  # distance of nodes [mm] of the traced face, and of tacgen's


class Error(NamedTuple):
    """In pixels: the largest motion, and rms and largest errors of markers and flow."""

    moved: float
    markers_rms: float
    markers_most: float
    flow_rms: float
    flow_most: float


def sheared(name: str, quality: str = "draft") -> tuple[Sensor, Surface, Surface]:
    """A shipped sensor, its untouched face, and its face pressed and sheared by a ball."""
    sensor = loading.read_sensor(assets.sensor_path(name))[0]
    recipe = {
        "tacgen": 1, "name": "shear", "sensor": name, "indenter": {"shape": "sphere", "radius_mm": 4.0},
        "contact": {"friction": 2.0}, "outputs": ["force"], "quality": quality,
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


def measure(sensor: LitSensor, untouched: Surface, moved: Surface, variant: str, spp: int = 256) -> Error:
    """Errors of marker positions and of dense flow; a sensor without markers gets a grid of 1 mm."""
    camera, fine, own = PinholeCamera.from_sensor(sensor), *(Sheet.over(sensor.gel, d) for d in (SPACING, SHEET))
    before, after = (rest(sensor, fine, face, spp, variant) for face in (untouched, moved))
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
    both = [float(value) for size in sizes for value in (np.sqrt(np.mean(size**2)), size.max())]
    return Error(float(np.nanmax(np.linalg.norm(flow, axis=-1))), *both)


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
