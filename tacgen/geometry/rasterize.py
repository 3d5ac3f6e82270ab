"""Rasterisation of a sheet's triangles: the point of the sheet behind each sample of an image, and points that are
hidden by another part of it."""

import numpy as np
from numpy.typing import NDArray

from tacgen.compiled import njit

Floats = NDArray[np.float64]


@njit(cache=True)
def hits(
    faces: NDArray[np.uint32], screen: Floats, near: Floats, shape: tuple[int, int]
) -> tuple[NDArray[np.int32], Floats, bool]:
    """The triangle behind each sample; of overlapping triangles the one with the smallest `near`.

    Args:
        faces: node numbers, (triangles, 3).
        screen: node positions in samples, (nodes, 2), sample centres at +0.5.
        near: distance of each node from the viewer, (nodes,).
        shape: H, W of the picture.

    Returns:
        Number (H, W) of the triangle, -1 where none lies; weights (H, W, 2) of its second and third node there; and
        whether both sides of triangles show. Only then may triangles that share their edges lie over one another.
    """
    height, width = shape
    triangle, place = np.empty((height, width), np.int32), np.empty((height, width, 2))
    depth, least, most = np.empty((height, width)), 0.0, 0.0
    triangle[:], depth[:] = -1, np.inf
    for t in range(len(faces)):
        a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]  # `= faces[t]` would count references, at twice the time
        ax, ay = screen[a, 0], screen[a, 1]
        bx, by = screen[b, 0], screen[b, 1]
        cx, cy = screen[c, 0], screen[c, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0 or not np.isfinite(area):
            continue
        least, most = min(least, area), max(most, area)
        left = max(0, int(np.ceil(min(ax, bx, cx) - 0.5)))
        right = min(width - 1, int(np.floor(max(ax, bx, cx) - 0.5)))
        top = max(0, int(np.ceil(min(ay, by, cy) - 0.5)))
        bottom = min(height - 1, int(np.floor(max(ay, by, cy) - 0.5)))
        for j in range(top, bottom + 1):
            for i in range(left, right + 1):
                x, y = i + 0.5, j + 0.5
                v = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
                w = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
                u = 1.0 - v - w
                if u < -1e-12 or v < -1e-12 or w < -1e-12:
                    continue
                z = u * near[a] + v * near[b] + w * near[c]
                if z < depth[j, i]:
                    depth[j, i], triangle[j, i] = z, t
                    place[j, i, 0], place[j, i, 1] = v, w
    return triangle, place, least < 0.0 < most


@njit(cache=True)
def blend(faces: NDArray[np.uint32], triangle: NDArray[np.int32], place: Floats, values: Floats) -> Floats:
    """Values (nodes, c) behind each sample (H, W, c) of `hits`, linear on triangles; nan where none lies."""
    height, width = triangle.shape
    out = np.empty((height, width, values.shape[1]))
    out[:] = np.nan  # np.full takes longer to compile
    for j in range(height):
        for i in range(width):
            if triangle[j, i] >= 0:
                t, v, w = triangle[j, i], place[j, i, 0], place[j, i, 1]
                a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
                for k in range(values.shape[1]):
                    out[j, i, k] = (1.0 - v - w) * values[a, k] + v * values[b, k] + w * values[c, k]
    return out


def draw(faces: NDArray[np.uint32], screen: Floats, near: Floats, values: Floats, shape: tuple[int, int]) -> Floats:
    """Both in one: values (nodes, c) behind each sample (H, W, c), nan where no triangle lies."""
    triangle, place, _ = hits(faces, screen, near, shape)
    return np.asarray(blend(faces, triangle, place, values))


@njit(cache=True)
def hidden(
    faces: NDArray[np.uint32],
    screen: Floats,
    depth: Floats,
    at: Floats,
    own: Floats,
    shape: tuple[int, int],
    slack: float,
) -> NDArray[np.bool_]:
    """Whether a triangle crosses the line of sight to each point (n,) by more than `slack` before the point itself.

    Args:
        faces: node numbers, (triangles, 3).
        screen: node positions, (nodes, 2), in pixels.
        depth: distance of each node from the viewer, (nodes,).
        at, own: the points' positions (n, 2) in pixels and distances (n,). One out of the picture, or nan, is not
            hidden.
        shape: H, W of the picture.
        slack: by how much triangles may lie before the face that they stand for, in the unit of `depth`.
    """
    height, width = shape
    out = np.zeros(len(at), np.bool_)
    inside = (at[:, 0] >= 0) & (at[:, 0] < width) & (at[:, 1] >= 0) & (at[:, 1] < height)
    points = np.flatnonzero(inside)
    key = np.floor(at[points, 1]) * width + at[points, 0]  # row by row, and along each row
    order = np.argsort(key)
    points, key = points[order], key[order]
    for t in range(len(faces)):
        a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
        ax, ay = screen[a, 0], screen[a, 1]
        bx, by = screen[b, 0], screen[b, 1]
        cx, cy = screen[c, 0], screen[c, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        left, right = max(min(ax, bx, cx), 0.0), min(max(ax, bx, cx), width - 1e-9)
        if area == 0.0 or not np.isfinite(area) or left > right:
            continue
        nearest = min(depth[a], depth[b], depth[c])
        for row in range(max(0, int(np.floor(min(ay, by, cy)))), min(height, int(np.floor(max(ay, by, cy))) + 1)):
            for i in range(np.searchsorted(key, row * width + left), len(key)):
                if key[i] > row * width + right:
                    break
                p = points[i]
                if out[p] or own[p] - nearest <= slack:
                    continue
                x, y = at[p, 0], at[p, 1]
                v = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
                w = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
                if v >= 0.0 and w >= 0.0 and v + w <= 1.0:
                    z = (1.0 - v - w) * depth[a] + v * depth[b] + w * depth[c]
                    out[p] = own[p] - z > slack
    return out
