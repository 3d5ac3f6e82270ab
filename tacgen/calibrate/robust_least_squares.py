"""Robust least squares of pixels that are nearly linear in a few parameters and linear in the radiances, with a ridge.

The equations of pixels for the radiances l, and their derivatives by the parameters u, are tables; the residual is

    r(u, l) = (A + sum_j (u_j - u0_j) S_j) (l, -1)

Soft-l1 loss of the pixels by iteratively reweighted Gauss-Newton steps within bounds; the ridge is quadratic.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

Array = np.ndarray
MAX_GAUSS_NEWTON_STEPS = 12  # Gauss-Newton steps at most
SETTLED_STEP = 2e-3  # largest change in the last step: of half a range, or of what a radiance may change by
STEP_FRACTIONS = (1.0, 0.5, 0.25)  # of a step that are tried until the loss falls


@dataclass(frozen=True)
class LinearModel:
    """Equations A (n, m + 1), the last column the photographs, and their derivatives S (parameters, n, m + 1)."""

    at: Array  # u0, where they were taken (parameters,)
    rows: Array
    slopes: Array


@dataclass(frozen=True)
class Ridge:
    """Penalty that holds parameters near 0 and radiances near the file's.

    `weight` is the residual [counts] of an unknown that is off by 1 in u, or by `scale` (m,) from `own` (m,).
    """

    weight: float
    own: Array
    scale: Array


def loss(residual: Array, u: Array, lights: Array, ridge: Ridge, soft: float) -> float:
    """Soft-l1 loss of residuals, sum of 2 soft^2 (sqrt(1 + (r / soft)^2) - 1), and the ridge's quadratic one."""
    pixels = (2 * soft**2 * (np.sqrt(1 + (residual / soft) ** 2) - 1)).sum()
    return float(pixels + ridge.weight**2 * ((u**2).sum() + (((lights - ridge.own) / ridge.scale) ** 2).sum()))


def minimise(
    tables: LinearModel, lights: Array, bounds: tuple[Array, Array], ridge: Ridge, soft: float
) -> tuple[Array, Array]:
    """Parameters u (parameters,) within bounds, and radiances (m,) >= 0 that minimise the loss of the linear tables.

    Args:
        lights: radiances to start from (m,).
        bounds: least and largest u.
        ridge: see Ridge.
        soft: residual [counts] from which the loss grows linearly.
    """
    free = len(tables.at)
    least = np.concatenate([bounds[0], np.zeros(len(lights))])
    most = np.concatenate([bounds[1], np.full(len(lights), np.inf)])
    aim = np.concatenate([np.zeros(free), ridge.own / ridge.scale])
    x = np.concatenate([tables.at, np.maximum(lights, 0.0) / ridge.scale])

    def table(x: Array) -> Array:
        return np.asarray(tables.rows + np.tensordot(x[:free] - tables.at, tables.slopes, 1))

    def cost(off: Array, x: Array) -> float:
        return loss(off, x[:free], x[free:] * ridge.scale, ridge, soft)

    def left(x: Array, here: Array) -> Array:
        return np.asarray(here @ np.append(x[free:] * ridge.scale, -1.0))

    here = table(x)
    off = left(x, here)
    now = cost(off, x)
    for _ in range(MAX_GAUSS_NEWTON_STEPS):
        moved = tables.slopes @ np.append(x[free:] * ridge.scale, -1.0)
        slope = np.column_stack([moved.T, here[:, :-1] * ridge.scale])
        weighed = slope / np.sqrt(1 + (off / soft) ** 2)[:, None]
        square = weighed.T @ slope + ridge.weight**2 * np.eye(len(x))
        falls = weighed.T @ off + ridge.weight**2 * (x - aim)
        root = np.linalg.cholesky(square)
        within = (np.minimum(least - x, -1e-12), np.maximum(most - x, 1e-12))
        step = lsq_linear(root.T, -np.linalg.solve(root, falls), within, method="bvls").x
        for share in STEP_FRACTIONS:
            tried = np.clip(x + share * step, least, most)
            here = table(tried)
            off = left(tried, here)
            if (then := cost(off, tried)) < now:
                break
        else:
            break
        x, now = tried, then
        if np.abs(share * step).max() < SETTLED_STEP:
            break
    return x[:free], x[free:] * ridge.scale
