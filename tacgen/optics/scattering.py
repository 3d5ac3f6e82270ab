"""A gel that scatters light over an opaque skin: its brightness follows the local thickness of the gel.

Light is scattered so often that slopes and shadows of a dent are hardly visible, but its thickness is. `Brightness` is
this dependence, tabulated by path tracing for gels of uniform thickness. Multiply scattered light spreads sideways, so
the relevant thickness is an average around the point, by a Gaussian filter (`averaged`, `fitted_reach`).
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen.optics.gaussian import blur
from tacgen.optics.surface_grid import Untouched
from tacgen.physics import filters, runtime

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from tacgen.sensor.model import Gel, ThicknessResponse

    Floats = NDArray[np.float64]

# tabulated thickness over untouched [-]
THICKNESS_SHARES = (0.04, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0, 1.1, 1.25, 1.45)
# standard deviation of a Gaussian over the side of the blocks to whose means it is applied [-]
GAUSSIAN_STD_PER_BLOCK = 4.0
CURVE_POINTS = 8192  # points of a tabulated curve
CALIBRATION_DENT = (1.6, 0.9)  # radii of ball and contact circle over the thickness, of the dent for `fitted_reach` [-]


@dataclass(frozen=True)
class UniformFace:
    """The face of a gel of uniform thickness, `share` of the untouched one."""

    gel: "Gel"
    share: float

    def at(self, xy: Any) -> "Floats":
        """Current positions (n, 3) [mm] of rest positions (n, 2) [mm]."""
        xy = np.asarray(xy, dtype=np.float64)
        base, clear = depths(self.gel)
        return np.column_stack([xy, np.full(len(xy), self.share * clear - base)])


@dataclass(frozen=True)
class Brightness:
    """Brightness (k, 3) of gels of uniform thickness, given as shares (k,) of the untouched one; 1 at share 1."""

    shares: "Floats"
    values: "Floats"

    @classmethod
    def through(cls, shares: "Floats", radiance: "Floats") -> "Brightness":
        """From radiances (k, 3) traced at `shares`, smoothed by a quartic of the logarithms to remove their noise."""
        u = np.log(shares)
        smooth = np.column_stack([np.polyval(np.polyfit(u, np.log(c), 4), u) for c in radiance.T])
        one = np.column_stack([np.interp(0.0, u, c) for c in smooth.T])
        return cls(shares, np.exp(smooth - one))

    @cached_property
    def tabulated(self) -> "Tabulated":
        """The brightness as a table, which whole pictures are read from faster."""
        return Tabulated.of(self.at, self.shares[0], self.shares[-1])

    def at(self, share: "Floats") -> "Floats":
        """Brightness (n, 3) where the gel is `share` (n,) of its untouched thickness."""
        return interpolated(np.log(np.maximum(share, 1e-3)), np.log(self.shares), np.log(self.values), np.exp)


def thickness(gel: "Gel", position: "Floats") -> "Floats":
    """Share (n,) of its untouched thickness that the gel has at points (n, 3) [mm] of its face; 1 off the pad."""
    base = -depths(gel)[0]
    share = position[:, 2] - base
    share /= Untouched.of(gel).height(position[:, :2]) - base
    return np.nan_to_num(share, copy=False, nan=1.0)


def averaged(share: "Floats", reach: float) -> "Floats":
    """The relevant thickness (h, w): averaged by a Gaussian of standard deviation `reach` [px].

    A wide one is applied to means over blocks of n x n pixels, whose result is spread by cubic B-splines. Each of the
    three adds its variance, (n^2 - 1) / 12 and n^2 / 3 [px^2] besides the filter's own.
    """
    n = max(1, int(reach / GAUSSIAN_STD_PER_BLOCK))
    if n == 1:
        return blur(share[..., None], reach, truncate=3.0)[..., 0]
    own = np.sqrt(reach**2 - (n * n - 1) / 12 - n * n / 3) / n
    means = np.empty([2 * filters.MARGIN_BLOCKS - (-side // n) for side in share.shape])
    runtime.call(filters.means, means.shape[:1], share, n, means)
    coarse = blur(means[..., None], own, truncate=3.0)[..., 0]
    down, out = np.empty((len(share), means.shape[1])), np.empty(share.shape)
    runtime.call(filters.spread, out.shape[:1], coarse, _splines(n), down, out)
    return out


def fitted_reach(bright: Brightness, share: "Floats", mm_per_px: float, ratio: "Floats") -> float:
    """The `reach` [mm] of `averaged` that best fits a traced image (h, w, 3) over the untouched one, nan left out.

    The traced image is too noisy to fit more than this one number.
    """
    from scipy.optimize import least_squares

    there = np.isfinite(ratio).all(axis=2)

    def left(q: "Floats") -> "Floats":
        made = bright.at(averaged(share, float(q[0]) / mm_per_px)[there])
        return np.asarray((made - ratio[there]).mean(axis=1))

    return float(least_squares(left, [1.0], bounds=(0.05, 20.0), diff_step=0.02).x[0])


def interpolated(x: "Floats", known: "Floats", values: "Floats", then: Any = np.asarray) -> "Floats":
    """`then` of each column of `values` (k, 3) interpolated at x (n,) without overshoot, constant beyond its ends."""
    from scipy.interpolate import PchipInterpolator

    return np.asarray(then(PchipInterpolator(known, values)(np.clip(x, known[0], known[-1]))))


def depths(gel: "Gel") -> tuple[float, float]:
    """Crown to base, and opaque skin to base [mm]."""
    total, clear = (sum(layer.thickness_mm for layer in layers) for layers in (gel.layers, gel.clear_layers))
    return total, clear


@dataclass(frozen=True)
class Tabulated:
    """A smooth curve with three values, tabulated so finely that linear interpolation is right to 1e-6."""

    first: float
    step: float
    values: "Floats"  # (CURVE_POINTS, 3)

    @classmethod
    def of(cls, curve: "Callable[[Floats], Floats]", first: float, last: float) -> "Tabulated":
        """The table of `curve` (n,) -> (n, 3) between two ends, beyond which it is constant."""
        return cls(first, (last - first) / (CURVE_POINTS - 1), curve(np.linspace(first, last, CURVE_POINTS)))

    def at(self, x: "Floats") -> "Floats":
        """Values (n, 3) at x (n,); 1 where it is nan."""
        out = np.empty((len(x), 3))
        runtime.call(filters.tabulated, x.shape, x, self.first, self.step, self.values, out)
        return out


@lru_cache(maxsize=4)
def tabulated(response: "ThicknessResponse") -> Tabulated:
    """`gain`, for whole pictures."""
    return Tabulated.of(partial(gain, response), response.change_mm[0], response.change_mm[-1])


def _splines(n: int) -> "Floats":
    """Weights (n, 4) at each of n pixels along a block of the cubic B-splines of the four blocks that reach it."""
    f = ((np.arange(n) + 0.5) / n - 0.5) % 1.0  # from the nearest block's centre before the pixel
    g = 1.0 - f
    return np.column_stack([g**3 / 6, 2 / 3 - f * f * (2 - f) / 2, 2 / 3 - g * g * (2 - g) / 2, f**3 / 6])


def gains(response: "ThicknessResponse", change: "Floats", mm_per_px: float) -> "Floats":
    """The fitted response's gain (h, w, 3) in a picture whose gel is `change` (h, w) [mm] thicker than untouched."""
    return spread(tabulated(response).at(change.ravel()).reshape(*change.shape, 3), response.spread_mm / mm_per_px)


def spread(gain: "Floats", reach: float, across: float | None = None) -> "Floats":
    """A picture of gains (h, w, k) averaged by a Gaussian of standard deviation `reach` [px], and `across` if that is
    another one."""
    return blur(gain, reach, 3.0, across) if reach else gain


def gain(response: "ThicknessResponse", change: "Floats") -> "Floats":
    """The fitted response's gain (n, 3) where the gel is `change` (n,) [mm] thicker than untouched; 1 off the pad."""
    return np.nan_to_num(interpolated(change, np.array(response.change_mm), np.array(response.gain)), nan=1.0)
