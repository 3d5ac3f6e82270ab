"""Functions of physics.strips and physics.shadows for tests, one call each: connections, blocked ways, horizons."""

import numpy as np
import warp as wp

from tacgen.optics.strip_light import Panels, Slab, shadowing
from tacgen.physics import runtime, shadows, strips
from tacgen.physics.types import real


@wp.kernel(enable_backward=False, module="tests.light_paths")
def connections(slab: wp.array(dtype=wp.vec3d), ends: wp.array(dtype=wp.vec3d), out: wp.array(dtype=wp.vec2d)):
    out[0] = strips.connect(slab, ends[0][0], ends[0][1], ends[0][2], 0)


@wp.kernel(enable_backward=False, module="tests.light_paths")
def blocked(
    slab: wp.array(dtype=wp.vec3d), panels: wp.array(dtype=wp.vec3d), ends: wp.array(dtype=wp.vec3d), image: int,
    ks: wp.array(dtype=real), out: wp.array(dtype=wp.bool),
):  # fmt: skip
    p, source = ends[0], ends[1]
    home, rho = strips.layer_at(slab, source[2]), wp.length(wp.vec2d(source[0] - p[0], source[1] - p[1]))
    ks[0] = strips.arrive(slab, rho, p[2], source[2], home, image).aside * slab[slab.shape[0] - 1][2]
    out[0] = strips.shaded(slab, panels, p, source, home, image, ks[0])


@wp.kernel(enable_backward=False, module="tests.light_paths")
def reflections(cosines: wp.array(dtype=wp.vec3d), alpha: real, out: wp.array(dtype=real)):
    k = wp.tid()
    out[k] = strips.ggx(cosines[k][0], cosines[k][1], cosines[k][2], alpha)


@wp.kernel(enable_backward=False, module="tests.light_paths")
def horizons(
    heights: wp.array(dtype=real), small: wp.array(dtype=real), large: wp.array(dtype=real),
    extent: wp.array(dtype=real), rows: int, columns: int, wide: real, tall: real, ray: wp.array(dtype=real),
    out: wp.array(dtype=real),
):  # fmt: skip
    face = shadows.terrain(extent, 0, rows, columns, wide, tall)
    above, below = wp.vec2d(ray[6], ray[7]), wp.vec2d(ray[8], ray[9])
    out[0] = shadows.horizon(heights, small, large, face, ray[0], ray[1], ray[2], ray[3], ray[4], ray[5], above, below)


def connect(rho, thicknesses, indices):
    """strips.connect through all of the layers."""
    heights = np.cumsum([0.0, *thicknesses])
    slab = Slab(heights[:-1], np.append(heights[1:-1], np.inf), np.array(indices, dtype=float))
    out = np.empty((1, 2))
    runtime.call(connections, (1,), slab.rows, np.array([[rho, heights[-1], heights[0]]]), out)
    return out[0]


def shaded(panels: Panels, p, source, image: int, slab: Slab) -> tuple[bool, float]:
    """strips.shaded, and k of the way."""
    out, k = np.empty(1, np.bool_), np.empty(1)
    runtime.call(blocked, (1,), slab.rows, panels.rows, np.array([p, source]), image, k, out)
    return bool(out[0]), float(k[0])


def ggx(turn, ci: float, co, alpha: float):
    """strips.ggx of arrays (n,)."""
    out = np.empty(len(co))
    runtime.call(reflections, out.shape, np.column_stack([turn, np.full(len(co), ci), co]), alpha, out)
    return out


def horizon(terrain, x, y, z, dx, dy, reach, above, below) -> float:
    """shadows.horizon."""
    out = np.empty(1)
    ray = np.array([x, y, z, dx, dy, reach, *above, *below], dtype=float)
    runtime.call(horizons, (1,), *shadowing(terrain), ray, out)
    return float(out[0])
