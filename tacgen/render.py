"""Sensor + deformed coated face -> camera images; the home of Mitsuba, which is imported only inside functions."""

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen import variants as probing
from tacgen.optics import coating, lights, response
from tacgen.optics.layers import Camera
from tacgen.optics.sheet import Flat, Sheet, Surface

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.sensor import Sensor

    Floats = NDArray[np.float64]

SPACING = 0.1  # [mm] between the sheet's nodes
MASK_PIXEL = 0.02  # [mm] of the marker texture
MAX_DEPTH = 12  # path vertices, interfaces included


def variant() -> str:
    """The Mitsuba variant that renders will use on this machine."""
    return probing.best().variant


def variants() -> list[probing.Probed]:
    """Every variant of interest and whether it really renders here."""
    return probing.variants()


def mitsuba(name: str) -> Any:
    """Mitsuba with variant `name` switched on."""
    chosen = next((p for p in probing.variants() if p.variant == name), None) if name == probing.LLVM else None
    os.environ.update({k: v for k, v in probing.environment(chosen.library if chosen else "").items() if k != "_"})
    import mitsuba as mi

    mi.set_variant(name)
    return mi


def description(sensor: "Sensor", sheet: Sheet, markers: bool) -> tuple[dict[str, Any], dict[str, Any]]:
    """The sensor without its coated face, and the coated face's BSDF, as plain dictionaries."""
    eye, camera = sensor.camera, Camera.from_sensor(sensor)
    pinhole = np.array(camera.pinhole)
    to_world = np.eye(4)
    to_world[:3, :3] = np.diag([-1, -1, 1])  # Mitsuba's camera has x to the left and y up
    to_world[:3, 3] = pinhole
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": MAX_DEPTH},
        "sensor": {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(eye.width_px / 2 / camera.focal_px))),
            "fov_axis": "x",
            "near_clip": 0.1,
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
            "sampler": {"type": "independent"},
        },
        **lights.interfaces(sensor),
        **lights.housing(sensor),
    }
    for i, light in enumerate(sensor.leds):
        scene[f"led_{i}"] = lights.led(light, sensor.walls.albedo)
    coat = coating.bsdf(sensor.coating)
    if markers and sensor.markers is not None:
        coat = coating.dotted(coat, sensor.markers, coating.mask(sensor.markers, sheet.size, MASK_PIXEL))
    return scene, coat


def realise(mi: Any, node: Any) -> Any:
    """A plain dictionary with its arrays turned into Mitsuba's transforms and bitmaps."""
    if isinstance(node, dict):
        return {k: realise(mi, v) for k, v in node.items()}
    if isinstance(node, np.ndarray):
        if node.shape == (4, 4):
            return mi.ScalarTransform4f(node.tolist())
        flipped = np.ascontiguousarray(node[::-1, :, None], dtype=np.float32)  # v runs up in a bitmap
        return mi.Bitmap(flipped)
    return node


class Renderer:
    """One sensor's camera. The scene is built once and only its vertices move, because `load_dict` never frees all."""

    def __init__(self, sensor: "Sensor", spp: int, seed: int, markers: bool, variant: str | None = None) -> None:
        """Raises: ValueError if spp < 1."""
        if spp < 1:
            raise ValueError(f"spp must be at least 1, not {spp}")
        self.sensor, self.spp, self.seed = sensor, spp, seed
        self.variant = variant or probing.best().variant
        self.sheet = Sheet.over(sensor.gel, SPACING)
        self._mi = mitsuba(self.variant)
        scene, coat = description(sensor, self.sheet, markers)
        built = realise(self._mi, scene)
        built["face"] = self._mesh(self._mi.load_dict(realise(self._mi, coat)))
        self._scene = self._mi.load_dict(built)
        self._params = self._mi.traverse(self._scene)
        self._vertices = next(k for k in self._params.keys() if k.endswith("vertex_positions"))
        self._normals = self._vertices.replace("vertex_positions", "vertex_normals")

    def _mesh(self, bsdf: Any) -> Any:
        mi, sheet = self._mi, self.sheet
        props = mi.Properties()
        props["bsdf"] = bsdf
        faces = sheet.faces
        mesh = mi.Mesh(
            "face", len(sheet.uv), len(faces), has_vertex_normals=True, has_vertex_texcoords=True, props=props
        )
        params = mi.traverse(mesh)
        params["faces"] = faces.ravel()
        params["vertex_texcoords"] = sheet.uv.astype(np.float32).ravel()
        params["vertex_positions"] = sheet.at(Flat()).astype(np.float32).ravel()
        params.update()
        return mesh

    def path(self, surface: Surface, spp: int, seed: int) -> "Floats":
        """Linear radiance (H, W, 3) by Mitsuba's `path`, unbiased, with its noise."""
        now = self.sheet.at(surface)
        self._params[self._vertices] = now.astype(np.float32).ravel()
        self._params.update()
        self._mi.set_variant(self.variant)
        return np.array(self._mi.render(self._scene, spp=spp, seed=seed), dtype=np.float64)

    def image(self, surface: Surface) -> "NDArray[np.float32]":
        """Linear radiance (H, W, 3) of a deformed face, before the response."""
        return self.path(surface, self.spp, self.seed).astype(np.float32)

    def flat(self) -> "NDArray[np.float32]":
        """Linear radiance (H, W, 3) of the untouched face."""
        return self.image(Flat())

    def develop(self, radiance: "NDArray[np.float32]") -> "NDArray[np.uint8]":
        """The camera's 8-bit sRGB picture (H, W, 3) of a radiance picture."""
        return response.develop(radiance.astype(np.float64), self.sensor.camera)
