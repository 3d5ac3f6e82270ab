"""The rigid body and the mesh of CalculiX's player."""

from typing import Any

import numpy as np

from benchmarks import calculix
from benchmarks.referee.case import PAD_MM, Array, Case, Shape
from benchmarks.reference_runs import row_of
from tacgen.geometry import surface_nets
from tacgen.geometry.gel import GelBody
from tacgen.mechanics import mesh
from tacgen.recipe import scene_of_row

SAG_MM, FACET_MM = 0.003, 0.4  # distance of the body's facets from the shape, and their longest edge
MAX_HEIGHT_MM = 0.3  # parts of the body that stay higher above the untouched face never touch it

# Steps of the mesh [mm] under each shape, up to a distance from its middle, along x and along y: small where the rim of
# the contact is, which for punch and ring is round.
STEPS: dict[Shape, tuple[tuple[tuple[float, float], ...], ...]] = {
    "ball": (((2.4, 0.5),), ((2.4, 0.5),)),
    "punch": (((1.9, 0.65), (3.3, 0.24)), ((1.9, 0.65), (3.3, 0.24))),
    "edge": (((0.4, 0.2), (1.3, 0.3)), ((3.0, 1.0), (4.3, 0.33))),
    "ring": (((1.6, 0.55), (4.0, 0.4)), ((1.6, 0.55), (4.0, 0.4))),
}
FIRST_LAYER = {"ball": 0.5, "punch": 0.24, "edge": 0.25, "ring": 0.4}  # height of the elements under the face [mm]


def body(case: Case, planes: calculix.Symmetry) -> calculix.Body:
    """The part of the case's shape that can touch the part of the gel that is solved. Facets are as much outside of the
    shape as inside."""
    import trimesh

    shape = scene_of_row.build(row_of(case.recipe)).shape
    made = surface_nets.of_shape(shape, half=5.0, height=2.0, tolerance=SAG_MM)
    split: Any = trimesh.remesh.subdivide_to_size  # without types
    vertices, triangles = split(made.vertices, made.triangles, FACET_MM)
    whole = trimesh.Trimesh(vertices, triangles)
    d, normals = shape.gradient(whole.vertices)
    vertices = whole.vertices - d[:, None] * normals
    corners = vertices[whole.faces]
    lowest = np.min([corners @ pose.matrix[2, :3] + pose.z for pose in case.poses], 0).min(1)
    kept = (lowest < MAX_HEIGHT_MM) & (normals[whole.faces][..., 2] < 0.3).all(1)
    for axis, name in enumerate("xy"):
        if name in planes:
            kept &= corners[..., axis].max(1) > -FACET_MM
    sag = np.where(kept, 0.75 * shape.value(corners.mean(1)), 0.0)
    count = np.bincount(whole.faces.ravel(), np.repeat(kept, 3), len(vertices))
    out = -np.bincount(whole.faces.ravel(), np.repeat(sag, 3), len(vertices)) / np.maximum(count, 1)
    used, number = np.unique(whole.faces[kept], return_inverse=True)
    return calculix.Body((vertices + out[:, None] * normals)[used], number.reshape(-1, 3), normals[used])


def _axis(steps: tuple[tuple[float, float], ...], scale: float, end: float, slid: float = 0.0) -> Array:
    """Coordinates from 0 to `end` with these steps, times `scale`; beyond them the steps grow. The last part is longer
    by the way `slid`."""
    at = [0.0]
    for number, (to, step) in enumerate(steps):
        stop = to + (slid if number == len(steps) - 1 else 0.0)
        count = max(round((stop - at[-1]) / (scale * step)), 1)
        at += list(np.linspace(at[-1], stop, count + 1)[1:])
    size, left = at[-1] - at[-2], end - at[-1]
    count = next(n for n in range(1, 99) if sum(min(size * 1.7**k, 4.0) for k in range(1, n + 1)) > 0.85 * left)
    grown = np.cumsum([min(size * 1.7**k, 4.0) for k in range(1, count + 1)])
    return np.array([*at, *(at[-1] + left * grown / grown[-1])])


def axes(case: Case, pad: GelBody, planes: calculix.Symmetry, scale: float) -> tuple[Array, Array, Array]:
    """The mesh's coordinates [mm]."""
    x, y = STEPS[case.shape]
    slid = max(pose.x for pose in case.poses)
    xs, ys = _axis(x, scale, PAD_MM[0] / 2, slid), _axis(y, scale, PAD_MM[1] / 2)
    if planes == "y":
        xs = np.concatenate([-_axis(x, scale, PAD_MM[0] / 2)[:0:-1], xs])
    if planes == "x":
        ys = np.concatenate([-ys[:0:-1], ys])
    zs, _ = mesh.heights(pad, scale * FIRST_LAYER[case.shape], 1.5, 1.6)
    return xs, ys, zs
