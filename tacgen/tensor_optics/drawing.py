"""Pictures of many faces at once, by the light and camera of a sensor, on a GPU."""

import math
from collections.abc import Sequence

import numpy as np
import torch
import triton
from torch import Tensor

from tacgen.optics import camera_response, coating
from tacgen.optics.direct_light import Direct
from tacgen.optics.gaussian import weights
from tacgen.optics.interreflection import NORMAL_DIFFERENCE, Glow
from tacgen.optics.shadows import LARGE_BLOCK_CELLS, SMALL_BLOCK_CELLS
from tacgen.physics.strip_columns import MAX_NORMAL_Z
from tacgen.tensor_optics import gpu_light, gpu_noise, gpu_response
from tacgen.tensor_optics.gpu_faces import FaceDrawer

Array = np.ndarray
SINGLE_TYPE, DOUBLE_TYPE = torch.float32, torch.float64


class Drawing:
    """Pictures as render.images.Renderer makes them by `transport` in a clear gel with a ray a pixel, of many faces in
    some ten launches.

    Light is computed for every sample, not interpolated between some, in single precision. Nothing depends on the order
    in which a GPU works: the same faces, the same bytes.
    """

    def __init__(self, direct: Direct, glow: Glow, stray: "Array | None", texture: "Array | None", device: str) -> None:
        """stray (3,): radiance of a coating without dots in the stray light; texture (h, w): the coating's pattern.

        Raises:
            ValueError: more than one ray a pixel, or a sheet of a part of the pad.
        """
        view, columns = direct.view, direct.columns
        if view.samples != 1:
            raise ValueError("a picture with one ray a pixel is needed")
        self._sensor, self._device, self._shape = direct.sensor, device, view.camera.shape
        self._faces = FaceDrawer(direct.sheet, view.camera, direct.untouched, device)
        self._sheet, self._markers = direct.sheet, view.markers
        self._rest = on(device, direct.sheet.rest, SINGLE_TYPE)
        self._toward, self._passed = (
            on(device, direct.toward, SINGLE_TYPE),
            on(device, direct.transmission, SINGLE_TYPE),
        )
        self._table, self._lamps, self._mirror = (
            on(device, columns.light, SINGLE_TYPE),
            len(columns.middle),
            columns.mirror,
        )
        self._middle, self._strip = on(device, columns.middle, SINGLE_TYPE), on(device, columns.strip, torch.int32)
        self._corner = on(device, np.concatenate([columns.lowest, columns.step]), SINGLE_TYPE)
        matt, gloss = (np.pad(each, ((0, 0), (0, 6 - each.shape[1]))) for each in direct.shares())
        self._matt, self._gloss = on(device, matt, SINGLE_TYPE), on(device, gloss, SINGLE_TYPE)
        self._glow, self._level = on(device, glow.terms, SINGLE_TYPE), on(device, glow.untouched, SINGLE_TYPE)
        coat = self._sensor.coating
        paint = np.full(3, self._markers.albedo if self._markers else 0.0)
        beside = np.zeros(3) if stray is None else stray
        colours = np.stack([view.change, beside, coating.white(coat), paint])
        self._colours = on(device, colours, SINGLE_TYPE)
        self._dots = on(device, np.array(self._markers.row_counts if self._markers else [0]), torch.int32)
        self._texture = on(device, np.ones((2, 2)) if texture is None else texture, SINGLE_TYPE)
        self._woven = texture is not None
        self._camera_parts()

    def _camera_parts(self) -> None:
        """The camera's blur and response as tensors."""
        eye, device = self._sensor.camera, self._device
        self._weights = on(device, weights(eye.blur_mm / eye.mm_per_px), SINGLE_TYPE) if eye.blur_mm else None
        self._fall = on(device, eye.exposure * camera_response.vignette(eye), DOUBLE_TYPE)
        grain = [0.0] * 7 if eye.noise is None else [*eye.noise.shot, *eye.noise.read, eye.noise.strength]
        self._grain = on(device, np.array(grain), DOUBLE_TYPE)
        least, counts = camera_response.steps(eye.response)
        self._steps, self._counts = on(device, least, DOUBLE_TYPE), on(device, counts, torch.uint8)
        self._quantiles = on(device, camera_response.quantiles(), SINGLE_TYPE)
        height, width = self._shape
        steps = 0 if eye.noise is None else math.ceil(3 * height * width / 4)  # of a generator, for a picture's noise
        self._jumps = on(device, gpu_noise.jumps(steps), torch.int64)

    def radiance(self, nodes: Array) -> Tensor:
        """Linear radiance (F, H, W, 3), before the response, of faces by the positions (F, n, 3) [mm] of the sheet's
        nodes."""
        faces = self._faces.draw(on(self._device, nodes, DOUBLE_TYPE))
        (height, width), frames, (rows, columns) = self._shape, len(nodes), self._sheet.shape
        terrains, eye, dots = faces.terrains, self._sensor.camera, self._markers
        across, down, radius = (1.0, 1.0, 1.0) if dots is None else (*dots.spacing_mm, dots.diameter_mm / 2)
        middle = (0.0, 0.0) if dots is None else dots.middle_mm
        glossy = self._sensor.coating.specular > 0.0
        out = torch.empty((frames, height, width, 3), dtype=SINGLE_TYPE, device=self._device)
        gpu_light.light[triton.cdiv(height * width, gpu_light.SAMPLES_PER_PROGRAM), frames](
            faces.keys, self._faces.triangles, faces.screen, faces.nodes, faces.facing, self._rest,
            terrains.heights, terrains.small, terrains.large, terrains.extent, self._toward, self._passed,
            self._table, self._middle, self._strip, self._corner, self._matt, self._gloss, self._glow, self._level,
            self._dots, self._colours, self._texture, out,
            height * width, width, nodes.shape[1], rows, columns,
            *terrains.small.shape[1:], *terrains.large.shape[1:], *map(float, self._sheet.size),
            *self._table.shape[:3], self._lamps, float(self._mirror), float(self._sensor.coating.roughness),
            MAX_NORMAL_Z, 1.5 * NORMAL_DIFFERENCE, len(self._dots),
            math.floor(2 * (radius + eye.mm_per_px / 2) / down) + 1,
            float(across), float(down), float(radius), float(eye.mm_per_px), *map(float, middle), *self._texture.shape,
            glossy, 0 if dots is None else 2 if glossy else 1, self._woven, SMALL_BLOCK_CELLS, LARGE_BLOCK_CELLS,
            gpu_light.SAMPLES_PER_PROGRAM,
            num_warps=1,
        )  # fmt: skip
        return out if self._weights is None else gpu_response.blurred(out, self._weights)

    def developed(
        self, radiance: Tensor, random: Sequence[np.random.Generator | None], gains: Sequence["Array | None"]
    ) -> Array:
        """8-bit pictures (F, H, W, 3) of a radiance (F, H, W, 3) by camera_response.develop, each with the noise of its
        generator and the gain (3,) on its colours. The generators stay where they are.

        Raises:
            ValueError: with noise, one is not a PCG64 from which whole outputs were drawn.
        """
        eye = self._sensor.camera
        mixes = [camera_response.mix(eye, gain) for gain in gains]
        drawn = torch.empty((len(radiance), 0), dtype=torch.int16, device=self._device)
        if eye.noise is not None and any(each is not None for each in random):
            drawn = gpu_noise.drawn(on(self._device, gpu_noise.states(random), torch.int64), self._jumps)
        pictures = gpu_response.counted(
            radiance, on(self._device, np.array(mixes), DOUBLE_TYPE), self._fall, self._grain, drawn, self._quantiles,
            self._steps, self._counts,
        )  # fmt: skip
        return np.asarray(pictures.cpu())


def on(device: str, values: Array, dtype: torch.dtype) -> Tensor:
    """An array as a tensor of that type on a device."""
    return torch.as_tensor(np.ascontiguousarray(values), device=device).to(dtype)
