"""Pictures of many faces at once, by the light and camera of a sensor, on a GPU, by PyTorch and Warp."""

import copy
import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from tacgen.optics import camera_response, coating
from tacgen.optics.direct_light import Direct
from tacgen.optics.gaussian import weights
from tacgen.optics.interreflection import Glow
from tacgen.physics import pictures, response
from tacgen.physics.runtime import launch
from tacgen.tensor_optics import noise
from tacgen.tensor_optics.faces import FaceDrawer

Array = np.ndarray
SINGLE_TYPE, DOUBLE_TYPE = torch.float32, torch.float64


class Drawing:
    """Pictures as render.images.Renderer makes them by `transport` in a clear gel with a ray a pixel, of many faces in
    some fifteen launches.

    Light is computed for every sample, not interpolated between some. Nothing depends on the order in which a GPU
    works: the same faces, the same bytes.
    """

    def __init__(
        self, direct: Direct, glow: Glow, stray: "Array | None", texture: "Array | None", device: str,
        glare: "Array | None" = None, relief: "Array | None" = None,
    ) -> None:  # fmt: skip
        """stray (3,): radiance of a coating without dots in the stray light; texture (h, w): the coating's pattern;
        glare (H, W, 3): what is added to every picture; relief (2, h, w): slopes of the coating's.

        Raises:
            ValueError: more than one ray a pixel, or a sheet of a part of the pad.
        """
        view, columns, eye = direct.view, direct.columns, direct.sensor.camera
        if view.samples != 1:
            raise ValueError("a picture with one ray a pixel is needed")
        self._sensor, self._device, self._shape = direct.sensor, device, view.camera.shape
        self._sheet, self._faces = direct.sheet, FaceDrawer(direct.sheet, view.camera, direct.untouched, device)

        def double(values: "Array | Sequence[float]") -> Tensor:
            return on(device, values, DOUBLE_TYPE)

        self._rest, self._toward, self._passed = map(double, (direct.sheet.rest, direct.toward, direct.transmission))
        matt, gloss = (double(each.reshape(len(each), -1, 3)) for each in direct.shares())
        coat = self._sensor.coating
        self._light = (
            double(columns.middle), on(device, columns.strip, torch.int32), double(columns.grid),
            on(device, columns.light.reshape(-1), SINGLE_TYPE), columns.light.shape, columns.mirror,
            matt, gloss, float(coat.roughness if coat.specular else 0.0),
        )  # fmt: skip
        self._glow = on(device, glow.terms, SINGLE_TYPE), double(glow.untouched)
        dots = view.markers
        colours = np.zeros((4, 3))
        colours[0], colours[2] = view.change, coating.white(coat)
        colours[1] = 0.0 if stray is None else stray
        colours[3] = dots.albedo if dots else 0.0
        sizes = [] if dots is None else [*dots.spacing_mm, dots.diameter_mm / 2, eye.mm_per_px, *dots.middle_mm]
        counts = None if dots is None else on(device, np.array(dots.row_counts), torch.int32)
        fields = [] if texture is None else [texture]
        fields += [] if relief is None else list(relief)
        grid = fields[0].shape if fields else (0, 0)
        pattern = None if texture is None else double(texture.reshape(-1))
        slopes = (None, None) if relief is None else (double(each.reshape(-1)) for each in relief)
        self._coat = double(colours), counts, double(sizes), pattern, *grid, *slopes
        self._weights = on(device, weights(eye.blur_mm / eye.mm_per_px), SINGLE_TYPE) if eye.blur_mm else None
        self._glare = None if glare is None else on(device, glare, SINGLE_TYPE)
        self._fall, self._grain = double(camera_response.exposed(eye).reshape(-1)), double(camera_response.grain(eye))
        least, counted = camera_response.steps(eye.response)
        self._response = (
            on(device, camera_response.quantiles(), SINGLE_TYPE),
            double(least),
            on(device, counted, torch.uint8),
        )
        height, width = self._shape
        steps = 0 if eye.noise is None else math.ceil(3 * height * width / 4)  # of a generator, for a picture's noise
        self._jumps = torch.as_tensor(noise.jumps(steps).copy(), device=device)

    def radiance(self, nodes: Array, touched: "Array | None" = None) -> Tensor:
        """Linear radiance (F, H, W, 3), before the response, of faces by the positions (F, n, 3) [mm] of the sheet's
        nodes and the share of contact (F, n) there, without which no relief shows."""
        at = on(self._device, nodes, DOUBLE_TYPE)
        faces, (height, width), frames = self._faces.draw(at), self._shape, len(nodes)
        out = torch.empty((frames, height * width, 3), dtype=SINGLE_TYPE, device=self._device)
        share = None if touched is None else on(self._device, touched.reshape(-1), DOUBLE_TYPE)
        launch(
            pictures.light, (frames, height * width), faces.keys, self._faces.triangles, faces.screen.reshape(-1, 2),
            at.reshape(-1, 3), faces.facing.reshape(-1, 3), self._rest, width,
            *(each.reshape(-1) for each in faces.terrains), *self._sheet.shape, *map(float, self._sheet.size),
            self._toward, self._passed, *self._light, *self._glow, *self._coat, share, out,
        )  # fmt: skip
        seen = self._blurred(out).reshape(frames, height, width, 3)
        return seen if self._glare is None else (seen + self._glare).clamp_(min=0)

    def _blurred(self, pictures: Tensor) -> Tensor:
        """Pictures (F, H W, 3) averaged down and across."""
        if self._weights is None:
            return pictures
        height, width = self._shape
        for length, step in ((height, 3 * width), (width, 3)):
            out = torch.empty_like(pictures)
            launch(
                response.averaged, (out.numel(),), pictures.reshape(-1), self._weights, length, step, out.reshape(-1)
            )
            pictures = out
        return pictures

    def developed(
        self, radiance: Tensor, random: Sequence[np.random.Generator | None], gains: Sequence["Array | None"]
    ) -> Array:
        """8-bit pictures (F, H, W, 3) of a radiance (F, H, W, 3) by camera_response.develop, each with the noise of its
        generator and the gain (3,) on its colours. The generators stay where they are.

        Raises:
            ValueError: with noise, one is not a PCG64 from which whole outputs were drawn.
        """
        eye, (frames, height, width, _) = self._sensor.camera, radiance.shape
        mixes, drawn, numbers = np.array([camera_response.mix(eye, gain) for gain in gains]), None, 0
        if eye.noise is not None and any(each is not None for each in random):
            drawn = self._numbers(random)
            numbers = drawn.shape[1]
        out = torch.empty(radiance.shape, dtype=torch.uint8, device=self._device)
        launch(
            response.counted_singly, (frames, height * width), radiance.reshape(-1),
            on(self._device, mixes, DOUBLE_TYPE), self._fall, self._grain, eye.noise.strength if eye.noise else 0.0,
            None if drawn is None else drawn.reshape(-1), numbers, *self._response, out.reshape(-1),
        )  # fmt: skip
        return np.asarray(out.cpu())

    def _numbers(self, random: Sequence[np.random.Generator | None]) -> Tensor:
        """Numbers of the quantiles (F, n) that are the pictures' noise; those of correlated noise the CPU draws."""
        states, eye = noise.states(random), self._sensor.camera
        if eye.noise is None or eye.noise.white:
            return noise.drawn(torch.as_tensor(states.copy(), device=self._device), self._jumps)
        made = [camera_response.drawn(copy.deepcopy(each), *self._shape, eye.noise) for each in random if each]
        return torch.as_tensor(np.array(made).reshape(len(made), -1).view(np.int16), device=self._device)


def on(device: str, values: "Array | Sequence[float]", dtype: torch.dtype) -> Tensor:
    """An array as a tensor of that type on a device."""
    return torch.as_tensor(np.array(values), device=device).to(dtype)
