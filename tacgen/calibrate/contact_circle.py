"""The contact circle of a ball pressed into a flat gel, found in the photograph.

The slope of the face rises with the radius, as the ball's does, up to the rim of the contact, and falls beyond it (on
Hertz's half-space with an infinite rate at the rim): the change of colour along a radius bends most there. A circle
drawn by eye follows the outer edge of the colours, a tenth and more of the radius further out, where the face has left
the ball already.
"""

from dataclasses import replace

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.optimize import minimize

from tacgen.calibrate.photos import PhotographedPress

Array = np.ndarray
BEND_WIDTH = 0.08  # contact radii: standard deviation of the Gaussian whose second derivative measures the bend
BEND_OFFSETS = np.linspace(-3, 3, 17)  # WIDTHs inward and outward
RADIUS_STARTS = np.arange(0.76, 1.1, 0.04)  # start values of the radius, over the given one
# largest shift of the centre and range of the radius, over the given radius
MAX_CENTRE_SHIFT, MIN_CIRCLE_RATIO, MAX_CIRCLE_RATIO = 0.15, 0.75, 1.1
CIRCLE_POINTS = 72  # points on the circle
MIN_SEEN = 0.9  # share of the second derivative's weight on pixels that are seen; points with less are skipped
CLEAR_RAY_RADII = 1.2  # over the given radius: points whose ray leaves the picture before this are skipped


def refined(press: PhotographedPress, untouched: Array, hidden: Array | None = None) -> PhotographedPress:
    """The press with a refined circle, on which the change against the untouched picture (H, W, 3) bends most, where
    it is not `hidden` (H, W)."""
    if press.contact is None:
        return press
    change, given = press.picture.astype(float) - untouched, press.contact
    seen = np.ones(change.shape[:2]) if hidden is None else (~hidden).astype(float)
    angles = 2 * np.pi * np.arange(CIRCLE_POINTS) / CIRCLE_POINTS
    start, width = np.array([*press.center, given]), BEND_WIDTH * given
    around = np.column_stack([np.cos(angles), np.sin(angles) / press.aspect])
    far = np.array(press.center) + CLEAR_RAY_RADII * given * around
    angles = angles[((far > 0) & (far < untouched.shape[1::-1])).all(axis=1)]
    if len(angles) < CIRCLE_POINTS / 2:
        return press

    def loss(circle: Array) -> float:
        return -bend(change, circle, width, angles, seen, press.aspect)

    first = start * [1, 1, min(RADIUS_STARTS, key=lambda share: loss(start * [1, 1, share]))]
    shift = [-MAX_CENTRE_SHIFT, MAX_CENTRE_SHIFT]
    bounds = start[:, None] + given * np.array([shift, shift, [MIN_CIRCLE_RATIO - 1, MAX_CIRCLE_RATIO - 1]])
    simplex = np.clip(first + np.vstack([np.zeros(3), width * np.eye(3)]), *bounds.T)
    how = {"initial_simplex": simplex, "xatol": 0.02, "fatol": 1e-3}
    x, y, contact = minimize(loss, first, method="Nelder-Mead", bounds=bounds, options=how).x
    return replace(press, center=(float(x), float(y)), contact=float(contact))


def bend(change: Array, circle: Array, width: float, angles: Array, seen: Array, aspect: float = 1.0) -> float:
    """Curvature of a change (H, W, 3) [counts] along the radius at angles (n,) of a circle (x, y, r) [px]: magnitude of
    the second derivative, averaged over the colours, at the scale of a Gaussian of `width` [px], from pixels `seen`
    (H, W); radius and width are in pixel widths, and `aspect` is a pixel's height over that."""
    radii = circle[2] + width * BEND_OFFSETS[:, None]
    at = [circle[1] + radii * np.sin(angles) / aspect - 0.5, circle[0] + radii * np.cos(angles) - 0.5]
    around = np.stack([map_coordinates(change[..., c], at, order=1, mode="nearest") for c in range(3)], axis=2)
    weight = ((BEND_OFFSETS**2 - 1) * np.exp(-(BEND_OFFSETS**2) / 2))[:, None]
    even = weight - weight.mean()  # blind to a constant
    shown = map_coordinates(seen, at, order=1, mode="nearest")
    there = (np.abs(even) * shown).sum(axis=0) >= MIN_SEEN * np.abs(even).sum()
    if not there.any():
        return 0.0
    shown = shown[:, there]
    used = shown * (weight - (shown * weight).sum(axis=0) / shown.sum(axis=0))
    used *= np.linalg.norm(even) / np.linalg.norm(used, axis=0)  # as sensitive to noise as if all were seen
    curvature = np.einsum("ra,rac->ac", used, around[:, there])
    return float(np.linalg.norm(curvature, axis=1).mean())
