"""Faces of sheets behind the samples of a picture, many in one launch, by Triton; imported only where there is a GPU.

The formulas are those of optics.camera, optics.surface_grid and geometry.rasterize. Of the triangles behind a sample
the nearest wins by an atomic minimum of (depth, number of the triangle), whose result does not depend on their order.
"""

import math
from typing import NamedTuple

import numpy as np
import torch
import triton
import triton.language as tl
from torch import Tensor

from tacgen.geometry.outline import Pad
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.shadows import LARGE_BLOCK_CELLS, MIN_SHADOWING_FALL_MM, SMALL_BLOCK_CELLS
from tacgen.optics.surface_grid import Sheet

FACE_LANES = 128  # of a program
PROJECTION_NEWTON_STEPS = 12  # of Newton's method; it doubles the digits with each, from a start that has two
EMPTY_SAMPLE_KEY = (1 << 63) - 1  # key of a sample behind which no triangle lies
TERRAIN_NUMBERS = 5  # numbers that tell where a face may cast shadows: Terrain.lowest and box


@triton.jit
def _nodes(
    NODES, LENS, SCREEN, LEVEL, FACING, count, rows, columns, LAYERS: tl.constexpr, STEPS: tl.constexpr,
    LANES: tl.constexpr,
):  # fmt: skip
    """Places of nodes (F, n, 3) in the image and on the grid of heights, and unit normals there toward the camera."""
    k = tl.program_id(0) * LANES + tl.arange(0, LANES)
    there, at = k < count, tl.program_id(1).to(tl.int64) * count + k
    px = tl.load(NODES + 3 * at, mask=there, other=0.0)
    py = tl.load(NODES + 3 * at + 1, mask=there, other=0.0)
    pz = tl.load(NODES + 3 * at + 2, mask=there, other=0.0)
    x0, y0, focal, whole = tl.load(LENS), tl.load(LENS + 1), tl.load(LENS + 2), tl.load(LENS + 5)
    dx, dy = px - x0, py - y0
    rho = tl.sqrt(dx * dx + dy * dy)
    left, depth = pz + whole, rho * 0
    for layer in tl.static_range(LAYERS):
        thick, index = tl.load(LENS + 19 + 2 * layer), tl.load(LENS + 20 + 2 * layer)
        depth += tl.maximum(left if layer == LAYERS - 1 else tl.minimum(left, thick), 0.0) / index
        left -= thick
    slope = rho / depth
    for _ in range(STEPS):
        left, travel, rate = pz + whole, rho * 0, rho * 0
        for layer in tl.static_range(LAYERS):
            thick, index = tl.load(LENS + 19 + 2 * layer), tl.load(LENS + 20 + 2 * layer)
            length, square = tl.maximum(left if layer == LAYERS - 1 else tl.minimum(left, thick), 0.0), index * index
            left -= thick
            inverse = 1.0 / (square + (square - 1.0) * slope * slope)
            part = length * tl.sqrt(inverse)
            travel += part * slope
            rate += part * square * inverse
        slope += (rho - travel) / rate
    ratio = tl.where(rho > 0.0, slope / tl.where(rho > 0.0, rho, 1.0), 0.0)
    sx, sy = dx * ratio, dy * ratio
    T = LENS + 6  # the camera's rotation
    down = sx * tl.load(T + 2) + sy * tl.load(T + 5) + tl.load(T + 8)
    u = focal * (sx * tl.load(T) + sy * tl.load(T + 3) + tl.load(T + 6)) / down + tl.load(LENS + 3)
    v = focal * (sx * tl.load(T + 1) + sy * tl.load(T + 4) + tl.load(T + 7)) / down + tl.load(LENS + 4)
    tl.store(SCREEN + 2 * at, u, mask=there)
    tl.store(SCREEN + 2 * at + 1, v, mask=there)
    tl.store(LEVEL + 2 * at, (px + tl.load(LENS + 15)) * tl.load(LENS + 17) + 0.5, mask=there)
    tl.store(LEVEL + 2 * at + 1, (py + tl.load(LENS + 16)) * tl.load(LENS + 18) + 0.5, mask=there)
    i, j = k // columns, k % columns
    above, below = tl.maximum(i - 1, 0), tl.minimum(i + 1, rows - 1)
    before, after = tl.maximum(j - 1, 0), tl.minimum(j + 1, columns - 1)
    first = at - k
    up, low = NODES + 3 * (first + above * columns + j), NODES + 3 * (first + below * columns + j)
    near, far = NODES + 3 * (first + i * columns + before), NODES + 3 * (first + i * columns + after)
    tall, wide = (below - above).to(tl.float64), (after - before).to(tl.float64)
    ax = (tl.load(low, mask=there, other=0.0) - tl.load(up, mask=there, other=0.0)) / tall
    ay = (tl.load(low + 1, mask=there, other=0.0) - tl.load(up + 1, mask=there, other=0.0)) / tall
    az = (tl.load(low + 2, mask=there, other=0.0) - tl.load(up + 2, mask=there, other=0.0)) / tall
    bx = (tl.load(far, mask=there, other=0.0) - tl.load(near, mask=there, other=0.0)) / wide
    by = (tl.load(far + 1, mask=there, other=0.0) - tl.load(near + 1, mask=there, other=0.0)) / wide
    bz = (tl.load(far + 2, mask=there, other=0.0) - tl.load(near + 2, mask=there, other=0.0)) / wide
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    scale = 1.0 / tl.sqrt(nx * nx + ny * ny + nz * nz)
    tl.store(FACING + 3 * at, (nx * scale).to(tl.float32), mask=there)
    tl.store(FACING + 3 * at + 1, (ny * scale).to(tl.float32), mask=there)
    tl.store(FACING + 3 * at + 2, (nz * scale).to(tl.float32), mask=there)


@triton.jit
def placed(t, x, y, FACES, SCREEN):
    """Nodes of triangles t and the weights of their second and third one at places x, y of a picture."""
    a, b, c = tl.load(FACES + 3 * t), tl.load(FACES + 3 * t + 1), tl.load(FACES + 3 * t + 2)
    ax, ay = tl.load(SCREEN + 2 * a), tl.load(SCREEN + 2 * a + 1)
    bx, by = tl.load(SCREEN + 2 * b) - ax, tl.load(SCREEN + 2 * b + 1) - ay
    cx, cy = tl.load(SCREEN + 2 * c) - ax, tl.load(SCREEN + 2 * c + 1) - ay
    scale = 1.0 / (bx * cy - by * cx)
    x, y = x - ax, y - ay
    return a, b, c, (x * cy - y * cx) * scale, (bx * y - by * x) * scale


@triton.jit
def _bound(value, low, high):
    """A place as a whole number from `low` to `high`; 0 of one that is no number."""
    value = tl.where(value == value, value, 0.0)
    return tl.minimum(tl.maximum(value, low * 1.0), high * 1.0).to(tl.int32)


@triton.jit
def _rasterized(FACES, SCREEN, NODES, KEYS, triangles, nodes, height, width, LANES: tl.constexpr):
    """The least key of the triangles behind each sample (F, height width): depth, then number, of those behind it."""
    t, frame = tl.program_id(0) * LANES + tl.arange(0, LANES), tl.program_id(1).to(tl.int64)
    there = t < triangles
    face, S, Z = tl.where(there, t, 0), SCREEN + 2 * frame * nodes, NODES + 3 * frame * nodes + 2
    a, b, c = tl.load(FACES + 3 * face), tl.load(FACES + 3 * face + 1), tl.load(FACES + 3 * face + 2)
    ax, ay = tl.load(S + 2 * a), tl.load(S + 2 * a + 1)
    bx, by = tl.load(S + 2 * b) - ax, tl.load(S + 2 * b + 1) - ay
    cx, cy = tl.load(S + 2 * c) - ax, tl.load(S + 2 * c + 1) - ay
    area = bx * cy - by * cx
    there = there & (area != 0) & (area - area == 0)
    left = _bound(tl.ceil(ax + tl.minimum(tl.minimum(bx, cx), 0.0) - 0.5), 0, width)
    right = _bound(tl.floor(ax + tl.maximum(tl.maximum(bx, cx), 0.0) - 0.5), -1, width - 1)
    top = _bound(tl.ceil(ay + tl.minimum(tl.minimum(by, cy), 0.0) - 0.5), 0, height)
    bottom = _bound(tl.floor(ay + tl.maximum(tl.maximum(by, cy), 0.0) - 0.5), -1, height - 1)
    scale = 1.0 / tl.where(there, area, 1.0)
    bx, by, cx, cy = scale * bx, scale * by, scale * cx, scale * cy
    za, zb, zc = tl.load(Z + 3 * a), tl.load(Z + 3 * b), tl.load(Z + 3 * c)
    rows = tl.max(tl.where(there, bottom - top + 1, 0), 0)
    columns = tl.max(tl.where(there, right - left + 1, 0), 0)
    for down in range(rows):
        j = top + down
        y = j + 0.5 - ay
        for across in range(columns):
            i = left + across
            x = i + 0.5 - ax
            v, w = x * cy - y * cx, bx * y - by * x
            u = 1.0 - v - w
            inside = there & (j <= bottom) & (i <= right) & (u >= -1e-12) & (v >= -1e-12) & (w >= -1e-12)
            bits = (u * za + v * zb + w * zc).to(tl.float32).to(tl.int32, bitcast=True)
            ordered = bits ^ ((bits >> 31) & 0x7FFFFFFF)  # as integers in the order of the numbers
            key = (ordered.to(tl.int64) << 32) | t
            tl.atomic_min(KEYS + frame * height * width + j * width + i, key, mask=inside)


@triton.jit
def _terrain(KEYS, FACES, LEVEL, NODES, BEFORE, HEIGHTS, BLOCKED, nodes, rows, columns, fallen, LANES: tl.constexpr):
    """Heights (F, rows columns) of faces over their grid, 0 beside them, and of what has fallen since `before`, else
    infinite."""
    k, frame = tl.program_id(0) * LANES + tl.arange(0, LANES), tl.program_id(1).to(tl.int64)
    there, at = k < rows * columns, frame * rows * columns + k
    key = tl.load(KEYS + at, mask=there, other=0x7FFFFFFFFFFFFFFF)
    hit = key != 0x7FFFFFFFFFFFFFFF
    t = tl.where(hit, key & 0xFFFFFFFF, 0)
    a, b, c, v, w = placed(t, k % columns + 0.5, k // columns + 0.5, FACES, LEVEL + 2 * frame * nodes)
    Z = NODES + 3 * frame * nodes + 2
    z = (1.0 - v - w) * tl.load(Z + 3 * a) + v * tl.load(Z + 3 * b) + w * tl.load(Z + 3 * c)
    z = tl.where(hit, z, 0.0)
    before = tl.load(BEFORE + k, mask=there, other=0.0)
    tl.store(HEIGHTS + at, z.to(tl.float32), mask=there)
    tl.store(BLOCKED + at, tl.where(z < before - fallen, z, float("inf")).to(tl.float32), mask=there)


@triton.jit
def _extent(SMALL, OUT, rows, columns, CELLS: tl.constexpr, BLOCKS: tl.constexpr):
    """Terrain.lowest and box by the least heights of blocks (F, rows columns) of CELLS x CELLS cells."""
    k, frame = tl.arange(0, BLOCKS), tl.program_id(0).to(tl.int64)
    small = tl.load(SMALL + frame * rows * columns + k, mask=k < rows * columns, other=float("inf"))
    there, i, j = small < float("inf"), k % columns, k // columns
    left, right = tl.min(tl.where(there, i, columns), 0), tl.max(tl.where(there, i + 1, 0), 0)
    top, bottom = tl.min(tl.where(there, j, rows), 0), tl.max(tl.where(there, j + 1, 0), 0)
    far, out = float("inf"), OUT + 5 * frame
    tl.store(out, tl.min(small, 0))
    tl.store(out + 1, tl.where(left > 0, CELLS * left * 1.0, -far))
    tl.store(out + 2, tl.where(right < columns, CELLS * right * 1.0, far))
    tl.store(out + 3, tl.where(top > 0, CELLS * top * 1.0, -far))
    tl.store(out + 4, tl.where(bottom < rows, CELLS * bottom * 1.0, far))


class Terrains(NamedTuple):
    """optics.shadows.Terrain of many faces: heights (F, rows, columns) [mm], the least of what casts shadows in small
    and large blocks of cells, and of each face the least of all and the box (F, 5)."""

    heights: Tensor
    small: Tensor
    large: Tensor
    extent: Tensor


class SeenFaces(NamedTuple):
    """Faces behind the samples of a picture: nodes (F, n, 3) and unit normals there, in single precision; places of the
    nodes in the image (F, n, 2); and the key of the triangle behind each sample (F, h w)."""

    nodes: Tensor
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
        self._shape, self._grid, self._device = camera.shape, sheet.shape, device
        self._layers = len(camera.stack.thicknesses)
        self._lens = torch.tensor(_lens(camera, sheet.pad, sheet.shape), dtype=torch.float64, device=device)
        self.triangles = torch.tensor(sheet.faces.astype(np.int32), device=device)
        self._before = torch.tensor(untouched, dtype=torch.float64, device=device)

    def draw(self, nodes: Tensor) -> SeenFaces:
        """Faces of nodes (F, n, 3) [mm], double precision."""
        frames, count, _ = nodes.shape
        screen, level = (nodes.new_empty(frames, count, 2) for _ in range(2))
        facing = nodes.new_empty(nodes.shape, dtype=torch.float32)
        grid = triton.cdiv(count, FACE_LANES), frames
        _nodes[grid](
            nodes,
            self._lens,
            screen,
            level,
            facing,
            count,
            *self._grid,
            self._layers,
            PROJECTION_NEWTON_STEPS,
            FACE_LANES,
        )
        keys = self._keys(nodes, screen, self._shape)
        return SeenFaces(nodes.float(), facing, screen, keys, self._terrains(nodes, level))

    def _keys(self, nodes: Tensor, screen: Tensor, shape: tuple[int, int]) -> Tensor:
        frames, count, _ = nodes.shape
        keys = torch.full((frames, math.prod(shape)), EMPTY_SAMPLE_KEY, dtype=torch.int64, device=nodes.device)
        grid = triton.cdiv(len(self.triangles), FACE_LANES), frames
        _rasterized[grid](self.triangles, screen, nodes, keys, len(self.triangles), count, *shape, FACE_LANES)
        return keys

    def _terrains(self, nodes: Tensor, level: Tensor) -> Terrains:
        (rows, columns), (frames, count, _) = self._grid, nodes.shape
        keys = self._keys(nodes, level, self._grid)
        heights, blocked = (nodes.new_empty(frames, rows, columns, dtype=torch.float32) for _ in range(2))
        _terrain[triton.cdiv(rows * columns, FACE_LANES), frames](
            keys,
            self.triangles,
            level,
            nodes,
            self._before,
            heights,
            blocked,
            count,
            rows,
            columns,
            MIN_SHADOWING_FALL_MM,
            FACE_LANES,
        )
        small, large = (lowest(blocked, cells) for cells in (SMALL_BLOCK_CELLS, LARGE_BLOCK_CELLS))
        return Terrains(heights, small, large, extents(small))


def lowest(heights: Tensor, cells: int) -> Tensor:
    """Least heights of blocks of cells of grids (F, h, w), as optics.shadows.lowest."""
    most: Tensor = torch.nn.functional.max_pool2d(-heights, cells + 1, cells, ceil_mode=True)
    return -most


def extents(small: Tensor) -> Tensor:
    """Terrain.lowest and box (F, TERRAIN_NUMBERS) by the least heights of small blocks (F, rows, columns)."""
    out = small.new_empty(len(small), TERRAIN_NUMBERS)
    _extent[len(small),](small, out, *small.shape[1:], SMALL_BLOCK_CELLS, triton.next_power_of_2(small[0].numel()))
    return out


def _lens(camera: PinholeCamera, pad: Pad, grid: tuple[int, int]) -> list[float]:
    """A camera and the grid of heights as numbers: pinhole, focal length, axis, thickness of all layers, rotation; half
    of the pad's sides and nodes a mm; thickness and index of each layer."""
    stack, (rows, columns) = camera.stack, grid
    lens = [*camera.center, camera.focal_px, *camera.axis, sum(stack.thicknesses), *camera.turn.ravel()]
    lens += [pad.width / 2, pad.height / 2, (columns - 1) / pad.width, (rows - 1) / pad.height]
    return [*lens, *np.column_stack([stack.thicknesses, stack.indices]).ravel()]
