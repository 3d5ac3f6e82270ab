"""Mitsuba's integrators `path` and `volpath` for a sensor: unbiased, with sampling noise. Mitsuba is imported here
only, inside functions."""

import math
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from tacgen.optics import coating, mitsuba_dicts
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.surface_grid import Sheet, Surface, Untouched
from tacgen.render import mitsuba_variants as probing

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.sensor.model import LitSensor

    Floats = NDArray[np.float64]
    Integers = NDArray[np.integer[Any]]

Window: TypeAlias = tuple[int, int, int, int]  # left, top, width, height [px]
SHEET_SPACING_MM = 0.1  # of the nodes of a deformed sheet [mm]
SCATTERING_SHEET_SPACING_MM = 0.3  # the same in a scattering gel, whose light spreads further sideways (9DTact: 0.7 mm)
MASK_PIXEL_MM = 0.02  # pixel of the marker texture [mm]
MAX_PATH_VERTICES = 12  # path vertices, interfaces included
MAX_SCATTERING_PATH_VERTICES = 64  # the same in a scattering gel
SCALAR_BLOCK_PX = 8  # side of the blocks that scalar variants render [px]
MAX_TRACED_PATHS = 2**25  # paths that variants with compiled kernels trace at once; each takes some 100 bytes
FILM_KEY = "sensor.film"


def mitsuba(name: str) -> Any:
    """Mitsuba with variant `name` switched on."""
    chosen = next((p for p in probing.variants() if p.variant == name), None) if name == probing.LLVM_VARIANT else None
    os.environ.update({k: v for k, v in probing.environment(chosen.library if chosen else "").items() if k != "_"})
    import mitsuba as mi

    mi.set_variant(name)
    return mi


def description(sensor: "LitSensor", sheet: Sheet, markers: bool) -> tuple[dict[str, Any], dict[str, Any]]:
    """The sensor without its coated face, and the coated face's BSDF, as plain dictionaries."""
    eye, camera = sensor.camera, PinholeCamera.from_sensor(sensor)
    pinhole = np.array(camera.pinhole)
    to_world = np.eye(4)
    to_world[:3, :3] = camera.turn * [-1, -1, 1]  # Mitsuba's camera has x to the left and y up
    to_world[:3, 3] = pinhole
    scene: dict[str, Any] = {
        "type": "scene",
        # blocks seed the sampler, and Mitsuba would cut as many as there are threads
        "integrator": {**integrator(sensor), "block_size": SCALAR_BLOCK_PX},
        "sensor": {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(eye.width_px / 2 / camera.focal_px))),
            "fov_axis": "x",
            "principal_point_offset_x": camera.crop_px[0] / eye.width_px,
            "principal_point_offset_y": camera.crop_px[1] / eye.height_px,
            "near_clip": min(0.1, eye.distance_mm / 2),
            "far_clip": 500.0,
            "to_world": to_world,
            "film": {
                "type": "hdrfilm",
                "width": eye.width_px,
                "height": eye.height_px,
                "rfilter": {"type": "box"},  # pixels stay independent, so the thread count cannot change a bit
                "pixel_format": "rgb",
                "component_format": "float32",
            },
            "sampler": {"type": "multijitter"},  # stratified: less noise for the same number of paths
        },
        **mitsuba_dicts.interfaces(sensor),
        **mitsuba_dicts.housing(sensor),
        **mitsuba_dicts.lights(sensor),
    }
    coat = coating.bsdf(sensor.coating)
    if mitsuba_dicts.scatters(sensor):  # paths are long
        coat = mitsuba_dicts.absorbing(coat)
    if markers and sensor.markers is not None:
        coat = coating.dotted(coat, sensor.markers, coating.mask(sensor.markers, sheet.size, MASK_PIXEL_MM))
    return scene, coat


def traced_sheet(sensor: "LitSensor") -> Sheet:
    """The nodes of a deformed face that is traced."""
    return Sheet.over(sensor.gel, SCATTERING_SHEET_SPACING_MM if mitsuba_dicts.scatters(sensor) else SHEET_SPACING_MM)


def integrator(sensor: "LitSensor") -> dict[str, Any]:
    """`path`, or `volpath` where a layer scatters, or light goes through an LED.

    In a gel that scatters no path ends by Russian roulette: Mitsuba's ends one in twenty at each vertex, whatever light
    it carries, and the first vertices, which all paths share, take most of the time.
    """
    if mitsuba_dicts.scatters(sensor):
        return {"type": "volpath", "max_depth": MAX_SCATTERING_PATH_VERTICES, "rr_depth": MAX_SCATTERING_PATH_VERTICES}
    return {
        "type": "volpath" if any(led.see_through for led in sensor.leds) else "path",
        "max_depth": MAX_PATH_VERTICES,
    }


def stratified(spp: int) -> int:
    """The least number of paths a pixel, at least `spp`, that Mitsuba's sampler divides into rows and columns."""
    rows = math.isqrt(spp)
    return rows * -(-spp // rows)


def realise(mi: Any, node: Any) -> Any:
    """A plain dictionary with its arrays turned into Mitsuba's transforms and bitmaps, its rectangles into meshes.

    Mitsuba's own rectangle is a mesh with texture coordinates, which are interpolated wherever a ray meets it: a
    tenth of a picture's time, and no LED, wall or interface has a texture.
    """
    if isinstance(node, dict) and node.get("type") == "rectangle":
        corners = node["to_world"] @ np.array([[-1, 1, 1, -1], [-1, -1, 1, 1], [0, 0, 0, 0], [1, 1, 1, 1]])
        parts = {k: v for k, v in node.items() if k not in ("type", "to_world")}
        return mesh(mi, corners[:3].T, np.array([[0, 1, 2], [0, 2, 3]]), parts)
    if isinstance(node, dict):
        return {k: realise(mi, v) for k, v in node.items()}
    if isinstance(node, np.ndarray):
        if node.shape == (4, 4):
            return mi.ScalarTransform4f(node.tolist())
        if node.ndim == 3:
            return mi.Bitmap(np.ascontiguousarray(node, dtype=np.float32))
        flipped = np.ascontiguousarray(node[::-1, :, None], dtype=np.float32)  # v runs up in a bitmap
        return mi.Bitmap(flipped)
    return node


def mesh(
    mi: Any,
    points: "Floats",
    faces: "Integers",
    parts: dict[str, Any],
    uv: "Floats | None" = None,
    smooth: bool = False,
) -> Any:
    """Triangles `faces` (m, 3) of points (n, 3) [mm] with texture coordinates (n, 2), if any, and normals that are
    interpolated if `smooth`; `parts` are plain dictionaries of its BSDF, emitter and media."""
    props = mi.Properties()
    for name, part in parts.items():
        props[name] = mi.load_dict(realise(mi, part), parallel=False, optimize=False)
    made = mi.Mesh("", len(points), len(faces), props, has_vertex_normals=smooth, has_vertex_texcoords=uv is not None)
    params = mi.traverse(made)
    params["faces"], params["vertex_positions"] = faces.ravel(), points.astype(np.float32).ravel()
    if uv is not None:
        params["vertex_texcoords"] = uv.astype(np.float32).ravel()
    params.update()
    return made


class PathTracer:
    """One sensor in Mitsuba. The scene is built once and only vertices move, because `load_dict` never frees all."""

    def __init__(self, sensor: "LitSensor", sheet: Sheet, markers: bool, variant: str) -> None:
        """Imports Mitsuba and switches it to `variant`."""
        self.sheet, self.variant = sheet, variant
        mi = self._mi = mitsuba(variant)
        scene, coat = description(sensor, sheet, markers)
        # texture coordinates place dots, and turn the frame in which stratified directions are sampled; a skin under a
        # gel that scatters shows neither these nor slopes
        plain = mitsuba_dicts.scatters(sensor) and not (markers and sensor.markers)
        uv = None if plain else sheet.uv
        face = mesh(mi, sheet.at(Untouched()), sheet.faces, {"bsdf": coat}, uv, smooth=not plain)
        # merged shapes would stand in another order each time, and the LEDs so draw other random numbers
        self._scene = mi.load_dict(realise(mi, scene) | {"face": face}, parallel=False, optimize=False)
        self._params = mi.traverse(self._scene)

    def radiance(self, surface: Surface, spp: int, seed: int) -> "Floats":
        """Linear radiance (H, W, 3): unbiased, noisy, the same for a seed at any thread count."""
        self._move(self.sheet.at(surface))
        return self._traced(spp, seed)

    def windows(self, nodes: "Floats", windows: Sequence[Window], spp: int, seed: int) -> "Floats":
        """Linear radiance in some windows alone, nan elsewhere; each draws random numbers of its own."""
        self._move(nodes)
        width, height = self._params[f"{FILM_KEY}.size"]
        picture = np.full((height, width, 3), np.nan)
        for i, (x, y, w, h) in enumerate(windows):
            self._crop(x, y, w, h)
            picture[y : y + h, x : x + w] = self._traced(spp, seed * len(windows) + i)
        self._crop(0, 0, width, height)
        return picture

    def _crop(self, x: int, y: int, width: int, height: int) -> None:
        self._params[f"{FILM_KEY}.crop_offset"], self._params[f"{FILM_KEY}.crop_size"] = (x, y), (width, height)
        self._params.update()

    def _move(self, nodes: "Floats") -> None:
        self._mi.set_variant(self.variant)
        self._params["face.vertex_positions"] = nodes.astype(np.float32).ravel()
        self._params.update()

    def _traced(self, spp: int, seed: int) -> "Floats":
        pixels = int(np.prod(self._params[f"{FILM_KEY}.crop_size"]))
        most = spp if self.variant == probing.SCALAR_VARIANT else max(1, MAX_TRACED_PATHS // pixels)
        count = -(-spp // most)
        seeds = [seed] if count == 1 else np.random.SeedSequence(seed).generate_state(count).tolist()
        paths = stratified(-(-spp // count))
        made = [np.array(self._mi.render(self._scene, spp=paths, seed=s), dtype=np.float64) for s in seeds]
        return np.asarray(np.mean(made, axis=0))
