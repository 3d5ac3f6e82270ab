"""Sensor + deformed coated face -> camera images; the home of Mitsuba, which is imported only inside functions.

An image is direct light and its mirror image in the plate, summed without noise (optics/direct), plus what light that
was scattered before adds: the difference between Mitsuba's `path` and that sum on the untouched face, a smooth map
traced once per sensor and kept in the cache. `PathTracer` is the whole truth at any spp, for checking it.
"""

import hashlib
import json
import os
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from tacgen import variants as probing
from tacgen.optics import coating, lights, response
from tacgen.optics.direct import Direct
from tacgen.optics.layers import Camera
from tacgen.optics.sheet import Flat, Sheet, Surface

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.sensor import LitSensor

    Floats = NDArray[np.float64]

SPACING = 0.1  # [mm] between the sheet's nodes
MASK_PIXEL = 0.02  # [mm] of the marker texture
MAX_DEPTH = 12  # path vertices, interfaces included
BLOCK = 8  # [px] side of the blocks that scalar variants work on
COLUMNS = 40  # of the map of scattered light, whatever the image's: its blur must stay short of the strips
PATHS = 64  # in a pixel of the map, for each path a pixel that was asked for
SMOOTH = 2.0  # [map pixels] the Gaussian that takes the noise off that map
MAP_VERSION = 3  # of how the map is made; part of its cache key


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


def description(sensor: "LitSensor", sheet: Sheet, markers: bool) -> tuple[dict[str, Any], dict[str, Any]]:
    """The sensor without its coated face, and the coated face's BSDF, as plain dictionaries."""
    eye, camera = sensor.camera, Camera.from_sensor(sensor)
    pinhole = np.array(camera.pinhole)
    to_world = np.eye(4)
    to_world[:3, :3] = np.diag([-1, -1, 1])  # Mitsuba's camera has x to the left and y up
    to_world[:3, 3] = pinhole
    scene: dict[str, Any] = {
        "type": "scene",
        # blocks seed the sampler, and Mitsuba would cut as many as there are threads
        "integrator": {"type": "path", "max_depth": MAX_DEPTH, "block_size": BLOCK},
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


class PathTracer:
    """One sensor in Mitsuba. The scene is built once and only vertices move, because `load_dict` never frees all."""

    def __init__(self, sensor: "LitSensor", sheet: Sheet, markers: bool, variant: str) -> None:
        """Imports Mitsuba and switches it to `variant`."""
        self.sheet, self.variant = sheet, variant
        self._mi = mitsuba(variant)
        scene, coat = description(sensor, sheet, markers)
        built = realise(self._mi, scene)
        # merged shapes would stand in another order each time, and the LEDs so draw other random numbers
        built["face"] = self._mesh(self._mi.load_dict(realise(self._mi, coat), parallel=False, optimize=False))
        self._scene = self._mi.load_dict(built, parallel=False, optimize=False)
        self._params = self._mi.traverse(self._scene)
        self._vertices = next(k for k, _ in self._params if k.endswith("vertex_positions"))

    def radiance(self, surface: Surface, spp: int, seed: int) -> "Floats":
        """Linear radiance (H, W, 3) by `path`: unbiased, noisy, the same for a seed at any thread count."""
        self._mi.set_variant(self.variant)
        self._params[self._vertices] = self.sheet.at(surface).astype(np.float32).ravel()
        self._params.update()
        return np.array(self._mi.render(self._scene, spp=spp, seed=seed), dtype=np.float64)

    def _mesh(self, bsdf: Any) -> Any:
        mi, sheet, faces = self._mi, self.sheet, self.sheet.faces
        props = mi.Properties()
        props["bsdf"] = bsdf
        mesh = mi.Mesh(
            "face", len(sheet.uv), len(faces), has_vertex_normals=True, has_vertex_texcoords=True, props=props
        )
        params = mi.traverse(mesh)
        params["faces"] = faces.ravel()
        params["vertex_texcoords"] = sheet.uv.astype(np.float32).ravel()
        params["vertex_positions"] = sheet.at(Flat()).astype(np.float32).ravel()
        params.update()
        return mesh


class Renderer:
    """One sensor's camera."""

    def __init__(
        self,
        sensor: "LitSensor",
        spp: int,
        seed: int,
        markers: bool,
        variant: str | None = None,
        method: Literal["transport", "path"] = "transport",
    ) -> None:
        """By `transport`, `spp` paths a pixel go into the map of scattered light; by `path`, into every image.

        `variant` is Mitsuba's, the best here if None; `seed` is that of the paths in images.

        Raises:
            ValueError: spp < 1.
        """
        if spp < 1:
            raise ValueError(f"spp must be at least 1, not {spp}")
        self.sensor, self.spp, self.seed, self.markers = sensor, spp, seed, markers
        self.variant = variant or probing.best().variant
        self.sheet = Sheet.over(sensor.gel, SPACING)
        self._pieces, rays = effort(spp)
        self._direct = Direct(sensor, self.sheet, markers, self._pieces, rays)
        self._scattered: Floats | None = None
        self._tracer = PathTracer(sensor, self.sheet, markers, self.variant) if method == "path" else None
        self._traced = 0  # images so far: each gets noise of its own

    def image(self, surface: Surface) -> "NDArray[np.float32]":
        """Linear radiance (H, W, 3) of a deformed face, before the response; transport's only noise is the map's."""
        if self._tracer is not None:
            self._traced += 1
            seed = int(np.random.SeedSequence((self.seed, self._traced)).generate_state(1)[0])
            traced = self._tracer.radiance(surface, self.spp, seed)
            stray = self._direct.dimmed(self._direct.look(surface), response.stray(self.sensor.camera))
            return (traced + stray).astype(np.float32)
        rest = self.scattered() + response.stray(self.sensor.camera)
        return self._direct.radiance(surface, rest).astype(np.float32)

    def flat(self) -> "NDArray[np.float32]":
        """Linear radiance (H, W, 3) of the untouched face."""
        return self.image(Flat())

    def develop(self, radiance: "NDArray[np.float32]") -> "NDArray[np.uint8]":
        """The camera's 8-bit sRGB picture (H, W, 3) of a radiance picture."""
        return response.develop(radiance.astype(np.float64), self.sensor.camera)

    def scattered(self) -> "Floats":
        """Radiance (H, W, 3) that scattered light adds on the untouched bare coat: from the cache, else traced."""
        if self._scattered is None:
            store = probing.cache_folder() / "scattered" / f"{self._key()}.npy"
            try:
                coarse = np.load(store, allow_pickle=False)
            except (OSError, ValueError):
                coarse = self._trace()
                keep(store, coarse)
            self._scattered = spread(coarse, Camera.from_sensor(self.sensor).shape)
        return self._scattered

    def _trace(self) -> "Floats":
        from scipy.ndimage import gaussian_filter

        eye = self.sensor.camera
        scale = eye.width_px / COLUMNS
        w, h = COLUMNS, max(1, round(eye.height_px / scale))
        coarse = eye.model_copy(update={"width_px": w, "height_px": h, "mm_per_px": eye.mm_per_px * scale})
        sensor = self.sensor.model_copy(update={"camera": coarse})
        full = PathTracer(sensor, self.sheet, False, self.variant).radiance(Flat(), self.spp * PATHS, 0)
        # the same points on the strips as in the images, so that the map also mends what so few of them miss
        rest = full - Direct(sensor, self.sheet, False, self._pieces, 4).radiance(Flat())
        return np.asarray(gaussian_filter(rest, (SMOOTH, SMOOTH, 0), mode="nearest"))

    def _key(self) -> str:
        """What the map depends on, hashed: the sensor's optics, spp, variant and versions; not the gel's mechanics."""
        parts_seen = {"plate", "coating", "walls", "leds", "camera", "gel"}
        seen = self.sensor.model_dump(mode="json", exclude_none=True, include=parts_seen)
        from tacgen.sensor import LayerBase

        optical = LayerBase.model_fields  # the law's own fields are not among them
        seen["gel"]["layers"] = [{k: v for k, v in layer.items() if k in optical} for layer in seen["gel"]["layers"]]
        parts = [
            seen,
            self.spp,
            self._pieces,
            self.variant,
            version("mitsuba"),
            MAP_VERSION,
            COLUMNS,
            PATHS,
            SMOOTH,
            SPACING,
            MAX_DEPTH,
        ]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:32]


def effort(spp: int) -> tuple[tuple[int, int], int]:
    """Points on each strip (along, up), and rays along a pixel's side, that go with `spp` paths a pixel."""
    if spp < 32:
        return (6, 3), 1
    return ((8, 4), 1) if spp <= 256 else ((16, 8), 2)


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


def keep(store: Path, array: "Floats") -> None:
    """Write an array to the cache in one step; a cache that cannot be written costs time, never the run."""
    part = store.with_suffix(f".part-{os.getpid()}.npy")
    try:
        store.parent.mkdir(parents=True, exist_ok=True)
        np.save(part, array)
        part.replace(store)
    except OSError:
        with suppress(OSError):
            part.unlink()
