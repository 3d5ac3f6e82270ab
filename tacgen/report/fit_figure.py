"""Figure of measured and fitted forces."""

from pathlib import Path

import numpy as np

from tacgen.report.bundle_figure import save

Array = np.ndarray


def draw(depth: Array, measured: Array, fitted: Array, off: Array, out: Path) -> None:
    """Plot forces [N] and the relative error `off` of the fit over depth [mm], each (n,), into `out`.

    Raises UserError: the suffix of `out` is not an image format.
    """
    from matplotlib.figure import Figure

    sheet = Figure(figsize=(5.2, 4.6), layout="constrained")
    forces, errors = sheet.subplots(2, sharex=True, height_ratios=(2, 1))
    forces.plot(depth, fitted, color="#0072b2", label="fitted")
    forces.plot(depth, measured, "o", color="#d55e00", markersize=4, label="measured")
    forces.set_ylabel("force [N]")
    forces.legend()
    errors.axhline(0, color="#888888", linewidth=0.8)
    errors.plot(depth, 100 * off, "o-", color="#0072b2", markersize=4)
    errors.set(xlabel="depth [mm]", ylabel="fitted less\nmeasured [%]")
    save(sheet, out)
