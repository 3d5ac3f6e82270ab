"""Rasterisation of a sheet's triangles: the point of the sheet behind each sample of an image, and points that are
hidden by another part of it. The kernels are those of physics.raster."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tacgen.physics import raster, runtime

Floats = NDArray[np.float64]
Integers = NDArray[np.int32]


def hits(
    faces: Integers, screen: Floats, near: Floats, shape: tuple[int, int]
) -> tuple[NDArray[np.int32], Floats, bool]:
    """The triangle behind each sample; of overlapping triangles the one with the smallest `near`.

    Args:
        faces: node numbers, (triangles, 3).
        screen: node positions in samples, (nodes, 2), sample centres at +0.5.
        near: distance of each node from the viewer, (nodes,), told apart in single precision.
        shape: H, W of the picture.

    Returns:
        Number (H, W) of the triangle, -1 where none lies; weights (H, W, 2) of its second and third node there; and
        whether both sides of triangles show. Only then may triangles that share their edges lie over one another.
    """
    keys, turned = np.full(shape[0] * shape[1], raster.EMPTY_SAMPLE_KEY), np.zeros(2, np.int32)
    triangle, place = np.empty(shape, np.int32), np.empty((*shape, 2))
    runtime.call(raster.rasterized, (len(faces),), faces, screen, near, len(near), *shape, keys, turned)
    runtime.call(raster.placed, keys.shape, keys, faces, screen, shape[1], triangle.reshape(-1), place.reshape(-1, 2))
    return triangle, place, bool(turned.all())


class Hits(NamedTuple):
    """The point of a sheet behind each of n samples."""

    faces: Integers  # node numbers of its triangles, (triangles, 3)
    triangle: Integers  # which one lies there, -1 where none does, (n,)
    place: Floats  # weights of its second and third node, (n, 2)


def blend(hits: Hits, values: Floats, unit: bool = False) -> Floats:
    """Values (nodes, c) at samples (n, c), linear on triangles, nan where none lies; unit: as rows of length 1."""
    out = np.empty((len(hits.triangle), values.shape[1]))
    runtime.call(raster.blended, (len(out),), *hits, values.reshape(-1), values.shape[1], unit, out.reshape(-1))
    return out


def nearest(faces: Integers, screen: Floats, near: Floats, shape: tuple[int, int]) -> Floats:
    """The smallest `near` of the triangles behind each sample (H, W), as in `hits`; nan where none lies."""
    triangle, place, _ = hits(faces, screen, near, shape)
    return blend(Hits(faces, triangle.ravel(), place.reshape(-1, 2)), near[:, None]).reshape(shape)


def hidden(
    faces: Integers, screen: Floats, depth: Floats, at: Floats, own: Floats, shape: tuple[int, int], slack: float
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
    out, (height, width) = np.zeros(len(at), np.bool_), shape
    points = np.flatnonzero(((at >= 0) & (at < (width, height))).all(axis=1))
    cell = np.floor(at[points, 1]) * width + at[points, 0]  # row by row, and along each row
    order = np.argsort(cell)
    points, found = points[order], np.zeros(len(points), np.bool_)
    runtime.call(
        raster.hidden, (len(faces),), faces, screen, depth, at[points], own[points], cell[order], *shape, slack, found
    )
    out[points] = found
    return out
