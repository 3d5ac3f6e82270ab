"""Signed distances of indenters, with gradient and Hessian: analytic shapes, splines on grids, and their exact edges.

An indenter is a row of `shapes` (s, ROW_NUMBERS) and parts of `values` and `lists`, where all indenters' coefficients
and lists stand one after the other; the row says where. Points are in the indenter's own frame.
"""

import warp as wp

from tacgen.physics.cores import TINY, ShapeNumber, core_of
from tacgen.physics.edges import RADIUS, sharpened
from tacgen.physics.splines import Distance, spline
from tacgen.physics.types import Ints, Matrices2, Reals, Reals2, Vectors2, real


@wp.func
def grown(shapes: Reals2, s: int, p: wp.vec3d, bends: bool) -> Distance:
    """Distance from a core offset outward by its radius; see geometry.analytic_sdf."""
    core, out = core_of(shapes, s, p), Distance()
    v = p - core.closest
    length = wp.length(v)
    if core.depth > real(0.0) or length < TINY:
        out.d = -core.depth - core.radius
        out.n = core.out
        return out
    out.d = length - core.radius
    out.n = v / length
    if bends:
        out.H = (wp.identity(n=3, dtype=real) - core.J - wp.outer(out.n, out.n)) / length
    return out


@wp.func
def signed_distance(shapes: Reals2, values: Reals, lists: Ints, s: int, p: wp.vec3d, bends: bool) -> Distance:
    """Distance at p; its Hessian if `bends`."""
    if int(shapes[s, 0]) != ShapeNumber.field:
        return grown(shapes, s, p, bends)
    out = spline(shapes, values, s, p)
    if shapes[s, RADIUS] > real(0.0):
        out = sharpened(shapes, values, lists, s, p, out)
    return out


@wp.kernel(enable_backward=False, module="tacgen.physics")
def distances(p: Vectors2, shapes: Reals2, values: Reals, lists: Ints, d: Reals2, n: Vectors2, H: Matrices2):
    """Distances d (s, k) from the indenter of each scene, gradients n and Hessians H; those without rows are left."""
    s, k = wp.tid()
    found = signed_distance(shapes, values, lists, s, p[s, k], H.shape[0] > 0)
    d[s, k] = found.d
    if n.shape[0] > 0:
        n[s, k] = found.n
    if H.shape[0] > 0:
        H[s, k] = found.H
