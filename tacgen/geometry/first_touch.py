"""First touch of an indenter with the untouched face of a gel, up to its real outline: beyond it there is no gel."""

from typing import TYPE_CHECKING

import numpy as np

from tacgen.geometry.analytic_sdf import Shape, lowest
from tacgen.geometry.outline import Pad
from tacgen.geometry.pose import Pose

if TYPE_CHECKING:
    from tacgen.geometry.gel import GelBody

Array = np.ndarray
# of grids on the face [mm]: the first on all of it, each next one around the point found
TOUCH_GRIDS_MM = (0.2, 0.01, 0.0005)
APPROACH_GRIDS_MM = (0.5, 0.025, 0.00125)  # the same where distances alone are looked at
MAX_LOWERINGS = 200  # most steps in which a shape is lowered onto a grid
TOUCH_TOL_MM = 1e-6  # distance at which it counts as touching [mm]
MISS_DISTANCE_MM = 1e-3  # distance at the end of all steps above which it passes the gel by [mm]
MAX_GRID_ERROR_MM = 1e-5  # height above the lowest point within the grids' error, which counts as 0 [mm]
OUTLINE_SAG_MM = 1e-3  # of the sides of the polygon that stands for a round outline [mm]


def contact_height(shape: Shape, gel: "GelBody | Pad", pose: Array) -> float:
    """Height of the indenter's origin at first touch of the untouched face, for this rotation and position [mm]; -inf
    if nothing of it is over the gel, inf if it has no lowest point."""
    standing = pose.copy()
    standing[2, 3] = drop = shape.support(-pose[2, :3])  # extent below its own origin
    return drop - _sink_depth(shape, standing, gel) if np.isfinite(drop) else drop


def lowest_over(shape: Shape, gel: "GelBody | Pad", pose: Array) -> float:
    """z of an indenter's lowest point over the gel's outline [mm]; inf if nothing of it is there."""
    flat = Pad(gel.width, gel.height, gel.corner_radius, gel.tip)
    return float(pose[2, 3]) - contact_height(shape, flat, pose)


def closest(shape: Shape, gel: "GelBody", poses: Array) -> float:
    """Smallest distance [mm] of an indenter at the poses (N, 4, 4) from the untouched face; 0 or less if it touches."""
    middle, half = np.zeros(2), np.array([gel.width, gel.height]) / 2
    for step in APPROACH_GRIDS_MM:
        face = face_near(gel, middle, half, step)
        gap = [shape.value(Pose.of(pose).local(face)) for pose in poses]
        nearest = int(np.argmin([distance.min() for distance in gap]))
        poses, at = poses[nearest : nearest + 1], face[int(gap[nearest].argmin())]
        if (least := float(gap[nearest].min())) <= 0:
            break
        middle, half = at[:2], np.array([step, step])
    return least


def face_near(gel: "GelBody | Pad", middle: Array, half: Array, step: float) -> Array:
    """Points (n, 3) of the untouched face on a grid over `middle` (2,) -+ `half` (2,); those beside it are moved to
    its rim."""
    ends = zip(middle - half, middle + half, half, strict=True)
    x, y = np.meshgrid(*(np.linspace(low, high, 2 * round(h / step) + 1) for low, high, h in ends))
    xy = np.column_stack([x.ravel(), y.ravel()])
    if (beside := ~gel.contains(*xy.T)).any():
        size = np.array([gel.width, gel.height]) / 2
        xy[beside] = gel.drawn_in(np.clip(xy[beside], -size, size))
    return np.column_stack([xy, gel.top(*xy.T)])


def _sink_depth(shape: Shape, pose: Array, gel: "GelBody | Pad") -> float:
    """Distance along z from a shape that stands on z = 0 to first touch of the untouched face [mm]; inf without touch.

    Over a flat face it is 0 exactly where the shape's lowest point touches it.
    """
    if not gel.flat:
        return _lowered(shape, pose, gel, TOUCH_GRIDS_MM[:2])
    surface: tuple[Array, Array] | None = getattr(shape, "surface", None)  # of a mesh, see sdf_grid.Field
    if surface is not None:
        sunk = least_over(*surface, gel, pose)
    elif _rests_on(shape, pose, gel):
        return 0.0
    else:
        sunk = _lowered(shape, pose, gel, TOUCH_GRIDS_MM)
    return 0.0 if sunk < MAX_GRID_ERROR_MM else sunk


def _rests_on(shape: Shape, pose: Array, gel: "GelBody | Pad") -> bool:
    """Whether the middle of what a shape stands on at z = 0 is of the shape, and over the gel."""
    with np.errstate(invalid="ignore"):  # a shape without end, that is tilted as far as it may be
        under = (pose[:3, 3] + lowest(shape.support, pose[:3, :3])) * [1.0, 1.0, 0.0]
    return bool(gel.contains(*under[:2]) and abs(shape.value(Pose.of(pose).local(under[None]))[0]) < TOUCH_TOL_MM)


def _lowered(shape: Shape, pose: Array, gel: "GelBody | Pad", steps: tuple[float, ...]) -> float:
    """As `_sink_depth`, on grids. Each iteration lowers the shape by its distance from the face, which cannot
    overshoot; the search is repeated around the point found, on a finer grid."""
    middle, half = np.zeros(2), np.array([gel.width, gel.height]) / 2
    most = shape.support(pose[2, :3]) + shape.support(-pose[2, :3]) - float(gel.top(*half))  # all of it is below then
    lowered, sunk, gap = pose.copy(), 0.0, np.zeros(1)
    for step in steps:
        face = face_near(gel, middle, half, step)
        for _ in range(MAX_LOWERINGS):
            lowered[2, 3] = pose[2, 3] - sunk
            gap = shape.value(Pose.of(lowered).local(face))
            nearest = int(np.argmin(gap))
            sunk += float(gap[nearest])  # on the finer grid this may be slightly negative
            if abs(gap[nearest]) < TOUCH_TOL_MM or sunk > most:
                break
        middle, half = face[nearest, :2], np.array([step, step])
    return np.inf if gap.min() > MISS_DISTANCE_MM or sunk > most else sunk


def least_over(vertices: Array, triangles: Array, pad: Pad, pose: Array) -> float:
    """z of the lowest point of a closed surface over a pad's outline [mm], at a pose (4, 4); inf if none is there.

    It is at a vertex over the pad, over a corner of the outline, or where an edge crosses a side of it.
    """
    x = vertices @ pose[:3, :3].T + pose[:3, 3]
    least = float(x[pad.contains(*x[:, :2].T), 2].min(initial=np.inf))
    if least < x[:, 2].min() + MAX_GRID_ERROR_MM:
        return least
    rim = pad.outline(OUTLINE_SAG_MM)
    a = x[triangles]
    over = (a[..., :2].max(1) >= rim.min(0)) & (a[..., :2].min(1) <= rim.max(0))
    lower = a[(a[..., 2].min(1) < least) & over.all(1)]
    edge, side = np.roll(lower, -1, 1) - lower, np.roll(rim, -1, 0) - rim
    for corner, way in zip(rim, side, strict=True):
        to = corner - lower[..., :2]
        beside = edge[..., 0] * to[..., 1] - edge[..., 1] * to[..., 0]  # of each edge (t, 3), and opposite the next one
        with np.errstate(divide="ignore", invalid="ignore"):  # triangles and edges that stand upright
            weights = beside / beside.sum(1, keepdims=True)
            across = edge[..., 0] * way[1] - edge[..., 1] * way[0]
            along = (to[..., 0] * way[1] - to[..., 1] * way[0]) / across
            at = -beside / across  # part of the side, at the crossing
            corners = (np.roll(weights, -1, 1) * lower[..., 2]).sum(1)[(weights >= 0).all(1)]
            crossings = lower[..., 2] + along * edge[..., 2]
        crosses = (along >= 0) & (along <= 1) & (at >= 0) & (at <= 1)
        least = min(least, corners.min(initial=np.inf), crossings[crosses].min(initial=np.inf))
    return float(least)
