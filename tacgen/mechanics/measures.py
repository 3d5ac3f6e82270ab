"""Formulas of contact and load steps for the arrays of either engine: written with operators and methods that NumPy's
and PyTorch's arrays share, so that each stands once. Points have any leading axes."""

from typing import Any

Rows = Any  # an array of NumPy, or of PyTorch
MIN_STEP_COSINE = 0.9  # cosine between the motions of two steps, above which the second-order prediction is used [-]
MIN_FORCE_SCALE_RATIO = 1e-3  # smallest force scale, over the largest contact force so far [-]
MIN_ENERGY_GAIN = 1e-3  # decrease of the energy over the predicted one, below which a step is halved [-]
ENERGY_ROUNDING = 1e-12  # relative rounding error of the energy [-]
SMALLEST = 1e-300  # divisors are no smaller


def slip(x: Rows, anchor: Rows, normal: Rows) -> Rows:
    """Tangential displacement (..., 3) of points from their anchors [mm]."""
    u = x - anchor
    return u - (u * normal).sum(-1)[..., None] * normal


def onset(before: Rows, ahead: Rows, gap_before: Rows, gap_ahead: Rows) -> Rows:
    """Positions (..., 3), in the indenter's frame, where points that come into contact during a load step first touch.

    `before` and `ahead` are the positions at the start of the step and, predicted, at its end; the gaps there [mm] are
    to the surface of contact. A point touches where the straight line between them meets that surface.
    """
    part = (gap_before / (gap_before - gap_ahead).clip(min=1e-12)).clip(0.0, 1.0)
    part = part * (gap_ahead < 0) + (gap_ahead >= 0)
    return before + part[..., None] * (ahead - before)


def touched(gap: Rows, dhat: Rows, least: Rows, last: Rows) -> Rows:
    """The facets (..., f) on which the indenter acts by gaps (..., f, q), of which the smallest is `least`; if none,
    those on which it acted with normal forces `last` (..., f, q), or the nearest."""
    now, before = (gap < dhat).any(-1), (last > 0).any(-1)
    free, new = ~now.any(-1)[..., None], ~before.any(-1)[..., None]
    return now | free & (before | new & (gap <= least).any(-1))


def dragged(anchor: Rows, x: Rows, normal: Rows, normal_force: Rows, eps: Rows, tol: Rows) -> tuple[Rows, Rows]:
    """Anchors (..., 3) after a load step, moved by the slip beyond eps (...,), and whether points slide; a free point
    is its own anchor. All in one frame.

    The anchor of a sliding point lags by eps; the slip of one that has stopped is still eps, within the tolerance.
    """
    u = slip(x, anchor, normal)
    length, loaded = (u * u).sum(-1) ** 0.5, normal_force > 0
    kept = (eps / length.clip(min=SMALLEST)).clip(max=1.0) * loaded
    return x - kept[..., None] * u, (length > eps + tol) & loaded


def ahead(motion: Rows, before: Rows, touching: Rows) -> Rows:
    """Weight (s,) of the last step's error of the prediction in this one's, for motions (s, f, q, 3) of points: the
    square of how far the indenter continues its last motion, and 0 where it changes its way."""
    both = (touching & (before != 0).any(-1))[..., None]
    pairs = (motion, before), (motion, motion), (before, before)
    along, now, then = ((a * b * both).sum((1, 2, 3)) for a, b in pairs)
    return (along / then.clip(min=SMALLEST)).clip(max=1.0) ** 2 * (along > MIN_STEP_COSINE * (now * then) ** 0.5)


def imbalance(inner: Rows, outer: Rows, held: Rows, scale: Rows) -> tuple[Rows, Rows]:
    """Residual at the free nodes and |indenter + base|, both (s,) over the contact force [-].

    inner, outer (s, n, 3) [N]: forces of the gel's strain, and of the indenter and of inertia; held (s, n, 1) or
    (s, n, 3): bonded; scale (s,): the contact force.
    """
    free = ((inner + outer) * ~held) ** 2
    off = (outer.sum(1) - (inner * held).sum(1)) ** 2
    return free.sum((1, 2)) ** 0.5 / scale, off.sum(1) ** 0.5 / scale


def predicted_change(g: Rows, p: Rows, u: Rows, rest: Rows) -> Rows:
    """Change (s,) of the bulk's energy after a step p (s, n, 3) with the condensed part u (s, k), by its quadratic
    model: g.p + p.Kp/2 = (g.p + p.(g + Kp))/2, where g + Kp is 0 but for the condensed unknowns, where it is `rest`."""
    return ((g * p).sum((1, 2)) + (u * rest).sum(1)) / 2


def lowers(change: Rows, predicted: Rows, energy: Rows, end: Rows, force: Rows) -> Rows:
    """Whether a step lowers the energy by enough of what was predicted, or by no more than rounding: that of the
    `energy` itself, and a `force` times the motion `end` that is small [mm]."""
    rounding = end * force + ENERGY_ROUNDING * abs(energy)
    return (abs(change) <= rounding) | (change / predicted.clip(max=-rounding) >= MIN_ENERGY_GAIN)
