"""A gel that scatters light over an opaque skin: its brightness follows the local thickness of the gel.

Light is scattered so often that slopes and shadows of a dent are hardly visible, but its thickness is. `Brightness` is
this dependence, tabulated by path tracing for gels of uniform thickness. Multiply scattered light spreads sideways, so
the relevant thickness is an average around the point, by a Gaussian filter (`felt`, `wander`).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen.optics.surface_grid import Untouched

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.optics.description import Gel, ThicknessResponse

    Floats = NDArray[np.float64]

SHARES = (0.04, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0, 1.1, 1.25, 1.45)  # thickness over untouched, in the table [-]
DENT = (1.6, 0.9)  # radii of ball and contact circle over the thickness, for the dent that determines `wander` [-]


@dataclass(frozen=True)
class Even:
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
        """From radiances (k, 3) traced at `shares`, smoothed by a cubic in log radiance to remove their noise."""
        u = np.log(shares)
        smooth = np.column_stack([np.polyval(np.polyfit(u, np.log(c), 4), u) for c in radiance.T])
        one = np.column_stack([np.interp(0.0, u, c) for c in smooth.T])
        return cls(shares, np.exp(smooth - one))

    def at(self, share: "Floats") -> "Floats":
        """Brightness (n, 3) where the gel is `share` (n,) of its untouched thickness."""
        return between(np.log(np.maximum(share, 1e-3)), np.log(self.shares), np.log(self.values), np.exp)


def thickness(gel: "Gel", position: "Floats") -> "Floats":
    """Share (n,) of its untouched thickness that the gel has at points (n, 3) [mm] of its face; 1 off the pad."""
    base = -depths(gel)[0]
    before = Untouched.of(gel).at(position[:, :2])[:, 2]
    return np.nan_to_num((position[:, 2] - base) / (before - base), nan=1.0)


def felt(share: "Floats", reach: float) -> "Floats":
    """The relevant thickness (h, w): averaged by a Gaussian of standard deviation `reach` [px]."""
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(share, reach, mode="nearest", truncate=3.0))


def wander(bright: Brightness, share: "Floats", mm_per_px: float, ratio: "Floats") -> float:
    """The `reach` [mm] of `felt` that best fits a traced image (h, w, 3) over the untouched one.

    The noise of the traced image does not allow to fit more than this one number.
    """
    from scipy.optimize import least_squares

    def left(q: "Floats") -> "Floats":
        made = bright.at(felt(share, float(q[0]) / mm_per_px).ravel())
        return np.asarray((made - ratio.reshape(-1, 3)).mean(axis=1))

    return float(least_squares(left, [1.0], bounds=(0.05, 20.0), diff_step=0.02).x[0])


def between(x: "Floats", known: "Floats", values: "Floats", then: Any = np.asarray) -> "Floats":
    """`then` of each column of `values` (k, 3) interpolated at x (n,) without overshoot, constant beyond its ends."""
    from scipy.interpolate import PchipInterpolator

    return np.asarray(then(PchipInterpolator(known, values)(np.clip(x, known[0], known[-1]))))


def depths(gel: "Gel") -> tuple[float, float]:
    """Crown to base, and opaque skin to base [mm]."""
    total, clear = (sum(layer.thickness_mm for layer in layers) for layers in (gel.layers, gel.clear_layers))
    return total, clear


def gain(response: "ThicknessResponse", change: "Floats") -> "Floats":
    """The fitted response's gain (n, 3) where the gel is `change` (n,) [mm] thicker than untouched; 1 off the pad."""
    return np.nan_to_num(between(change, np.array(response.change_mm), np.array(response.gain)), nan=1.0)
