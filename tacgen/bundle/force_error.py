"""The expected error of a bundle's forces, as it is printed beside them."""

from typing import NamedTuple

import numpy as np

from tacgen.bundle.bundle import Bundle
from tacgen.mechanics.expected_error import ERROR_ESTIMATE_FACTOR

FORCE_STD_PATH, FORCE_ERROR_PATH = "/frames/uncertainty/force", "/frames/quality/expected_force_error"
STD_BY_UNCERTAINTY = "standard deviation by the recipe's uncertainty"
ERROR_BY_MESH = f"by the mesh, within a factor of {ERROR_ESTIMATE_FACTOR}"


class ForceError(NamedTuple):
    """The expected error of the force's magnitude in each frame (N,) [N], nan where it is not known; and its kind."""

    newton: np.ndarray
    kind: str

    def text(self, frame: int) -> str:
        """`± about 0.03 N`; "" where it is not known."""
        value = float(self.newton[frame])
        return f"\N{PLUS-MINUS SIGN} about {float(f'{value:.1g}'):g} N" if np.isfinite(value) else ""


def force_error(bundle: Bundle) -> ForceError | None:
    """The expected error of the force: that of the recipe's `uncertainty` where it was asked for, else the error by the
    mesh that is expected at its quality; None if a bundle of an earlier version has neither."""
    if FORCE_STD_PATH in bundle:
        return ForceError(np.linalg.norm(bundle[FORCE_STD_PATH], axis=1), STD_BY_UNCERTAINTY)
    if FORCE_ERROR_PATH in bundle and "/frames/force" in bundle:
        return ForceError(bundle[FORCE_ERROR_PATH] * np.linalg.norm(bundle["/frames/force"], axis=1), ERROR_BY_MESH)
    return None
