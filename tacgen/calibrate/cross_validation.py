"""A sensor fitted to photographs: its misfits, its judgement by presses that the fit has not seen, and how much of each
parameter the photographs determine."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.calibrate.photos import PhotographedPress
from tacgen.calibrate.render_comparison import ChangeLikeness, Likeness
from tacgen.optics.surface_grid import Surface
from tacgen.render.images import Renderer
from tacgen.report import fit_figures
from tacgen.sensor.model import LitSensor

Array = np.ndarray
DRAWN, FIGURE_SPP = 6, 16  # presses in the figure; samples a pixel, of gels that scatter light
MAX_LEAVE_ONE_OUT_PRESSES = 5  # up to so many presses each is left out once
SCORE_SCATTER_DEG = 0.1  # scatter of the difference of two files' errors of normals, over seeds [deg]
HOLD_OUT_INTERVAL = 3  # of more, every third is held out, in each of the three ways
MIN_GAIN_SHARE = 0.1  # of the error before: smaller gains come and go with the choice of the presses


def folds(presses: int) -> list[list[int]]:
    """Numbers, from 1, of the presses that are held out together, a list for each fit; none below two presses."""
    if presses < 2:
        return []
    count = presses if presses <= MAX_LEAVE_ONE_OUT_PRESSES else HOLD_OUT_INTERVAL
    return [list(range(first, presses + 1, count)) for first in range(1, count + 1)]


@dataclass(frozen=True)
class HeldOutPresses:
    """Scores of a sensor file and of fits on presses that those fits have not seen."""

    presses: tuple[PhotographedPress, ...]
    faces: tuple[Surface, ...]
    sensors: tuple[LitSensor, ...]  # the fit that has not seen the press, a press each
    counts: Array  # misfit of the change of the picture, rms, before and after (2, presses) [counts]
    likeness: tuple[Likeness, Likeness] | tuple[ChangeLikeness, ChangeLikeness] | None  # before, after

    @property
    def degrees(self) -> Array | None:
        """Error of normals in the photographs, before and after (2, presses) [deg]; None without contact circles."""
        if self.likeness is None or not isinstance(self.likeness[0], Likeness):
            return None
        return np.array([like.each for like in self.likeness if isinstance(like, Likeness)])

    @property
    def better(self) -> bool:
        """Whether the fit helps: the mean gain is MIN_GAIN_SHARE of the error at least and exceeds its standard error,
        of normals where they are known, together with what two networks differ by, else of counts, and the counts do
        not rise by more than theirs."""
        scores = self.counts if self.degrees is None else self.degrees
        gain, error = _gain(scores)
        alone = 0.0 if self.degrees is None else SCORE_SCATTER_DEG
        enough = gain >= MIN_GAIN_SHARE * scores[0].mean()
        return bool(enough and gain > np.hypot(error, alone) and not self.lost)

    @property
    def lost(self) -> bool:
        """Whether the counts rise by more than their standard error: then no error of normals makes the fit better."""
        gain, error = _gain(self.counts)
        return gain < -error

    def __str__(self) -> str:
        parts = [] if self.degrees is None else [_change(self.degrees, "deg error of normals")]
        return ", ".join([*parts, _change(self.counts, "counts rms")])

    def score(self, number: int, press: int) -> str:
        """Scores of one press as text; `number`: 0 before the fit, 1 after."""
        counts = f"{self.counts[number, press]:.1f} counts"
        return counts if self.degrees is None else f"{self.degrees[number, press]:.1f} deg, {counts}"

    def plain(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            "presses": [press.name for press in self.presses], "better": self.better, "counts": self.counts.tolist(),
            "degrees": None if self.degrees is None else self.degrees.tolist(),
            "likeness": [like.plain() for like in self.likeness or ()],
        }  # fmt: skip

    def draw(self, sensor: LitSensor, untouched: Array, out: Path) -> None:
        """Draw presses into `out`: photographed, rendered with the `sensor` before the fit, and with the fit.

        `untouched`: photograph (H, W, 3), 8 bit.
        """
        before, rows = Renderer(sensor, FIGURE_SPP, 0, markers=False), []
        for k, (press, face) in enumerate(zip(self.presses[:DRAWN], self.faces, strict=False)):
            after = Renderer(self.sensors[k], FIGURE_SPP, 0, markers=False)
            titles = [press.name, f"before: {self.score(0, k)}", f"after: {self.score(1, k)}"]
            shown = [(press.picture, untouched)]
            shown += [(r.develop(r.image(face)), r.develop(r.flat())) for r in (before, after)]
            rows.append([(title, *pair) for title, pair in zip(titles, shown, strict=True)])
        fit_figures.pictures(rows, f"{sensor.name}, presses that the fit has not seen: {self}", out)


@dataclass(frozen=True)
class Fitted:
    """A fitted sensor; misfits are rms in 8-bit counts."""

    sensor: LitSensor
    untouched: float
    before: float  # the same before the fit
    presses: float | None = None  # of the change under the presses, all of them seen by this fit
    deeper: float = 1.0  # factor on all given depths
    unseen: HeldOutPresses | None = None  # None: too few presses to hold any out
    ridge: float | None = None  # weight of the sensor file's values that suits unseen presses best
    determined: Mapping[str, float] = field(default_factory=dict)  # share of each parameter, see `determined`
    interrupted: str = ""  # what Ctrl-C has left out
    drift: float = 0.0  # between the photograph of the untouched sensor and those of presses, which is left out


def _gain(scores: Array) -> tuple[float, float]:
    """Mean over presses of what a score (2, presses) falls by, and the standard error of that mean."""
    gains = scores[0] - scores[1]
    return float(gains.mean()), float(gains.std(ddof=1) / np.sqrt(len(gains)))


def _change(scores: Array, unit: str) -> str:
    before, after = scores.mean(axis=1)
    return f"{before:.1f} before and {after:.1f} after the fit [{unit}]"


def determined(slopes: Array, ridge: float) -> Array:
    """Share (n,), from 0 to 1, of each parameter that data determine, the rest being held by a ridge.

        1 - r^2 [(J^T J + r^2 I)^-1]_ii

    Args:
        slopes: J, derivatives of the residuals by parameters that are scaled as the ridge sees them, (residuals, n).
        ridge: r, residual of a parameter that is off by 1; > 0.
    """
    within = slopes.T @ slopes + ridge**2 * np.eye(slopes.shape[1])
    return np.asarray(np.clip(1 - ridge**2 * np.diag(np.linalg.inv(within)), 0, 1))


def rms(parts: list[Array]) -> float:
    """Root mean square over arrays of any shapes."""
    return float(np.sqrt(np.mean(np.concatenate([p.ravel() for p in parts]) ** 2)))


def rgb(row: Array) -> tuple[float, float, float]:
    """Three plain numbers."""
    return float(row[0]), float(row[1]), float(row[2])
