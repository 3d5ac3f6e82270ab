"""Depth and centre of photographed ball presses, and the unit's colours by slope, for a gel of one thickness.

The change of a picture is taken as linear in the slopes of the face, with factors that vary linearly with the place of
the press, plus a quadratic and a cubic part and a part in proportion to the drop of the face. (Factors that vary inside
a dent cannot be told from the quadratic part unless dents at many places overlap, and do not hold elsewhere.) The ball's known radius sets the scale inside
the contact, so that the factors (the contrast) and the depths are found together: the factors by linear least squares
for all pictures, depth and centre of each picture by Gauss and Newton, in turn.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.optimize import minimize_scalar

from tacgen.calibrate.ball_dents import Dents
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.surface_grid import Untouched
from tacgen.sensor.model import LitSensor

Array = np.ndarray
ROUNDS = 40  # of lights and positions in turn, at most
SETTLED = 1e-3  # [mm]: largest change of a depth in the last round
STRIDE = 4  # pixels: smoothed pictures are compared at every so manyth
SMOOTH = 2.0  # [px] standard deviation of this smoothing
RIM = 0.06  # of the picture's sides: left out along them, where lights and walls show
STEP = 0.02  # [mm]: of differences by depth and centre
LEAST = 1e-3  # [mm]: smallest depth
RIDGE = 1e-6  # of the equations for the colours, over their diagonal
PLACE, HELD = 4, 0.03  # columns that vary with the place, and their ridge over the squared slopes
MOST = 0.5  # [mm]: largest change of a centre in a round
LOUD = 0.3  # of the largest change: pixels that count as the dent for the start values
FAINT = 0.3  # of the loudest picture's change: fainter dents start where the loudest of their recording lies
SECTORS = 6  # angles around the centre over which the misfit is kept apart
BLUR, BLUR_STEP = 0.4, 0.02  # largest blur of the slopes over the gel's thickness, and its tolerance


@dataclass(frozen=True)
class Picture:
    """A press to be placed: change against the untouched picture (p, 3) [counts] at the compared pixels."""

    change: Array  # with mean 0
    ball: float  # radius [mm]
    recording: int

    @property
    def loud(self) -> float:
        """Size of the change [counts]."""
        return float(np.quantile(np.linalg.norm(self.change, axis=1), 0.995))


@dataclass(frozen=True)
class Placed:
    """Where presses lie, for a gel of one thickness, and what is left of their pictures."""

    at: Array  # (n, 3): depth, x, y [mm]
    colours: Array  # (columns, 3) [counts]
    blur: float  # standard deviation by which the rim is softer than the solved one [mm]
    misfit: Array  # (n, SECTORS) [counts^2]: sum of squares by angle around the centre
    change: float  # [counts^2]: sum of squares of the pictures' changes


class View:
    """The compared pixels of a sensor's pictures, and what presses do there."""

    def __init__(self, sensor: LitSensor) -> None:
        camera = PinholeCamera.from_sensor(sensor)
        height, width = camera.shape
        rim = int(RIM * min(height, width))
        self._pixels = tuple(np.arange(rim + STRIDE // 2, side - rim, STRIDE) for side in (height, width))
        y, x = (part.ravel() for part in np.meshgrid(*self._pixels, indexing="ij"))
        self._origin, self._ray = camera.rays(np.column_stack([x, y]) + 0.5)
        self._face = Untouched.of(sensor.gel)
        self.level = self._hit(np.full(len(x), float(self._face.height(np.zeros((1, 2)))[0])))
        self._half = np.abs(self.level).max(axis=0)

    def _hit(self, z: Array) -> Array:
        """x and y (p, 2) [mm] of the pixels' rays at heights z (p,) [mm]."""
        along = (z - self._origin[:, 2]) / self._ray[:, 2]
        return np.asarray((self._origin + self._ray * along[:, None])[:, :2])

    def picture(self, picture: Array, untouched: Array, ball: float, recording: int) -> Picture:
        """A photograph (H, W, 3) against the untouched one, at the compared pixels."""
        change = gaussian_filter(picture.astype(float) - untouched, (SMOOTH, SMOOTH, 0))
        change = change[np.ix_(*self._pixels)].reshape(-1, 3)
        return Picture(change - change.mean(axis=0), ball, recording)

    def starts(self, pictures: Sequence[Picture]) -> Array:
        """Rough depth, x and y (n, 3) [mm] of presses, from where their pictures change most."""
        at, loud = np.zeros((len(pictures), 3)), np.array([one.loud * one.ball for one in pictures])
        for k, one in enumerate(pictures):
            size = np.linalg.norm(one.change - np.median(one.change, axis=0), axis=1)
            seen = size > LOUD * np.quantile(size, 0.995)
            centre = np.average(self.level[seen], axis=0, weights=size[seen])
            reach = 1.2 * np.linalg.norm(self.level - centre, axis=1)[seen].mean() * min(1, 2 * loud[k] / loud.max())
            at[k] = reach**2 / (1.6 * one.ball), *centre
        for k, one in enumerate(pictures):
            same = [j for j, other in enumerate(pictures) if other.recording == one.recording]
            best = max(same, key=lambda j: loud[j])
            if loud[k] < FAINT * loud[best]:
                at[k, 1:] = at[best, 1:]
        return at

    def columns(self, dents: Dents, at: Array, blur: float) -> Array:
        """What the colours of a press at (depth, x, y) [mm] are linear in (p, columns), each with mean 0."""
        z = self._face.height(self.level)
        for _ in range(3):
            xy = self._hit(z)
            away = np.hypot(*(xy - at[1:]).T)
            drop, slope = dents.face(float(at[0]), away, blur)
            z = self._face.height(xy) + drop
        s = (slope / np.maximum(away, 1e-9))[:, None] * (xy - at[1:])
        steep, (right, down) = (s**2).sum(axis=1, keepdims=True), at[1:] / self._half
        own = np.column_stack([s, s[:, 0] ** 2, s[:, 1] ** 2, s[:, 0] * s[:, 1], steep * s, drop])
        table = np.column_stack([own, right * s, down * s])
        return np.asarray(table - table.mean(axis=0))

    def sector(self, at: Array) -> Array:
        """The angle around a press's centre that each pixel belongs to (p,), from 0 to SECTORS - 1."""
        angle = np.arctan2(*(self.level - at[1:]).T[::-1]) / (2 * np.pi) % 1.0
        return np.minimum((SECTORS * angle).astype(int), SECTORS - 1)


def placed(view: View, pictures: Sequence[Picture], dents: Mapping[float, Dents]) -> Placed:
    """Depths and centres of presses with the colours and the blur that suit them best; `dents` by the balls' radii."""
    best = located(view, pictures, dents, view.starts(pictures), 0.0)
    most = BLUR * next(iter(dents.values())).thickness

    def misfit(blur: float) -> float:
        nonlocal best
        tried = located(view, pictures, dents, best.at, blur)
        best = min(best, tried, key=lambda one: float(one.misfit.sum()))
        return float(tried.misfit.sum())

    minimize_scalar(misfit, bounds=(0.0, most), method="bounded", options={"xatol": BLUR_STEP * most / BLUR})
    return best


def located(
    view: View, pictures: Sequence[Picture], dents: Mapping[float, Dents], start: Array, blur: float,
    colours: Array | None = None,
) -> Placed:  # fmt: skip
    """Depths and centres of presses with one blur [mm], from start values (n, 3), and colours unless they are given."""
    at, found, moving = start.copy(), colours, np.ones(len(pictures), bool)
    tables = [view.columns(dents[p.ball], a, blur) for p, a in zip(pictures, at, strict=True)]
    for _ in range(ROUNDS):
        if colours is None:
            found = _colours(tables, pictures)
        assert found is not None
        largest = 0.0
        for k in np.flatnonzero(moving):
            step = _step(view, pictures[k], dents[pictures[k].ball], at[k], tables[k], found, blur)
            at[k] += step
            tables[k] = view.columns(dents[pictures[k].ball], at[k], blur)
            moving[k] = colours is None or abs(step[0]) > SETTLED
            largest = max(largest, abs(step[0]))
        if not moving.any() or largest < SETTLED:
            break
    if colours is None:
        found = _colours(tables, pictures)
    assert found is not None
    misfit = [
        np.bincount(view.sector(a), ((t @ found - p.change) ** 2).sum(axis=1), SECTORS)
        for t, p, a in zip(tables, pictures, at, strict=True)
    ]
    return Placed(at, found, blur, np.array(misfit), float(sum((p.change**2).sum() for p in pictures)))


def _colours(tables: Sequence[Array], pictures: Sequence[Picture]) -> Array:
    """The best colours (columns, 3) by least squares over all pictures."""
    normal = sum(t.T @ t for t in tables)
    right = sum(t.T @ p.change for t, p in zip(tables, pictures, strict=True))
    held = RIDGE * np.diag(normal)
    held[-PLACE:] += HELD * np.diag(normal)[:2].mean()
    return np.asarray(np.linalg.solve(normal + np.diag(held), right))


def _step(
    view: View, picture: Picture, dents: Dents, at: Array, table: Array, colours: Array, blur: float
) -> Array:
    """Change of depth, x and y [mm] by Gauss and Newton, within the depths that are solved."""
    made, slopes = table @ colours, []
    for k in range(3):
        moved = at + STEP * (np.arange(3) == k)
        slopes.append(((view.columns(dents, moved, blur) @ colours - made) / STEP).ravel())
    jacobian = np.array(slopes)
    normal = jacobian @ jacobian.T
    held = normal + 1e-6 * max(float(np.trace(normal)), 1e-9) * np.eye(3)
    step = np.clip(np.linalg.solve(held, jacobian @ (picture.change - made).ravel()), -MOST, MOST)
    low, high = 0.7 * at[0] - 0.02, 1.5 * at[0] + 0.02  # no further in one round
    step[0] = np.clip(np.clip(at[0] + step[0], low, high), LEAST, dents.depth[-1]) - at[0]
    return np.asarray(step)
