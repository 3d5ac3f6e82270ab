"""Faces of sheets behind a pinhole camera and flat clear layers, as Warp functions and kernels: projection, normals.

A ray keeps k = n sin(theta) through the layers (Snell). With x = tan(theta) in the air, its lateral travel in a layer
of thickness t is t x / sqrt(n^2 + (n^2 - 1) x^2): concave in x for every n >= 1. Beyond the face the last layer goes
on.
"""

import warp as wp

from tacgen.physics.flat import get, put
from tacgen.physics.types import Pairs, Reals, Vectors, real

MAX_NEWTON_STEPS = 50  # of the ray to a point; three or four are usual
MAX_NEWTON_CHANGE = 1e-8  # of 1 + x, after which x is exact: what remains is of the order of its square [-]
CHANGE = wp.constant(real(MAX_NEWTON_CHANGE))
POINTS_PER_THREAD = 16  # that a core projects together


@wp.struct
class Lens:
    """A pinhole camera: its place, all layers' thickness [mm], focal lengths and axis [px], and its rotation."""

    x: real
    y: real
    whole: real
    focal: wp.vec2d
    axis: wp.vec2d
    turn: wp.mat33d


@wp.func
def lens_of(numbers: Reals) -> Lens:
    """A camera by its numbers (16,), in the order of `Lens`."""
    lens = Lens()
    lens.x = numbers[0]
    lens.y = numbers[1]
    lens.whole = numbers[2]
    lens.focal = wp.vec2d(numbers[3], numbers[4])
    lens.axis = wp.vec2d(numbers[5], numbers[6])
    for i in range(3):
        for j in range(3):
            lens.turn[i, j] = numbers[7 + 3 * i + j]
    return lens


def _projected(lanes: int) -> wp.Kernel:
    """The kernel with so many points by each thread: on a core the loops over them are vectors."""
    Lanes = wp.types.vector(length=lanes, dtype=real)

    @wp.kernel(enable_backward=False, module="tacgen.optics")
    def projected(points: Vectors, numbers: Reals, layers: Pairs, out: Pairs):
        """Places (n,) of points [mm] in a picture [px], pixel centres at +0.5; nan at or behind the pinhole.

        layers: thickness [mm] and index of each. Newton's method on the lateral travel, which is increasing and concave
        in x: from a start at or below the root, such as the paraxial slope, it converges monotonically without a
        safeguard.
        """
        lens = lens_of(numbers)
        start, last = wp.tid() * lanes, layers.shape[0] - 1
        dx, dy, height, rho, x, left = Lanes(), Lanes(), Lanes(), Lanes(), Lanes(), Lanes()
        depth, travel, rate, moving = Lanes(), Lanes(), Lanes(), Lanes()
        i = int(0)
        while i < lanes:
            p = get(points, wp.min(start + i, points.shape[0] - 1))
            dx[i] = p[0] - lens.x
            dy[i] = p[1] - lens.y
            height[i] = p[2] + lens.whole
            i += 1
        i = int(0)
        while i < lanes:
            rho[i] = wp.sqrt(dx[i] * dx[i] + dy[i] * dy[i])
            left[i] = height[i]
            i += 1
        for k in range(last + 1):
            thick, index = wp.where(k == last, real(wp.inf), layers[k][0]), layers[k][1]
            i = int(0)
            while i < lanes:
                depth[i] = depth[i] + wp.max(wp.min(left[i], thick), real(0.0)) / index
                left[i] = left[i] - thick
                i += 1
        i = int(0)
        while i < lanes:
            x[i] = wp.where(depth[i] > real(0.0), rho[i] / depth[i], real(wp.nan))
            moving[i] = real(1.0)
            i += 1
        for _ in range(MAX_NEWTON_STEPS):
            i = int(0)
            while i < lanes:
                left[i] = height[i]
                travel[i] = real(0.0)
                rate[i] = real(0.0)
                i += 1
            for k in range(last + 1):
                thick, square = wp.where(k == last, real(wp.inf), layers[k][0]), layers[k][1] * layers[k][1]
                i = int(0)
                while i < lanes:
                    inverse = real(1.0) / (square + (square - real(1.0)) * x[i] * x[i])
                    part = wp.max(wp.min(left[i], thick), real(0.0)) * wp.sqrt(inverse)
                    left[i] = left[i] - thick
                    travel[i] = travel[i] + part * x[i]
                    rate[i] = rate[i] + part * square * inverse
                    i += 1
            left_over = real(0.0)
            i = int(0)
            while i < lanes:
                step = (rho[i] - travel[i]) / rate[i]
                x[i] = x[i] + moving[i] * step
                moving[i] = wp.where(wp.abs(step) > CHANGE * (real(1.0) + x[i]), moving[i], real(0.0))
                left_over += moving[i]
                i += 1
            if left_over == real(0.0):
                break
        i = int(0)
        while i < lanes and start + i < points.shape[0]:
            ratio = wp.where(rho[i] > real(0.0), x[i] / rho[i], x[i] * real(0.0))
            seen = wp.vec3d(dx[i] * ratio, dy[i] * ratio, real(1.0)) * lens.turn
            across, down = lens.focal[0] * seen[0] / seen[2], lens.focal[1] * seen[1] / seen[2]
            put(out, start + i, wp.vec2d(across + lens.axis[0], down + lens.axis[1]))
            i += 1

    return projected


projected, projected_singly = _projected(POINTS_PER_THREAD), _projected(1)  # for a core and for a GPU


@wp.kernel(enable_backward=False, module="tacgen.optics")
def spans(at: Vectors, rows: int, columns: int, step: int, unit: bool, out: Vectors):
    """Products (f rows columns,) of the differences down and across grids of nodes, central and at an edge one-sided:
    normals toward the camera as long as the area per node [mm^2], or of length 1. `step` threads do a row."""
    f, i, before = wp.tid()
    start = (f * rows + i) * columns
    above, below = (f * rows + wp.max(i - 1, 0)) * columns, (f * rows + wp.min(i + 1, rows - 1)) * columns
    tall = real(1.0) / real((below - above) / columns)
    for j in range(before, columns, step):
        left, right = wp.max(j - 1, 0), wp.min(j + 1, columns - 1)
        down, across = (
            (get(at, below + j) - get(at, above + j)) * tall,
            (get(at, start + right) - get(at, start + left)) / real(right - left),
        )
        span = wp.cross(down, across)
        put(out, start + j, wp.where(unit, span / wp.length(span), span))
