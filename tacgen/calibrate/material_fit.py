"""Modulus, zero of depth, a second parameter and relaxation from measured forces, with confidence intervals.

    F(t) = m [C(d + z; p) + sum_i beta_i H_i],    dH_i/dt + H_i/tau_i = dC/dt,    beta_i = g_i/(1 - sum_j g_j)

C is the force that the sensor file's gel gives when pressed infinitely slowly. Forces are proportional to the moduli of
all layers together, so m needs no other solve. H_i is quasi-linear viscoelasticity (Fung 1972): the contact is taken
to grow as it would in the elastic gel.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.special import exprel
from scipy.stats import t as student

from tacgen.calibrate.force_curves import FIRST_TOUCH_RANGE, Curves, Measured
from tacgen.calibrate.sensor_fit import off
from tacgen.sensor.yaml_source import KeyPath, format_path

Array = np.ndarray
CONFIDENCE_LEVEL = 0.95  # probability of the confidence intervals
# tried ratios of constant error (over the largest force) to relative error
ERROR_RATIOS = (0.01, 0.03, 0.1, 0.3, 1.0, 10.0)
USUAL_ERROR_RATIO = 0.1  # this ratio if there are too few rows to estimate it
REWEIGHTED_FITS = 3  # reweighted fits, each with the forces of the one before
INTERVALS_PER_ROW = 8  # intervals between two rows; in each the elastic force changes at a constant rate
MAX_RELAXED_SUM = 0.95  # largest sum of g over all terms
# smallest change of the forces over a range, in their errors, that is no rounding of differences
MIN_SEEN_CHANGE = 1e-5
MAX_UNSEEN_SHARE = 0.1  # share of a number in a direction that the forces do not show, from which it is not determined
MAX_MODULUS_FACTOR = 1e3  # largest factor on the moduli, and its inverse the smallest


@dataclass(frozen=True)
class Estimate:
    """A parameter and its confidence interval of probability CONFIDENCE_LEVEL."""

    name: str
    value: float
    low: float
    high: float
    bound: bool = False  # at the end of its range, without an interval
    open: bool = False  # not determined: the interval is as wide as the range

    def told(self, name: str, unit: str) -> str:
        """The value and its interval as text, with the `unit` after the value."""
        reach = "at the end of its range" if self.bound else f"95 %: {self.low:.4g} to {self.high:.4g}"
        return f"{name}: {self.value:.4g}{unit} ({reach})"

    @property
    def times(self) -> str:
        """A factor with its interval as text."""
        return f"times {self.value:.4g} ({self.low:.3g} to {self.high:.3g} with {100 * CONFIDENCE_LEVEL:.0f} %)"

    def told_of(self, changes: Mapping[KeyPath, Any]) -> Iterator[str]:
        """Each changed modulus with its interval, as `told`: this estimate is the factor that it contains."""
        for path, value in changes.items():
            if str(path[-1]).endswith("_mpa"):
                low, high = (value * end / self.value for end in (self.low, self.high))
                yield replace(self, value=value, low=low, high=high).told(format_path(path), " MPa")


@dataclass(frozen=True)
class MaterialFit:
    """Estimates, their correlation (k, k), and the fitted forces (n,) [N] beside the measured ones."""

    estimates: tuple[Estimate, ...]
    correlation: Array
    force: Array
    measured: Measured

    def __getitem__(self, name: str) -> float:
        return self.estimate(name).value

    def estimate(self, name: str) -> Estimate:
        """The parameter of this name."""
        return next(estimate for estimate in self.estimates if estimate.name == name)

    @property
    def off(self) -> Array:
        """Relative error of the fitted forces (n,), as of `sensor_fit.off`."""
        return off(self.force, self.measured.force)

    @property
    def worst(self) -> float:
        """The largest of `off`."""
        return float(np.abs(self.off).max())


@dataclass(frozen=True)
class Unknown:
    """An unknown of a fit with its start and range, and its conversion for display."""

    name: str
    start: float
    low: float
    high: float
    shown: Callable[[float], float] = float


def modulus_unknown(start: float) -> Unknown:
    """The factor on the moduli, fitted as its logarithm, from a start value that is limited to the range."""
    inside, end = np.clip(start, 2 / MAX_MODULUS_FACTOR, MAX_MODULUS_FACTOR / 2), float(np.log(MAX_MODULUS_FACTOR))
    return Unknown("modulus", float(np.log(inside)), -end, end, np.exp)


def modulus_in_range(factor: float) -> bool:
    """Whether a factor on the moduli is not near an end of its range."""
    return 2 / MAX_MODULUS_FACTOR < factor < MAX_MODULUS_FACTOR / 2


def fit(
    curves: Curves, measured: Measured, *, zero: bool = True, value: float | None = None, terms: int = 0
) -> MaterialFit:
    """Weighted least squares; the error of a force has a constant part and a part proportional to the force.

    Args:
        zero: look for the zero of depth: first touch lies that much [mm] above where the table has it.
        value: of the second parameter, or None to look for it; without meaning where the curves have none.
        terms: of a Prony series; the table then has times.

    Raises ValueError: fewer rows than numbers to find, and one more.
    """
    margin = FIRST_TOUCH_RANGE * float(measured.depth.max())
    unknowns = [modulus_unknown(1.0)]
    if zero:
        unknowns.append(Unknown("zero", 0.0, -margin, margin))
    if curves.values is not None and value is None:
        low, high = float(curves.values[0]), float(curves.values[-1])
        unknowns.append(Unknown("second", (low + high) / 2, low, high))
    if terms:
        assert measured.time is not None
        steps = np.diff(measured.time, prepend=0.0)
        shortest, longest = float(steps[steps > 0].min()), float(measured.time[-1])
        for i, tau in enumerate(np.geomspace(shortest, longest, terms + 2)[1:-1], 1):
            unknowns.append(Unknown(f"g{i}", 0.1 / terms, 0.0, MAX_RELAXED_SUM / terms))
            unknowns.append(Unknown(f"tau{i}", np.log(tau), np.log(shortest / 3), np.log(3 * longest), np.exp))
    if len(measured.depth) <= len(unknowns):
        raise ValueError(f"{len(measured.depth)} rows are too few to find {len(unknowns)} numbers and their bounds")
    names = [unknown.name for unknown in unknowns]

    def force(v: Array) -> Array:
        at = dict(zip(names, v, strict=True))
        second = at.get("second", value if value is not None else 0.0)
        series = [(at[f"g{i}"], np.exp(at[f"tau{i}"])) for i in range(1, terms + 1)]
        return np.asarray(np.exp(at["modulus"]) * relaxing(curves, measured, at.get("zero", 0.0), second, series))

    model = force(np.array([unknown.start for unknown in unknowns]))
    best = float(model @ measured.force) / max(float(model @ model), 1e-300)  # modulus with all others fixed
    unknowns[0] = modulus_unknown(best)
    estimates, correlation, at = estimated(force, measured.force, unknowns)
    return MaterialFit(estimates, correlation, force(at), measured)


def estimated(
    force: Callable[[Array], Array], wanted: Array, unknowns: Sequence[Unknown], doubt: Array | float = 1.0
) -> tuple[tuple[Estimate, ...], Array, Array]:
    """Weighted least squares of forces (n,) [N] over k < n unknowns: estimates, their correlation (k, k), values (k,).

    The error of a force has a constant part and a part proportional to the force; their ratio is estimated. `doubt`
    (n,): factors on the errors.
    """
    start, low, high = np.array([[u.start, u.low, u.high] for u in unknowns]).T
    spare = len(wanted) - len(unknowns)
    choices = ERROR_RATIOS if spare > len(ERROR_RATIOS) else (USUAL_ERROR_RATIO,)
    tried = [_weighted(force, wanted, (start, low, high), even, doubt) for even in choices]
    best = min(tried, key=lambda one: one.unlikely)
    free = best.free
    covariance = _averaged(best, tried)[np.ix_(free, free)]
    half, spread = np.zeros(len(unknowns)), np.sqrt(np.diag(covariance))
    half[free] = student.ppf((1 + CONFIDENCE_LEVEL) / 2, spare - (len(choices) > 1)) * spread
    unclear = best.unseen | ((best.at - half <= low) & (best.at + half >= high))
    shown = np.column_stack([low - (high - low), high + (high - low)])  # exp overflows far beyond
    estimates = []
    for k, u in enumerate(unknowns):
        x, down, up = (float(u.shown(v)) for v in np.clip(best.at[k] + half[k] * np.array([0, -1, 1]), *shown[k]))
        estimates.append(Estimate(u.name, x, down, up, not free[k], bool(unclear[k])))
    correlation = np.eye(len(unknowns))  # unknown for parameters at the end of their range
    correlation[np.ix_(free, free)] = covariance / np.maximum(np.outer(spread, spread), 1e-300)
    np.fill_diagonal(correlation, 1.0)  # also where the fit is exact and the spread 0
    return tuple(estimates), correlation, best.at


def relaxing(
    curves: Curves, measured: Measured, zero: float, second: float, series: list[tuple[float, float]]
) -> Array:
    """F/m (n,) [N] at the rows of a table, with g and tau [s] of each term. The depth is linear in time between rows,
    from first touch at 0 s."""
    if not series:
        return curves.force(measured.depth + zero, second)
    assert measured.time is not None
    parts = np.linspace(0, 1, INTERVALS_PER_ROW + 1)[1:]

    def between(rows: Array, first: float) -> Array:
        before = np.concatenate([[first], rows[:-1]])
        return np.asarray((before[:, None] + (rows - before)[:, None] * parts).ravel())

    elastic = curves.force(between(measured.depth, -zero) + zero, second)
    r = np.diff(between(measured.time, 0.0), prepend=0.0)[:, None] / np.array([tau for _, tau in series])
    decay, fresh = np.exp(-r), exprel(-r) * np.diff(elastic, prepend=0.0)[:, None]
    memory = np.zeros_like(fresh)
    H = np.zeros(len(series))
    for k in range(len(memory)):
        H = memory[k] = decay[k] * H + fresh[k]
    g = np.array([share for share, _ in series])
    return np.asarray((elastic + memory @ (g / (1 - g.sum())))[INTERVALS_PER_ROW - 1 :: INTERVALS_PER_ROW])


@dataclass(frozen=True)
class _Weighted:
    """A fit for one ratio of ERROR_RATIOS: unknowns (k,), which of them are `free` inside their bounds and which of
    these are `unseen` in the forces, covariance (k, k), 0 for those at their bounds, and minus the logarithm of the
    restricted likelihood (Patterson & Thompson 1971)."""

    at: Array
    free: Array
    unseen: Array
    covariance: Array
    unlikely: float


def _weighted(
    force: Callable[[Array], Array], wanted: Array, ranges: tuple[Array, Array, Array], even: float,
    doubt: Array | float,
) -> _Weighted:  # fmt: skip
    """The fit for one ratio of the errors. `ranges`: start, lower and upper bound of each unknown."""
    (start, low, high), at = ranges, wanted
    for _ in range(REWEIGHTED_FITS):
        error = doubt * np.hypot(even * wanted.max(), at)
        solution = least_squares(partial(_residual, force, wanted, error), start, bounds=(low, high), xtol=1e-12)
        start, at = np.clip(solution.x, low + 1e-9, high - 1e-9), force(solution.x)
    free = solution.active_mask == 0
    span, spare = (high - low)[free], len(wanted) - len(start)
    _, size, axes = np.linalg.svd(solution.jac[:, free] * span, full_matrices=False)
    unseen = np.zeros(len(start), bool)
    unseen[free] = (np.abs(axes[size < MIN_SEEN_CHANGE]) > MAX_UNSEEN_SHARE).any(axis=0)
    size = np.maximum(size, MIN_SEEN_CHANGE)
    spread = axes.T / size * span[:, None]
    covariance = np.zeros((len(start),) * 2)
    covariance[np.ix_(free, free)] = spread @ spread.T * 2 * solution.cost / spare
    volume = np.log(span).sum() - np.log(size).sum()  # half the log determinant of the inverse
    unlikely = spare * np.log(solution.cost + 1e-300) / 2 + np.log(error).sum() - volume
    return _Weighted(solution.x, free, unseen, covariance, float(unlikely))


def _averaged(best: _Weighted, tried: list[_Weighted]) -> Array:
    """Covariance (k, k) about the best fit, averaged over all ratios of ERROR_RATIOS by their likelihoods."""
    likely = np.exp([best.unlikely - one.unlikely for one in tried])
    apart = [one.covariance + np.outer(one.at - best.at, one.at - best.at) for one in tried]
    return np.asarray(np.tensordot(likely / likely.sum(), apart, 1))


def _residual(force: Callable[[Array], Array], wanted: Array, error: Array, v: Array) -> Array:
    return np.asarray((force(v) - wanted) / error)
