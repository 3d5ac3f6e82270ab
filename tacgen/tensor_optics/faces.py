"""Faces of sheets behind the samples of a picture, many at once, on the tensors' device."""

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from tacgen.optics.camera import PinholeCamera
from tacgen.optics.shadows import BLOCK_SIZES
from tacgen.optics.surface_grid import Sheet
from tacgen.physics import faces, pictures, raster, shadows
from tacgen.physics.raster import EMPTY_SAMPLE_KEY
from tacgen.physics.runtime import launch


class Terrains(NamedTuple):
    """optics.shadows.Terrain of many faces: heights (F, rows columns) [mm], the least of what casts shadows in small
    and large blocks of cells (F, n, m), and of each face the least of all and the box (F, 5)."""

    heights: Tensor
    small: Tensor
    large: Tensor
    extent: Tensor


class SeenFaces(NamedTuple):
    """Faces behind the samples of a picture: unit normals of the nodes (F, n, 3), their places in the image (F, n, 2),
    and the key of the triangle behind each sample (F, h w), see raster.rasterized."""

    facing: Tensor
    screen: Tensor
    keys: Tensor
    terrains: Terrains


class FaceDrawer:
    """A sheet and a camera, for many faces at once."""

    def __init__(self, sheet: Sheet, camera: PinholeCamera, untouched: np.ndarray, device: str) -> None:
        """untouched (rows, columns): heights of the face at rest [mm], as optics.direct_light.heights."""
        if (len(sheet.lines[1]), len(sheet.lines[0])) != sheet.shape:
            raise ValueError("the sheet covers a part of the pad only")
        self._shape, self._grid = camera.shape, sheet.shape
        self._lens, self._layers = (torch.tensor(each, device=device) for each in (camera.lens, camera.layers))
        self.triangles = torch.tensor(sheet.faces.astype(np.int32), device=device)
        self._before = torch.tensor(untouched.reshape(-1), device=device)
        per_mm = (np.array(sheet.shape[::-1]) - 1) / sheet.size
        self._per_mm, self._middle = (torch.tensor(each, device=device) for each in (per_mm, np.array(sheet.size) / 2))

    def draw(self, nodes: Tensor) -> SeenFaces:
        """Faces of nodes (F, n, 3) [mm], double precision."""
        (frames, count, _), (rows, columns) = nodes.shape, self._grid
        screen, facing = nodes.new_empty(frames, count, 2), torch.empty_like(nodes)
        flat = nodes.reshape(-1, 3)
        launch(faces.projected_singly, (len(flat),), flat, self._lens, self._layers, screen.reshape(-1, 2))
        lanes = columns if nodes.is_cuda else 1
        launch(faces.spans, (frames, rows, lanes), flat, rows, columns, lanes, True, facing.reshape(-1, 3))
        level = ((nodes[..., :2] + self._middle) * self._per_mm + 0.5).contiguous()
        return SeenFaces(facing, screen, self._keys(nodes, screen, self._shape), self._terrains(nodes, level))

    def _keys(self, nodes: Tensor, screen: Tensor, shape: tuple[int, int]) -> Tensor:
        frames, count, _ = nodes.shape
        keys = torch.full((frames, math.prod(shape)), EMPTY_SAMPLE_KEY, dtype=torch.int64, device=nodes.device)
        turned = torch.zeros(2 * frames, dtype=torch.int32, device=nodes.device)
        near, places = nodes[..., 2].contiguous().reshape(-1), screen.reshape(-1, 2)  # kernels take no strides
        launch(
            raster.rasterized, (frames * len(self.triangles),), self.triangles, places, near, count, *shape,
            keys.reshape(-1), turned,
        )  # fmt: skip
        return keys

    def _terrains(self, nodes: Tensor, level: Tensor) -> Terrains:
        (rows, columns), frames, keys = self._grid, len(nodes), self._keys(nodes, level, self._grid)
        heights = nodes.new_empty(frames, rows * columns)
        launch(
            pictures.heights, heights.shape, keys, self.triangles, level.reshape(-1, 2), nodes.reshape(-1, 3), columns,
            heights,
        )  # fmt: skip
        return terrains(heights, self._before, self._grid)


def terrains(heights: Tensor, before: Tensor | None, grid: tuple[int, int]) -> Terrains:
    """Terrains of faces of heights (F, rows columns); with their heights `before` (rows columns,), only places that
    have receded since then cast shadows."""
    frames = len(heights)
    small, large = (heights.new_empty(frames, *(-(-(n - 1) // cells) for n in grid)) for cells in BLOCK_SIZES)
    extent, ratio = heights.new_empty(frames, 5), BLOCK_SIZES[1] // BLOCK_SIZES[0]
    launch(shadows.lowest, small.shape, heights.reshape(-1), before, *grid, BLOCK_SIZES[0], 1, small)
    launch(shadows.lowest, large.shape, small.reshape(-1), None, *small.shape[1:], ratio, 0, large)
    launch(shadows.extents, (frames,), small, extent)
    return Terrains(heights, small, large, extent)
