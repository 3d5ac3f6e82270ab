"""Points of a face that are hidden from the camera by another part of it."""

import numpy as np
from numpy.typing import NDArray

from tacgen.compiled import njit

Floats = NDArray[np.float64]


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
