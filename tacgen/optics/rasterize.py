"""Nodes of a sheet seen from somewhere: which point of the sheet is behind each sample, by drawing its triangles."""

import numpy as np
from numpy.typing import NDArray

from tacgen.compiled import njit

Floats = NDArray[np.float64]


@njit(cache=True)
def draw(faces: NDArray[np.uint32], screen: Floats, near: Floats, values: Floats, shape: tuple[int, int]) -> Floats:
    """Values (H, W, c) interpolated over triangles; where triangles overlap the one of least `near` is kept.

    Args:
        faces: node numbers, (triangles, 3).
        screen: node positions in samples, (nodes, 2), sample centres at +0.5.
        near: distance of each node from the viewer, (nodes,).
        values: what to interpolate, (nodes, c).
        shape: H, W of the picture.

    Returns:
        (H, W, c), nan where no triangle lies.
    """
    height, width = shape
    out = np.full((height, width, values.shape[1]), np.nan)
    depth = np.full((height, width), np.inf)
    for t in range(len(faces)):
        a, b, c = faces[t]
        ax, ay = screen[a]
        bx, by = screen[b]
        cx, cy = screen[c]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0 or not np.isfinite(area):
            continue
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
                    depth[j, i] = z
                    for k in range(values.shape[1]):
                        out[j, i, k] = u * values[a, k] + v * values[b, k] + w * values[c, k]
    return out
