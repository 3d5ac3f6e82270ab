"""A smoothed thin-plate spline over the plane, and distances between points of it."""

import numpy as np
from numpy.typing import NDArray

from tacgen.physics import interpolation, runtime

Floats = NDArray[np.float64]


def thin_plate(known: Floats, values: Floats, at: Floats, smoothing: float) -> tuple[Floats, Floats]:
    """The spline through values (n,) at known points (n, 2): what it is there, and at further points (m, 2).

    It is a plane plus the sum of c_i r_i^2 log(r_i), and at the known points the values less `smoothing` c (Wahba 1990,
    Spline Models for Observational Data, section 2.4).
    """
    n, middle = len(known), known.mean(axis=0)
    known, at = known - middle, at - middle
    system = np.zeros((n + 3, n + 3))
    system[:n] = _basis(known, known)
    system[n:, :n] = system[:n, n:].T
    system.ravel()[: n * (n + 3) : n + 4] += smoothing
    c = np.linalg.solve(system, np.append(values, np.zeros(3)))
    return values - smoothing * c[:n], np.asarray(_basis(at, known) @ c)


def _basis(at: Floats, known: Floats) -> Floats:
    """r^2 log(r) at points (m, 2) about known ones (n, 2), and a plane's three functions: (m, n + 3)."""
    out = np.empty((len(at), len(known) + 3))
    runtime.call(interpolation.plate, (len(at),), at, known, out.reshape(-1))
    return out


def distances(at: Floats, to: Floats, reach: float) -> Floats:
    """Distance (n,) from points (n, 2) to the nearest of others (m, 2); it may be infinite beyond twice `reach`."""
    box = np.array([to.min(axis=0) - 2 * reach, to.max(axis=0) + 2 * reach])
    out = np.empty(len(at))
    runtime.call(interpolation.distances, out.shape, at, to, box, out)
    return out
