"""Fits of trial sensors with a clear gel to photographs, by equations that are linear in the radiances.

The equations are made with their derivatives by the other parameters, solved (see robust_search), and made anew there.
All fits begin with those at the file's parameters, which are made once.
"""

from functools import cached_property

import numpy as np

from tacgen.calibrate import robust_search
from tacgen.calibrate.clear_trials import Trials
from tacgen.calibrate.result import Fitted, rms
from tacgen.calibrate.robust_search import Ridge, Tables
from tacgen.calibrate.unseen import determined
from tacgen.sensor.model import LitSensor

Array = np.ndarray
RIDGES = (300.0, 30.0, 3.0)  # tried penalties of a parameter at the end of its tolerance, over all pixels [counts]
SOFT = 15.0  # scale of the soft-l1 loss, for marks and dust [counts]
CLOSE, LITTLE = 0.02, 2e-3  # change of half a range, and gain of the loss, below which no further table is made
DIFFERENCE = 0.02  # of half a range: step of the difference quotients


class Fits(Trials):
    """Fits to all photographs, and to all but some that judge them."""

    def whole(self, ridge: float, steps: int) -> Fitted:
        """The fit to all pictures, by the method of the fits that judge it; at most `steps` tables for each ridge."""
        every, begin = list(range(len(self.pictures))), self._start
        for hold in RIDGES[: RIDGES.index(ridge) + 1]:
            begin, lights = self._search(begin, every, hold, steps)
        rows = self.rows(self.all_columns(begin, every), every)
        misfits = self.misfits(rows, lights)
        shown = self.misfits(self.rows([self.columns(self._start, 0)], [0]), self.own)
        return Fitted(
            self._sensor(begin, lights), rms(misfits[:1]), rms(shown), rms(misfits[1:]) if len(every) > 1 else None,
            ridge=ridge, determined=self._determined(begin, lights, every, ridge),
        )  # fmt: skip

    def judged(self, groups: list[list[int]], steps: int) -> tuple[Array, list[list[LitSensor]]]:
        """Misfit of presses that are not seen [counts], of the file and then of fits with each of RIDGES, (1 + RIDGES,
        presses); and those fits by ridge, then by group."""
        counts: list[list[float]] = [[] for _ in range(1 + len(RIDGES))]
        made: list[list[LitSensor]] = [[] for _ in RIDGES]
        for held_out in groups:
            seen = [k for k in range(len(self.pictures)) if k not in held_out]
            v, lights = self._start, self.own
            for number in range(1 + len(RIDGES)):
                if number:
                    ridge = RIDGES[number - 1]
                    v, lights = self._search(v, seen, ridge, steps)
                    made[number - 1].append(self._sensor(v, lights))
                left = self.misfits(self.rows(self.all_columns(v, [0, *held_out]), held_out), lights)
                counts[number] += [rms([one]) for one in left]
        return np.array(counts), made

    def _free(self, seen: list[int]) -> Array:
        """Numbers of the parameters that vary; a background and one press determine only radiances."""
        return np.flatnonzero(self._most > self._least) if len(seen) > 2 else np.zeros(0, int)

    def _search(self, begin: Array, seen: list[int], ridge: float, steps: int) -> tuple[Array, Array]:
        """The parameters and radiances with the smallest loss of some pictures, by equations that are made anew, with
        their derivatives, at most `steps` times."""
        free = self._free(seen)
        v, lights = begin, self.lights(self.rows(self.all_columns(begin, seen), seen), seen, ridge)
        if not len(free):
            return v, lights
        half, hold = self._half(free), Ridge(ridge, self.own.ravel(), self._power.ravel())
        bounds = (self._least - self._start)[free] / half, (self._most - self._start)[free] / half

        def cost(v: Array, lights: Array) -> float:
            off = self.weighed(self.rows(self.all_columns(v, seen), seen), seen) @ np.append(lights, -1.0)
            return robust_search.loss(off, SOFT) + robust_search.held((v - self._start)[free] / half, lights, hold)

        now = cost(v, lights.ravel())
        for _ in range(steps):
            near = self._tables(v, seen)
            u, found = robust_search.search(near, lights.ravel(), bounds, hold, SOFT)
            for share in robust_search.SHARES:  # a shorter step where the linear equations are inaccurate
                tried = v.copy()
                tried[free] += share * half * (u - near.at)
                some = lights.ravel() + share * (found - lights.ravel())
                if (then := cost(tried, some)) < now:
                    break
            else:
                break
            v, lights, gained, now = tried, some.reshape(lights.shape), now - then, then
            if share * np.abs(u - near.at).max() < CLOSE or gained < LITTLE * now:
                break
        return v, lights

    def _half(self, free: Array) -> Array:
        """Half the ranges of parameters."""
        return np.asarray((self._most - self._least)[free] / 2)

    def _tables(self, v: Array, seen: list[int]) -> Tables:
        """The weighed equations of some pictures for the radiances, and their derivatives by the free parameters."""
        free = self._free(seen)
        rows, slopes = self._kept_start if np.array_equal(v, self._start) else self._derived(v, seen)
        return Tables(
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
        here, slopes = self.rows(self.all_columns(v, seen), seen), []
        for k, half in zip(free, self._half(free), strict=True):
            step = DIFFERENCE * half * (-1 if v[k] + DIFFERENCE * half > self._most[k] else 1)
            moved = v.copy()
            moved[k] += step
            there = self.rows(self.all_columns(moved, seen), seen)
            slopes.append({p: (b - a) * (half / step) for p, a, b in zip(seen, here, there, strict=True)})
        return dict(zip(seen, here, strict=True)), slopes

    def _determined(self, v: Array, lights: Array, seen: list[int], ridge: float) -> dict[str, float]:
        """Share of each parameter that the pictures determine against the ridge, by name."""
        by, names = np.append(lights, -1.0), self._names()
        if len(free := self._free(seen)):
            near = self._tables(v, seen)
            rows, slopes = near.rows, (near.slopes @ by).T
        else:
            rows, slopes = self.weighed(self.rows(self.all_columns(v, seen), seen), seen), None
        scaled = rows[:, :-1] * self._power.ravel()
        table = scaled if slopes is None else np.column_stack([slopes, scaled])
        chosen = [*(names[k] for k in free), *names[len(v) :]]
        shares = dict(zip(chosen, map(float, determined(table, ridge)), strict=True))
        absent = self.sensor.camera.vignette_mm is None
        return {name: share for name, share in shares.items() if not (absent and name.startswith("vignette"))}
