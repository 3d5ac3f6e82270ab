"""Fit of the lights of a sensor with a clear gel, with the ridge that suits unseen presses best.

The equations (see photometric_model) are made with their derivatives by the other parameters, solved, and made anew
there. All fits begin with those at the file's parameters, which are made once.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from tacgen.calibrate import contact_circle, robust_least_squares, solved_presses, steps, untouched_drift
from tacgen.calibrate.cross_validation import Fitted, HeldOutPresses, determined, folds, rms
from tacgen.calibrate.photometric_model import FitLimits, PhotometricModel
from tacgen.calibrate.photos import PhotographedPress, Photos
from tacgen.calibrate.render_comparison import Comparison, Likeness
from tacgen.calibrate.robust_least_squares import LinearModel, Ridge
from tacgen.optics.surface_grid import Surface
from tacgen.sensor.model import LitSensor
from tacgen.sensor.yaml_source import KeyPath

Array = np.ndarray
# tried penalties of a parameter at the end of its tolerance, over all pixels [counts]
TOLERANCE_RIDGES = (300.0, 30.0, 3.0)
SOFT_L1_COUNTS = 15.0  # scale of the soft-l1 loss, for marks and dust [counts]
# change of half a range, and gain of the loss, below which no further table is made
MIN_TABLE_CHANGE, MIN_TABLE_GAIN = 0.02, 2e-3
DIFFERENCE_STEP = 0.02  # of half a range: step of the difference quotients
# expected work of a fit [s of a core]: derivatives at the file's parameters, a search, a network
SLOPES_S, SEARCH_S, COMPARISON_S = 2.0, 2.5, 12.0
# weight of a pixel of the untouched picture where changes are what matters, or lamps do not explain it
UNTOUCHED_WEIGHT = 0.1


def fit(sensor: LitSensor, photos: Photos, folders: dict[KeyPath, Path], limits: FitLimits) -> Fitted:
    """Fit the radiance and, with presses, the other parameters, with the ridge that suits unseen presses best."""
    solved_presses.check(sensor, photos)
    if sensor.gel.dome is None:  # on a dome the rim is hidden by the change of shadows
        lamps = contact_circle.LampChanges(sensor)
        refined = tuple(contact_circle.refined(press, photos.untouched, lamps) for press in photos.presses)
        photos = replace(photos, presses=refined)
    presses, faces = solved_presses.faced(sensor, photos.presses, folders)
    steady = untouched_drift.removed(presses, photos.untouched)
    drift = [a.picture.astype(float) - b.picture for a, b in zip(presses, steady, strict=True)]
    fitted = fit_faces(sensor, replace(photos, presses=steady), faces, limits)
    return replace(fitted, drift=rms(drift) if drift else 0.0)


def fit_faces(
    sensor: LitSensor, photos: Photos, faces: Sequence[Surface], limits: FitLimits, *, changes: bool = False
) -> Fitted:
    """Fit a sensor with a clear gel to presses whose faces are known.

    `changes`: how presses change the picture is fitted and judged alone; the untouched picture counts UNTOUCHED_WEIGHT.
    """
    groups = folds(len(photos.presses))
    compared = not changes and all(press.contact is not None for press in photos.presses)
    searches = len(TOLERANCE_RIDGES) * (len(groups) + 1) * limits.steps
    steps.expect(SLOPES_S + SEARCH_S * searches + COMPARISON_S * (1 + len(groups)) * compared)
    weight = UNTOUCHED_WEIGHT if changes or sensor.camera.glare is not None else 1.0
    fits = PhotometricFits(sensor, photos, faces, limits, weight)
    if not groups:
        return fits.whole(TOLERANCE_RIDGES[-1])
    kept = fits.whole(TOLERANCE_RIDGES[0])
    unseen: HeldOutPresses | None = None
    try:
        counts, made = fits.judged(groups)
        best = int(np.argmin(counts[1:].mean(axis=1)))
        kept = fits.whole(TOLERANCE_RIDGES[best])
        held_out = [k - 1 for group in groups for k in group]
        presses, seen = [photos.presses[k] for k in held_out], [faces[k] for k in held_out]
        judging = [at_scale(sensor, one) for one in made[best]]
        each = tuple(one for group, one in zip(groups, judging, strict=True) for _ in group)
        unseen = HeldOutPresses(tuple(presses), tuple(seen), each, counts[[0, best + 1]], None)
        if compared and not unseen.lost:  # networks take most of the time
            sizes = [len(group) for group in groups]
            unseen = replace(unseen, likeness=_alike(sensor, judging, sizes, presses, seen, photos.untouched))
    except KeyboardInterrupt:
        how = "not judged by" if unseen is None else "normals are not judged on"
        return replace(kept, unseen=unseen, interrupted=f"{steps.INTERRUPTED}: {how} presses that the fit has not seen")
    return replace(kept, unseen=unseen)


def _alike(
    sensor: LitSensor, fitted: Sequence[LitSensor], sizes: Sequence[int], presses: Sequence[PhotographedPress],
    faces: Sequence[Surface], untouched: Array,
) -> tuple[Likeness, Likeness]:  # fmt: skip
    """Likeness of the sensor to presses, and of each fit to its group of them, of `sizes`, together."""
    ends = np.cumsum(sizes).tolist()
    parts = [slice(end - size, end) for size, end in zip(sizes, ends, strict=True)]
    jobs = [(sensor, presses, faces, untouched)]
    jobs += [(one, presses[part], faces[part], untouched) for one, part in zip(fitted, parts, strict=True)]
    texts = [f"network {k} of {len(jobs)} that judges by normals" for k in range(1, len(jobs) + 1)]
    before, *after = steps.on_workers(_likeness, jobs, texts, COMPARISON_S)
    return before, Likeness.over(after)


def _likeness(
    sensor: LitSensor, presses: Sequence[PhotographedPress], faces: Sequence[Surface], untouched: Array
) -> Likeness:
    return Comparison(sensor).likeness(presses, faces, untouched)


def at_scale(sensor: LitSensor, fitted: LitSensor) -> LitSensor:
    """A sensor with the lights, the coating and the camera's fitted values of one at the fit's scale."""
    light = {key: getattr(fitted.camera, key) for key in ("ambient", "vignette_mm", "crop_mm")}
    eye = sensor.camera.model_copy(update=light)
    return sensor.model_copy(update={"leds": fitted.leds, "coating": fitted.coating, "camera": eye})


class PhotometricFits(PhotometricModel):
    """Fits to all photographs, and to all but some that judge them."""

    def whole(self, ridge: float) -> Fitted:
        """The fit to all pictures, made as those are that judge it."""
        every = list(range(len(self.pictures)))
        begin, lights = self._chain(TOLERANCE_RIDGES.index(ridge))
        misfits = self._misfits(begin, lights, every)
        shown = self._misfits(self._start, self.own, [0])
        return Fitted(
            self._sensor(begin, lights), rms(misfits[:1]), rms(shown), rms(misfits[1:]) if len(every) > 1 else None,
            ridge=ridge, determined=self._determined(begin, lights, every, ridge),
        )  # fmt: skip

    def _chain(self, number: int) -> tuple[Array, Array]:
        """The search of all pictures with one of TOLERANCE_RIDGES, from what the stiffer ones before it have found."""
        while len(self._found) <= number:
            v, _ = self._found[-1] if self._found else (self._start, None)
            ridge = TOLERANCE_RIDGES[len(self._found)]
            steps.begin(f"fit to all photographs, ridge {ridge:g}", SEARCH_S + (0 if self._found else SLOPES_S))
            self._found.append(self._search(v, list(range(len(self.pictures))), ridge))
        return self._found[number]

    @cached_property
    def _found(self) -> list[tuple[Array, Array]]:
        return []

    def judged(self, groups: list[list[int]]) -> tuple[Array, list[list[LitSensor]]]:
        """Misfit of presses that are not seen [counts], of the file and then of fits with each of TOLERANCE_RIDGES, (1
        + TOLERANCE_RIDGES, presses); and those fits by ridge, then by group."""
        counts: list[list[float]] = [[] for _ in range(1 + len(TOLERANCE_RIDGES))]
        made: list[list[LitSensor]] = [[] for _ in TOLERANCE_RIDGES]
        for number, held_out in enumerate(groups, 1):
            seen = [k for k in range(len(self.pictures)) if k not in held_out]
            v = self._start
            counts[0] += [rms([one]) for one in self._misfits(v, self.own, held_out)]
            for ridge, scores, fits in zip(TOLERANCE_RIDGES, counts[1:], made, strict=True):
                steps.begin(f"fit {number} of {len(groups)} without some presses, ridge {ridge:g}", SEARCH_S)
                v, lights = self._search(v, seen, ridge)
                fits.append(self._sensor(v, lights))
                scores += [rms([one]) for one in self._misfits(v, lights, held_out)]
        return np.array(counts), made

    def _misfits(self, v: Array, lights: Array, chosen: list[int]) -> list[Array]:
        """Misfits [counts] of the chosen pictures, (3 pixels,) each."""
        return [row @ np.append(lights, -1.0) for row in self.rows(v, chosen)]

    def _free(self, seen: list[int]) -> Array:
        """Numbers of the parameters that vary; a background and one press determine only radiances."""
        return np.flatnonzero(self._most > self._least) if len(seen) > 2 else np.zeros(0, int)

    def _search(self, begin: Array, seen: list[int], ridge: float) -> tuple[Array, Array]:
        """The parameters and radiances with the smallest loss of some pictures, by equations that are made anew, with
        their derivatives, at most `limits.steps` times."""
        free = self._free(seen)
        v, lights = begin, self.lights(self.rows(begin, seen), seen, ridge)
        if not len(free):
            return v, lights
        half, hold = self._half(free), Ridge(ridge, self.own.ravel(), self._power.ravel())
        bounds = (self._least - self._start)[free] / half, (self._most - self._start)[free] / half

        def cost(v: Array, lights: Array) -> float:
            off = self.weighed(self.rows(v, seen), seen) @ np.append(lights, -1.0)
            return robust_least_squares.loss(off, (v - self._start)[free] / half, lights, hold, SOFT_L1_COUNTS)

        now = cost(v, lights.ravel())
        for _ in range(self.limits.steps):
            near = self._tables(v, seen)
            u, found = robust_least_squares.minimise(near, lights.ravel(), bounds, hold, SOFT_L1_COUNTS)
            for share in robust_least_squares.STEP_FRACTIONS:  # of the way, if the equations are not as linear as taken
                tried = v.copy()
                tried[free] += share * half * (u - near.at)
                some = lights.ravel() + share * (found - lights.ravel())
                if (then := cost(tried, some)) < now:
                    break
            else:
                break
            v, lights, gained, now = tried, some.reshape(lights.shape), now - then, then
            if share * np.abs(u - near.at).max() < MIN_TABLE_CHANGE or gained < MIN_TABLE_GAIN * now:
                break
        return v, lights

    def _half(self, free: Array) -> Array:
        """Half the ranges of parameters."""
        return np.asarray((self._most - self._least)[free] / 2)

    def _tables(self, v: Array, seen: list[int]) -> LinearModel:
        """The weighed equations of some pictures for the radiances, and their derivatives by the free parameters."""
        free = self._free(seen)
        rows, slopes = self._kept_start if np.array_equal(v, self._start) else self._derived(v, seen)
        return LinearModel(
            (v - self._start)[free] / self._half(free),
            self.weighed([rows[k] for k in seen], seen),
            np.stack([self.weighed([one[k] for k in seen], seen) for one in slopes]),
        )

    @cached_property
    def _kept_start(self) -> tuple[dict[int, Array], list[dict[int, Array]]]:
        """Equations and derivatives of all pictures at the file's parameters, which every fit begins with."""
        return self._derived(self._start, list(range(len(self.pictures))))

    def _derived(self, v: Array, seen: list[int]) -> tuple[dict[int, Array], list[dict[int, Array]]]:
        """Equations by picture, and for each free parameter their change by half its range."""
        free = self._free(seen)
        here, slopes = self.rows(v, seen), list[dict[int, Array]]()
        for k, half in zip(free, self._half(free), strict=True):
            steps.go_on(f"derivative {len(slopes) + 1} of {len(free)}")
            step = DIFFERENCE_STEP * half * (-1 if v[k] + DIFFERENCE_STEP * half > self._most[k] else 1)
            moved = v.copy()
            moved[k] += step
            there = self.rows(moved, seen)
            slopes.append({p: (b - a) * (half / step) for p, a, b in zip(seen, here, there, strict=True)})
        return dict(zip(seen, here, strict=True)), slopes

    def _determined(self, v: Array, lights: Array, seen: list[int], ridge: float) -> dict[str, float]:
        """Share of each parameter that the pictures determine against the ridge, by name."""
        names, free = self._names(), self._free(seen)
        if len(free):
            near = self._tables(v, seen)
            table = [(near.slopes @ np.append(lights, -1.0)).T, near.rows[:, :-1] * self._power.ravel()]
        else:
            table = [self.weighed(self.rows(v, seen), seen)[:, :-1] * self._power.ravel()]
        chosen = [*(names[k] for k in free), *names[len(v) :]]
        shares = dict(zip(chosen, map(float, determined(np.hstack(table), ridge)), strict=True))
        absent = self.sensor.camera.vignette_mm is None
        return {name: share for name, share in shares.items() if not (absent and name.startswith("vignette"))}
