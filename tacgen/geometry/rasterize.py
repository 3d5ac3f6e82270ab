"""Rasterisation of a sheet's triangles: the point of the sheet behind each sample of an image, and points that are
hidden by another part of it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tacgen.base.compiled import njit

Floats = NDArray[np.float64]


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
    triangle, place, _, both = rasterized(faces, screen, near, shape)
    return triangle, place, both


@njit(cache=True, error_model="numpy")
def rasterized(
    faces: NDArray[np.uint32], screen: Floats, near: Floats, shape: tuple[int, int]
) -> tuple[NDArray[np.int32], Floats, Floats, bool]:
    """`hits`, with the smallest `near` (H, W) of each sample, infinite where no triangle lies, before its last."""
    height, width = shape
    triangle, place = np.empty((height, width), np.int32), np.empty((height, width, 2))
    depth, least, most = np.empty((height, width)), 0.0, 0.0
    triangle[:], depth[:] = -1, np.inf
    for t in range(len(faces)):
        a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]  # `= faces[t]` would count references, at twice the time
        ax, ay = screen[a, 0], screen[a, 1]
        bx, by = screen[b, 0] - ax, screen[b, 1] - ay
        cx, cy = screen[c, 0] - ax, screen[c, 1] - ay
        area = bx * cy - by * cx
        if area == 0.0 or not np.isfinite(area):
            continue
        least, most = min(least, area), max(most, area)
        left = max(0, int(np.ceil(ax + min(0.0, bx, cx) - 0.5)))
        right = min(width - 1, int(np.floor(ax + max(0.0, bx, cx) - 0.5)))
        top = max(0, int(np.ceil(ay + min(0.0, by, cy) - 0.5)))
        bottom = min(height - 1, int(np.floor(ay + max(0.0, by, cy) - 0.5)))
        if left > right or top > bottom:
            continue
        scale = 1.0 / area
        bx, by, cx, cy = scale * bx, scale * by, scale * cx, scale * cy
        za, zb, zc = near[a], near[b], near[c]
        for j in range(top, bottom + 1):
            y = j + 0.5 - ay
            above, below = y * cx, bx * y
            for i in range(left, right + 1):
                x = i + 0.5 - ax
                v, w = x * cy - above, below - by * x
                u = 1.0 - v - w
                if u < -1e-12 or v < -1e-12 or w < -1e-12:
                    continue
                z = u * za + v * zb + w * zc
                if z < depth[j, i]:
                    depth[j, i], triangle[j, i] = z, t
                    place[j, i, 0], place[j, i, 1] = v, w
    return triangle, place, depth, least < 0.0 < most


class Hits(NamedTuple):
    """The point of a sheet behind each of n samples."""

    faces: NDArray[np.uint32]  # node numbers of its triangles, (triangles, 3)
    triangle: NDArray[np.int32]  # which one lies there, -1 where none does, (n,)
    place: Floats  # weights of its second and third node, (n, 2)


@njit(cache=True)
def blend(hits: Hits, values: Floats) -> Floats:
    """Values (nodes, c) at samples (n, c), linear on triangles; nan where none lies."""
    faces, triangle, place = hits
    out = np.empty((len(triangle), values.shape[1]))
    for i in range(len(out)):
        t, v, w = triangle[i], place[i, 0], place[i, 1]
        for k in range(out.shape[1]):
            if t < 0:
                out[i, k] = np.nan
            else:
                a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
                out[i, k] = (1.0 - v - w) * values[a, k] + v * values[b, k] + w * values[c, k]
    return out


@njit(cache=False)
def point(hits: Hits, values: Floats, i: int) -> tuple[float, float, float]:
    """The three values (nodes, 3) at sample `i`, as in `blend`."""
    t, v, w = hits.triangle[i], hits.place[i, 0], hits.place[i, 1]
    if t < 0:
        return np.nan, np.nan, np.nan
    a, b, c, u = hits.faces[t, 0], hits.faces[t, 1], hits.faces[t, 2], 1.0 - v - w
    x = u * values[a, 0] + v * values[b, 0] + w * values[c, 0]
    y = u * values[a, 1] + v * values[b, 1] + w * values[c, 1]
    return x, y, u * values[a, 2] + v * values[b, 2] + w * values[c, 2]


@njit(cache=True, error_model="numpy")
def seen(hits: Hits, facing: Floats, rest: Floats) -> tuple[Floats, Floats]:
    """Normals (n, 3) of length 1 and rest positions (n, 2) at samples, of those at nodes (nodes, 3) and (nodes, 2), in
    one pass of `blend`."""
    faces, triangle, place = hits
    normal, at_rest = np.empty((len(triangle), 3)), np.empty((len(triangle), 2))
    for i in range(len(triangle)):
        t, v, w = triangle[i], place[i, 0], place[i, 1]
        if t < 0:
            normal[i], at_rest[i] = np.nan, np.nan
            continue
        a, b, c, u = faces[t, 0], faces[t, 1], faces[t, 2], 1.0 - v - w
        for k in range(2):
            at_rest[i, k] = u * rest[a, k] + v * rest[b, k] + w * rest[c, k]
        for k in range(3):
            normal[i, k] = u * facing[a, k] + v * facing[b, k] + w * facing[c, k]
        scale = 1.0 / np.sqrt(normal[i, 0] ** 2 + normal[i, 1] ** 2 + normal[i, 2] ** 2)
        for k in range(3):
            normal[i, k] *= scale
    return normal, at_rest


def nearest(faces: NDArray[np.uint32], screen: Floats, near: Floats, shape: tuple[int, int]) -> Floats:
    """The smallest `near` of the triangles behind each sample (H, W), as in `hits`; nan where none lies."""
    depth = np.asarray(rasterized(faces, screen, near, shape)[2])
    depth[np.isinf(depth)] = np.nan
    return depth


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
