"""Depth and centre of photographed ball presses, and the unit's colours by slope, for a gel of one thickness.

The change of a picture is taken as a polynomial in the slopes of the face, plus a part in proportion to its drop, whose
factors hardly vary over the picture, or vary strongly if that suits unseen presses better. (From dents at one place,
factors that vary inside a dent cannot be told from the powers of the slopes, and do not hold elsewhere.)
The ball's known radius sets the scale inside
the contact, so that the factors (the contrast) and the depths are found together: the factors by linear least squares
for all pictures, depth and centre of each picture by Gauss and Newton, in turn.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.optimize import minimize_scalar

from tacgen.calibrate.dent_tables import DentProfile, Dents
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.surface_grid import Untouched
from tacgen.sensor.model import LitSensor

Array = np.ndarray
# of colours and positions in turn at most, at first and from values that nearly fit
MAX_COLOUR_ROUNDS, MAX_REFINING_ROUNDS = 20, 5
SETTLED_DEPTH_MM = 2e-3  # [mm]: largest change of a depth in the last round
COMPARED_PIXELS = 1500  # pixels of a smoothed picture that are compared, about
PICTURE_BLUR = 0.5  # standard deviation of this smoothing, over the distance of these pixels
OMITTED_RIM_SHARE = 0.06  # of the picture's sides: left out along them, where lights and walls show
DEPTH_DIFFERENCE_MM = 0.02  # [mm]: of differences by depth and centre
JACOBIAN_REACH_MM = 0.05  # [mm]: change of depth or centre over which derivatives are kept
MIN_PRESS_DEPTH_MM = 1e-3  # [mm]: smallest depth
COLOUR_RIDGE = 1e-5  # of the equations for the colours, over their diagonal
PLACE_COLUMNS, PLACE_RIDGE = 4, 0.03  # columns that vary with the place, and their ridge over the squared slopes
MAX_CENTRE_STEP_MM = 0.5  # [mm]: largest change of a centre in a round
DENT_CHANGE_SHARE = 0.3  # of the largest change: pixels that count as the dent for the start values
FAINT_DENT_SHARE = 0.3  # of the loudest picture's change: fainter dents start where the loudest of their recording lies
MIN_RECORDINGS_FOR_PLACE = 6  # from which colours may vary over the picture
USUAL_BLUR = 0.1  # over the gel's thickness: where the two kinds of colours are compared
MISFIT_SECTORS = 6  # angles around the centre over which the misfit is kept apart
LEAST_DRIFT = 4  # pictures of a sequence from which a drift can be told
MAX_SLOPE_BLUR, SLOPE_BLUR_TOL = 0.4, 0.04  # largest blur of the slopes over the gel's thickness, and its tolerance


@dataclass(frozen=True)
class PressPicture:
    """A press to be placed: change against the untouched picture (p, 3) [counts] at the compared pixels."""

    change: Array  # with mean 0
    ball: float  # radius [mm]
    recording: int
    smooth: float  # part of the sum of squares of `change` [counts^2] explained by smoothly drifting light

    @property
    def loud(self) -> float:
        """Size of the change [counts]."""
        return float(np.quantile(np.linalg.norm(self.change, axis=1), 0.995))


@dataclass(frozen=True)
class LocatedPresses:
    """Where presses lie, for a gel of one thickness, and what is left of their pictures."""

    at: Array  # (n, 3): depth, x, y [mm]
    colours: Array  # (columns, 3) [counts]
    blur: float  # standard deviation by which the rim is softer than the solved one [mm]
    misfit: Array  # (n, MISFIT_SECTORS) [counts^2]: sum of squares by angle around the centre
    change: float  # [counts^2]: sum of squares of the pictures' changes


class PressView:
    """The compared pixels of a sensor's pictures, and what presses do there."""

    def __init__(self, sensor: LitSensor) -> None:
        self.camera = camera = PinholeCamera.from_sensor(sensor)
        height, width = camera.shape
        rim = int(OMITTED_RIM_SHARE * min(height, width))
        self._stride = max(1, round(np.sqrt(height * width / COMPARED_PIXELS)))
        self._pixels = tuple(np.arange(rim + self._stride // 2, side - rim, self._stride) for side in (height, width))
        y, x = (part.ravel() for part in np.meshgrid(*self._pixels, indexing="ij"))
        self._origin, self._ray = camera.rays(np.column_stack([x, y]) + 0.5)
        self._face = Untouched.of(sensor.gel)
        self.level = self._hit(np.full(len(x), float(self._face.height(np.zeros((1, 2)))[0])))
        self.half = np.abs(self.level).max(axis=0)
        self._untouched = self._hit(self._face.height(self.level))  # where the rays meet the face, about

    def _hit(self, z: Array) -> Array:
        """x and y (p, 2) [mm] of the pixels' rays at heights z (p,) [mm]."""
        along = (z - self._origin[:, 2]) / self._ray[:, 2]
        return np.asarray((self._origin + self._ray * along[:, None])[:, :2])

    def picture(self, picture: Array, untouched: Array, ball: float, recording: int) -> PressPicture:
        """A photograph (H, W, 3) against the untouched one, at the compared pixels."""
        width, some = PICTURE_BLUR * self._stride, np.ix_(*self._pixels)
        change, before = (gaussian_filter(one, (width, width, 0))[some].reshape(-1, 3)
                          for one in (picture.astype(float) - untouched, untouched.astype(float)))  # fmt: skip
        change = change - change.mean(axis=0)
        return PressPicture(change, ball, recording, self._smooth(change, before))

    def _smooth(self, change: Array, untouched: Array) -> float:
        """The part [counts^2] of a change (p, 3) that a quadratic offset over the picture explains together with a
        factor on the untouched picture (p, 3) that is linear there: lights that grow brighter or dimmer."""
        x, y = (self.level / self.half).T
        linear = np.column_stack([np.ones_like(x), x, y])
        offset, part = np.column_stack([linear, x**2, x * y, y**2]), 0.0
        for wanted, plain in zip(change.T, untouched.T, strict=True):
            table = np.hstack([offset, linear * plain[:, None]])
            left = wanted - table @ np.linalg.lstsq(table, wanted, rcond=None)[0]
            part += float((wanted**2).sum() - (left**2).sum())
        return part

    def starts(self, pictures: Sequence[PressPicture]) -> Array:
        """Rough depth, x and y (n, 3) [mm] of presses, from where their pictures change most."""
        at, loud = np.zeros((len(pictures), 3)), np.array([one.loud * one.ball for one in pictures])
        for k, one in enumerate(pictures):
            size = np.linalg.norm(one.change - np.median(one.change, axis=0), axis=1)
            seen = size > DENT_CHANGE_SHARE * np.quantile(size, 0.995)
            centre = np.average(self.level[seen], axis=0, weights=size[seen])
            reach = 1.2 * np.linalg.norm(self.level - centre, axis=1)[seen].mean() * min(1, 2 * loud[k] / loud.max())
            at[k] = reach**2 / (1.6 * one.ball), *centre
        for k, one in enumerate(pictures):
            same = [j for j, other in enumerate(pictures) if other.recording == one.recording]
            best = max(same, key=lambda j: loud[j])
            if loud[k] < FAINT_DENT_SHARE * loud[best]:
                at[k, 1:] = at[best, 1:]
        return at

    def columns(self, dents: Dents, at: Array, blur: float, rich: bool) -> Array:
        """Terms (p, columns), each with mean 0, in which the colours of a press at (depth, x, y) [mm] are linear."""
        return self.terms(dents.profile(float(at[0]), blur), at[1:], rich)

    def terms(self, dent: DentProfile, at: Array, rich: bool) -> Array:
        """`columns` of a press at x and y [mm], whose face is known."""
        drop = dent.drop_at(np.hypot(*(self._untouched - at).T))
        xy = self._hit(self._face.height(self._untouched) + drop)
        away = np.hypot(*(xy - at).T)
        s = (dent.slope_at(away) / np.maximum(away, 1e-9))[:, None] * (xy - at)
        square, drop = np.column_stack([s**2, s[:, 0] * s[:, 1]]), dent.drop_at(away)[:, None]
        if rich:
            (x, y), cube = (xy / self.half).T[..., None], np.column_stack([s**3, s**2 * s[:, ::-1]])
            parts = [s, square, cube, drop, x * s, y * s, x**2 * s, x * y * s, y**2 * s, x * square, y * square,
                     x * drop, y * drop]  # fmt: skip
        else:
            x, y = at / self.half
            parts = [s, square, (s**2).sum(axis=1, keepdims=True) * s, drop, x * s, y * s]
        table = np.column_stack(parts)
        return np.asarray(table - table.mean(axis=0))

    def sector(self, at: Array) -> Array:
        """The angle around a press's centre that each pixel belongs to (p,), from 0 to MISFIT_SECTORS - 1."""
        angle = np.arctan2(*(self.level - at[1:]).T[::-1]) / (2 * np.pi) % 1.0
        return np.asarray(np.minimum((MISFIT_SECTORS * angle).astype(int), MISFIT_SECTORS - 1))


def located_with_best_blur(
    view: PressView, pictures: Sequence[PressPicture], dents: Mapping[float, Dents], rich: bool,
    near: LocatedPresses | None = None,
) -> LocatedPresses:  # fmt: skip
    """Depths and centres of presses with the colours and the blur that suit them best.

    Args:
        dents: by the balls' radii.
        rich: whether colours vary over the picture.
        near: the presses for a similar thickness, to start from.
    """
    thick = next(iter(dents.values())).thickness
    if near is None:
        best = located(view, pictures, dents, view.starts(pictures), USUAL_BLUR * thick, rich)
    else:
        best = located(view, pictures, dents, near.at, near.blur, rich, rounds=MAX_REFINING_ROUNDS)

    def misfit(blur: float) -> float:
        nonlocal best
        tried = located(view, pictures, dents, best.at, blur, rich, rounds=MAX_REFINING_ROUNDS)
        best = min(best, tried, key=lambda one: float(one.misfit.sum()))
        return float(tried.misfit.sum())

    bounds, how = (0.0, MAX_SLOPE_BLUR * thick), {"xatol": SLOPE_BLUR_TOL * thick}
    minimize_scalar(misfit, bounds=bounds, method="bounded", options=how)
    return best


def blur_at_bound(one: LocatedPresses, thickness: float) -> bool:
    """Whether the blur that suits presses best in a gel of a thickness [mm] is the largest that is tried."""
    return one.blur > (MAX_SLOPE_BLUR - SLOPE_BLUR_TOL) * thickness


def colours_vary(view: PressView, pictures: Sequence[PressPicture], dents: Mapping[float, Dents]) -> bool:
    """Whether colours that vary over the picture suit unseen recordings better than those that hardly do.

    Recordings are left out in turn, at the depths and centres found with the simpler ones; with one recording, no.
    """
    groups = np.array([one.recording for one in pictures])
    if len(np.unique(groups)) < MIN_RECORDINGS_FOR_PLACE:
        return False
    thick = next(iter(dents.values())).thickness
    at = located(view, pictures, dents, view.starts(pictures), USUAL_BLUR * thick, False).at
    off = []
    for rich in (False, True):
        tables = [view.columns(dents[p.ball], a, USUAL_BLUR * thick, rich) for p, a in zip(pictures, at, strict=True)]
        left = 0.0
        for group in np.unique(groups):
            seen, unseen = (np.flatnonzero(where).tolist() for where in (groups != group, groups == group))
            colours = best_colours([tables[k] for k in seen], [pictures[k] for k in seen], rich)
            left += sum(float(((tables[k] @ colours - pictures[k].change) ** 2).sum()) for k in unseen)
        off.append(left)
    return off[1] < off[0]


def located(
    view: PressView, pictures: Sequence[PressPicture], dents: Mapping[float, Dents], start: Array, blur: float,
    rich: bool, colours: Array | None = None, rounds: int = MAX_COLOUR_ROUNDS,
) -> LocatedPresses:  # fmt: skip
    """Depths and centres of presses with one blur [mm], from start values (n, 3), and colours unless they are given."""
    at, moving = start.copy(), np.ones(len(pictures), bool)
    tables = [view.columns(dents[p.ball], a, blur, rich) for p, a in zip(pictures, at, strict=True)]
    slopes = dict[int, tuple[Array, Array]]()  # place and Jacobian of each picture
    for _ in range(rounds):
        found = best_colours(tables, pictures, rich) if colours is None else colours
        largest = 0.0
        for k in np.flatnonzero(moving).tolist():
            dent = dents[pictures[k].ball]
            if k not in slopes or np.abs(at[k] - slopes[k][0]).max() > JACOBIAN_REACH_MM:
                slopes[k] = at[k].copy(), _jacobian(view, dent, at[k], tables[k], found, blur, rich)
            step = _step(slopes[k][1], pictures[k], at[k], tables[k], found, dent)
            at[k] += step
            tables[k] = view.columns(dent, at[k], blur, rich)
            moving[k] = colours is None or abs(step[0]) > SETTLED_DEPTH_MM
            largest = max(largest, abs(step[0]))
        if largest < SETTLED_DEPTH_MM:
            break
    found = best_colours(tables, pictures, rich) if colours is None else colours
    left = [((table @ found - one.change) ** 2).sum(axis=1) for table, one in zip(tables, pictures, strict=True)]
    misfit = [np.bincount(view.sector(a), one, MISFIT_SECTORS) for a, one in zip(at, left, strict=True)]
    return LocatedPresses(at, found, blur, np.array(misfit), float(sum((p.change**2).sum() for p in pictures)))


def best_colours(tables: Sequence[Array], pictures: Sequence[PressPicture], rich: bool) -> Array:
    """The best colours (columns, 3) by least squares over all pictures."""
    normal = sum(t.T @ t for t in tables)
    right = sum(t.T @ p.change for t, p in zip(tables, pictures, strict=True))
    held = COLOUR_RIDGE * np.diag(normal) + 1e-12 * np.trace(normal)
    if not rich:
        held[-PLACE_COLUMNS:] += PLACE_RIDGE * np.diag(normal)[:2].mean()
    return np.asarray(np.linalg.solve(normal + np.diag(held), right))


def _jacobian(view: PressView, dents: Dents, at: Array, table: Array, colours: Array, blur: float, rich: bool) -> Array:
    """Derivatives (3, 3 p) of a picture [counts] by depth, x and y [mm], by differences."""
    (depth, x, y), d = at, DEPTH_DIFFERENCE_MM
    here = dents.profile(depth, blur)
    moved = (dents.profile(depth + d, blur), at[1:]), (here, np.array([x + d, y])), (here, np.array([x, y + d]))
    return np.array([((view.terms(*one, rich) - table) @ colours).ravel() / d for one in moved])


def _step(jacobian: Array, picture: PressPicture, at: Array, table: Array, colours: Array, dents: Dents) -> Array:
    """Change of depth, x and y [mm] by Gauss and Newton, within the depths that are solved."""
    made = table @ colours
    normal = jacobian @ jacobian.T
    held = normal + 1e-6 * max(float(np.trace(normal)), 1e-9) * np.eye(3)
    step = np.linalg.solve(held, jacobian @ (picture.change - made).ravel())
    step = np.clip(step, -MAX_CENTRE_STEP_MM, MAX_CENTRE_STEP_MM)
    low, high = 0.7 * at[0] - 0.02, 1.5 * at[0] + 0.02  # no further in one round
    step[0] = np.clip(np.clip(at[0] + step[0], low, high), MIN_PRESS_DEPTH_MM, dents.depth[-1]) - at[0]
    return np.asarray(step)


def drift(pictures: Sequence[PressPicture], recording: Array, time: Array) -> float:
    """Share of the pictures' squared changes that needs no dent: the better one of two drifts of the light explains it.

    Smooth light: see `PressView.picture`. In time: one pattern that changes linearly, with each picture predicted from
    the others of its recording; pictures without time count in their order, and those of short recordings together.

    Args:
        recording: the recording of each picture (n,).
        time: its time (n,) [s], nan where none is known.
    """
    whole = sum(float((one.change**2).sum()) for one in pictures)
    long = [k for k in np.unique(recording) if (recording == k).sum() >= LEAST_DRIFT]
    rest = ~np.isin(recording, long)
    part = 0.0
    for where in (*(recording == k for k in long), rest):
        here, times = np.flatnonzero(where), time[where]
        if len(here) >= LEAST_DRIFT:
            known = np.isfinite(times).all() and where is not rest
            changes = np.array([pictures[int(k)].change.ravel() for k in here])
            part += _in_time(changes, times if known else np.arange(len(here)))
    return max(part, sum(one.smooth for one in pictures)) / whole


def _in_time(changes: Array, time: Array) -> float:
    """Sum of squares of changes (n, values) that lines over the time (n,) predict, each from the other rows."""
    table = np.column_stack([np.ones(len(time)), time - time.mean()])
    hat = table @ np.linalg.pinv(table)
    left = (changes - hat @ changes) / np.maximum(1 - np.diag(hat), 1e-9)[:, None]
    return max(0.0, float((changes**2).sum() - (left**2).sum()))
