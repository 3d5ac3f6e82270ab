"""Parts of libuipc's player that need no libuipc: poses in metres and the pad's mesh."""

import numpy as np

from benchmarks.referee.case import PAD_MM, Array, Pose

# Tetrahedra of a box, whose corners are numbered x + 2 y + 4 z.
FIVE = np.array([(0, 3, 5, 6), (1, 0, 3, 5), (2, 0, 3, 6), (4, 0, 5, 6), (7, 3, 5, 6)])


def metres(pose: Pose) -> Array:
    """A pose as a matrix (4, 4) [m]."""
    out = pose.matrix
    out[:3, 3] /= 1000
    return out


def tetrahedra(cell_mm: float) -> tuple[Array, Array]:
    """Points (n, 3) [mm] and tetrahedra (m, 4) of the pad: five a box, mirrored from each box to the next."""
    counts = np.round(np.array(PAD_MM) / cell_mm).astype(int)
    start = -np.array(PAD_MM) * (0.5, 0.5, 1.0)
    nodes = np.stack(np.meshgrid(*(np.arange(n + 1) for n in counts), indexing="ij"), -1).reshape(-1, 3)
    boxes = nodes[(nodes < counts).all(1)][:, None, None]
    corners = (FIVE[..., None] >> np.arange(3)) & 1
    corners = corners ^ (boxes.sum(-1, keepdims=True) % 2 * (1, 0, 0))
    tets = np.ravel_multi_index(tuple(np.moveaxis(boxes + corners, -1, 0)), tuple(counts + 1)).reshape(-1, 4)
    points = start + nodes * (np.array(PAD_MM) / counts)
    turned = np.linalg.det(points[tets[:, 1:]] - points[tets[:, :1]]) < 0
    tets[turned] = tets[turned][:, (0, 1, 3, 2)]
    return points, tets.astype(np.int32)
