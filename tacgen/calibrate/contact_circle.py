"""The contact circle of a ball pressed into a flat gel, found in the photograph.

Centre: where the dent of a ball, lit by each lamp of the sensor file alone, explains the change of the picture best,
the radiances being free in each colour; another unit's file serves as well. On rendered presses of solved faces it is
found within 0.8 px, beside dots as without them; where the change of colour bends most on a free circle, within 1.5 px
without dots and 2.7 px beside them.

Radius: the slope of the face rises with the radius, as the ball's does, up to the rim of the contact, and falls beyond
it (on Hertz's half-space with an infinite rate at the rim): the change of colour along a radius bends most there. A
circle drawn by eye follows the outer edge of the colours, a tenth and more of the radius further out, where the face
has left the ball already.
"""

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.optimize import least_squares

from tacgen.calibrate import solved_presses
from tacgen.calibrate.photos import PhotographedPress
from tacgen.optics import camera_response
from tacgen.render.images import Renderer
from tacgen.sensor.imperfections import COATING_PATTERN_FIELDS
from tacgen.sensor.model import LitSensor

Array = np.ndarray
BEND_WIDTH = 0.06  # contact radii: standard deviation of the Gaussian whose second derivative measures the bend
BEND_OFFSETS = np.linspace(-3, 3, 17)  # WIDTHs inward and outward
# radii that are tried: over that of the dent which explains the change best, a few hundredths more than the contact's
RADIUS_RATIOS = np.arange(0.85, 1.1, 0.01)
# largest shift of the centre and range of the radius, over the given radius
MAX_CENTRE_SHIFT, MIN_CIRCLE_RATIO, MAX_CIRCLE_RATIO = 0.25, 0.7, 1.15
COMPARED_REACH = 1.35  # given radii within which changes are compared: the whole rim tells the centre
CENTRE_STEP = 0.025  # given radii: step of the difference quotients, about a pixel
CENTRE_EVALUATIONS = 8  # dents at most, beside those for the derivatives
CENTRE_BLUR_PX = 1.5  # standard deviation of the Gaussian by which both changes are smoothed, for noise and grain [px]
CENTRE_SPP = 16  # samples a pixel
CIRCLE_POINTS = 72  # points on the circle
MIN_SEEN = 0.9  # share of the second derivative's weight on pixels that are seen; points with less are skipped
CLEAR_RAY_RADII = 1.2  # over the given radius: points whose ray leaves the picture before this are skipped


class LampChanges:
    """Changes of the picture in dents by each lamp of a sensor file alone, on an even coating."""

    def __init__(self, sensor: LitSensor) -> None:
        self.sensor = sensor
        eye = sensor.camera.model_copy(update={"ambient": (0.0, 0.0, 0.0), "glare": None, "auto_exposure": 0.0})
        coat = sensor.coating.model_copy(update=dict.fromkeys(COATING_PATTERN_FIELDS))
        alone = [sensor.model_copy(update={"camera": eye, "coating": coat, "leds": (led,)}) for led in sensor.leds]
        self._renderers = [Renderer(one, CENTRE_SPP, 0, markers=False) for one in alone]
        self._flat = [one.flat() for one in self._renderers]

    def under(self, press: PhotographedPress) -> list[Array]:
        """Change of light (H, W, 3) by each lamp, smoothed."""
        face = solved_presses.face(self.sensor, press, {})
        return [smoothed(one.image(face) - flat) for one, flat in zip(self._renderers, self._flat, strict=True)]

    def centred(self, press: PhotographedPress, untouched: Array, seen: Array) -> PhotographedPress:
        """The press with the circle of the dent that explains the change of its pixels `seen` (H, W) bool best."""
        (x, y), given, eye = press.center, press.contact or 0.0, self.sensor.camera
        before, after = (camera_response.linear(np.clip(one / 255.0, 0, 1), eye) for one in (untouched, press.picture))
        rows, columns = np.mgrid[: seen.shape[0], : seen.shape[1]] + 0.5
        where = seen & (np.hypot(columns - x, (rows - y) * press.aspect) < COMPARED_REACH * given)
        wanted = smoothed(after - before)[where]

        def moved(by: Array) -> PhotographedPress:
            right, down, larger = by
            center = float(x + (right - 1) * given), float(y + (down - 1) * given / press.aspect)
            return replace(press, center=center, contact=float(larger * given))

        def off(by: Array) -> Array:
            lit = [one[where] for one in self.under(moved(by))]
            tables = [np.column_stack([one[:, c] for one in lit]) for c in range(3)]
            left = [table @ np.linalg.lstsq(table, wanted[:, c], rcond=None)[0] - wanted[:, c]
                    for c, table in enumerate(tables)]  # fmt: skip
            return np.concatenate(left) * 255

        low, high = 1 - MAX_CENTRE_SHIFT, 1 + MAX_CENTRE_SHIFT
        bounds = [low, low, MIN_CIRCLE_RATIO], [high, high, MAX_CIRCLE_RATIO]
        start = np.array([1.0, 1.0, 0.9])  # circles drawn by eye are too large
        how = {"diff_step": CENTRE_STEP, "xtol": 1e-3, "ftol": 1e-3, "max_nfev": CENTRE_EVALUATIONS}
        return moved(least_squares(off, start, bounds=bounds, **how).x)


def smoothed(light: Array) -> Array:
    """A change (H, W, 3), smoothed."""
    return np.asarray(gaussian_filter(np.asarray(light, float), (CENTRE_BLUR_PX, CENTRE_BLUR_PX, 0)))


def refined(
    press: PhotographedPress, untouched: Array, lamps: LampChanges, hidden: Array | None = None
) -> PhotographedPress:
    """The press with a refined circle, by what is not `hidden` (H, W) of the change against the untouched picture
    (H, W, 3)."""
    if press.contact is None:
        return press
    seen = np.ones(untouched.shape[:2], bool) if hidden is None else ~hidden
    angles = 2 * np.pi * np.arange(CIRCLE_POINTS) / CIRCLE_POINTS
    around = np.column_stack([np.cos(angles), np.sin(angles) / press.aspect])
    far = np.array(press.center) + CLEAR_RAY_RADII * press.contact * around
    angles = angles[((far > 0) & (far < untouched.shape[1::-1])).all(axis=1)]
    if len(angles) < CIRCLE_POINTS / 2:
        return press
    found, change = lamps.centred(press, untouched, seen), press.picture.astype(float) - untouched
    assert found.contact is not None
    width, radii = BEND_WIDTH * found.contact, found.contact * RADIUS_RATIOS
    bends = [bend(change, np.array([*found.center, r]), width, angles, seen.astype(float), press.aspect) for r in radii]
    return replace(found, contact=float(radii[int(np.argmax(bends))]))


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
