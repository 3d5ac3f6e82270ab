"""Gel + contact footprint -> Mesh: a tensor grid of hexes, fine where the scene can touch and growing away."""

from dataclasses import dataclass

import numpy as np

from tacgen.fem.contact import Pose
from tacgen.scene import Gel, Scene

Array = np.ndarray


@dataclass(frozen=True)
class Mesh:
    """Arrays with named patches.

    points (n, 3) [mm]; cells (e, 8) hexes; layer (e,) number of the gel layer of each cell, 0 at the base;
    facets: quads (f, 4) seen from outside, by name: "bonded" (held), "coated" (pressed and photographed).
    """

    points: Array
    cells: Array
    layer: Array
    facets: dict[str, Array]


def graded(start: float, end: float, fine: tuple[float, float], edge: float, growth: float, coarsest: float) -> Array:
    """Coordinates from start to end: at most `edge` apart inside `fine`, the next ones up to `growth` times as long.

    The ends are met exactly by shrinking the intervals on each side a little together; a fine part that ends within
    half an edge of an end is drawn out to it, so that no sliver is left between them.
    """
    low, high = max(start, fine[0]), min(end, fine[1])
    low, high = start if low < start + edge / 2 else low, end if high > end - edge / 2 else high
    middle = np.linspace(low, high, max(1, int(np.ceil((high - low) / edge - 1e-9))) + 1)
    if high <= low:
        middle = np.array([np.clip(low, start, end)])

    def side(length: float) -> Array:
        steps: list[float] = []
        while sum(steps) < length - 1e-9:
            steps.append(min((steps[-1] if steps else edge) * growth, coarsest))
        return np.cumsum(steps) * (length / sum(steps)) if steps else np.zeros(0)

    below, above = middle[0] - side(middle[0] - start)[::-1], middle[-1] + side(end - middle[-1])
    return np.concatenate([below, middle, above])


def heights(gel: Gel, edge: float, growth: float, coarsest: float) -> tuple[Array, Array]:
    """Grid heights z from base to face and the layer of each interval: fine at the face, graded down, and every
    interface is a grid height."""
    z = [0.0]
    layer: list[int] = []
    step = edge
    for number in reversed(range(len(gel.layers))):
        left = gel.layers[number].thickness
        steps: list[float] = []
        while sum(steps) < left - 1e-9:
            steps.append(step)
            step = min(step * growth, coarsest)
        scaled = np.array(steps) * (left / sum(steps))
        step = min(float(scaled[-1]) * growth, coarsest)
        z.extend(z[-1] - np.cumsum(scaled))
        layer.extend([number] * len(steps))
    return np.array(z[::-1]), np.array(layer[::-1], dtype=np.int32)


def build(
    gel: Gel, footprint: tuple[float, float, float, float], edge: float, *, growth: float = 1.7, coarsest: float = 4.0
) -> Mesh:
    """Graded hexes for a gel with a flat base; each column of the grid is squeezed to the height of the face there.

    Args:
        footprint: x0, x1, y0, y1 [mm] of all that the trajectory can touch; its cells are `edge` wide.
        edge: target edge under the contact [mm]. growth: ratio of neighbouring edges outside. coarsest: far away [mm].
    """
    x0, x1, y0, y1 = footprint
    xs = graded(-gel.width / 2, gel.width / 2, (x0, x1), edge, growth, coarsest)
    ys = graded(-gel.height / 2, gel.height / 2, (y0, y1), edge, growth, coarsest)
    zs, layer = heights(gel, 1.1 * edge, 1.1, coarsest / 2)
    shape = len(xs), len(ys), len(zs)
    points = np.stack(np.meshgrid(xs, ys, zs, indexing="ij"), -1).reshape(-1, 3)
    points[:, 2] += gel.top(points[:, 0], points[:, 1]) * (points[:, 2] + gel.thickness) / gel.thickness
    number = np.arange(len(points)).reshape(shape)
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    i, j, k = (n - 1 for n in shape)
    hexes = np.stack([number[a : a + i, b : b + j, c : c + k] for a, b, c in corners], -1)
    centre = (xs[1:] + xs[:-1])[:, None] / 2, (ys[1:] + ys[:-1])[None] / 2
    inside = gel.contains(*centre)  # a column whose centre is outside the outline is left out
    bonded = hexes[inside][:, 0][:, [0, 3, 2, 1]]
    coated = hexes[inside][:, -1][:, [4, 5, 6, 7]]
    cells = hexes[inside].reshape(-1, 8)
    layers = np.tile(layer, int(inside.sum()))
    used, compact = np.unique(cells, return_inverse=True)
    rename = np.full(len(points), -1)
    rename[used] = np.arange(len(used))
    return Mesh(points[used], compact.reshape(-1, 8), layers, {"bonded": rename[bonded], "coated": rename[coated]})


def footprint(scene: Scene) -> tuple[float, float, float, float]:
    """x0, x1, y0, y1 [mm] of all of the untouched face that the indenter overlaps on its path, and half an edge more.

    A rigid body cuts a wider patch out of the untouched face than it touches of a soft one: this is on the safe side.
    """
    gel, step = scene.gel, scene.edge / 3
    x, y = (np.arange(-size / 2, size / 2 + step, step) for size in (gel.width, gel.height))
    grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    face = np.column_stack([grid, gel.top(*grid.T)])
    touched = np.zeros(len(face), bool)
    poses = scene.poses
    if scene.forced is not None:
        poses = poses.copy()
        poses[:, 2, 3] -= scene.forced.allowance
    for matrix in np.unique(poses.reshape(-1, 16), axis=0).reshape(-1, 4, 4):
        rest = ~touched
        touched[rest] = scene.shape.distance(Pose.of(matrix).local(face[rest]))[0] < 0
    where = grid[touched] if touched.any() else scene.start[None, :2, 3]
    low, high = where.min(0) - scene.edge / 2, where.max(0) + scene.edge / 2
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])
