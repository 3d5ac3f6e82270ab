"""Fit the dome of sensors/digit.yaml to DIGIT's probe table (py3DCal): `python scripts/fit_digit_dome.py TABLE.csv`.

The table holds depths on a 0.5 mm grid, x across and y along the finger, 0 wherever the probe's frame has it: aligned
are its middle with the crown, in plan, and its level. z = level - hypot(x^2 / 2 radius_x, y^2 / 2 radius_y).
"""

import argparse
from pathlib import Path

import numpy as np


def probe(table: Path) -> tuple[np.ndarray, np.ndarray]:
    """Places (n, 2) [mm] about the middle of the table, and the depth (n,) [mm] of the face there."""
    rows = np.loadtxt(table, delimiter=",", comments="#")
    return rows[:, :2] - (rows[:, :2].min(0) + rows[:, :2].max(0)) / 2, rows[:, 2]


def fit(xy: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(level, radius_x, radius_y) [mm] by least squares, and what is left (n,) [mm]."""
    from scipy.optimize import least_squares

    def left(q: np.ndarray) -> np.ndarray:
        return q[0] + np.hypot(*(xy**2 / (2 * q[1:])).T) - depth

    found = least_squares(left, [depth.min(), 30.0, 60.0], x_scale=[1.0, 10.0, 10.0])
    return found.x, found.fun


if __name__ == "__main__":
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("table", type=Path)
    (level, rx, ry), left = fit(*probe(asked.parse_args().table))
    print(
        f"level {level:.3f} mm, radius_x_mm {rx:.2f}, radius_y_mm {ry:.2f}; off by at most {np.abs(left).max():.4f} mm"
    )
