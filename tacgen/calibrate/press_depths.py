"""Depths of presses that can be solved in a gel."""

from tacgen.recipe import checks
from tacgen.sensor.model import Gel

# Over the thickness of the gel [-]. Below, the contact is smaller than the mesh's cells (depths in metres are, in any
# gel); above, the elements between indenter and base are crushed, and solves fail or take minutes.
SHALLOWEST, DEEPEST = 0.005, 0.6


def problem(gel: Gel, depth: float, at: tuple[float, float], deeper: float) -> str:
    """Why a press to a depth [mm] at (x, y) [mm], and to `deeper` times that, cannot be solved; empty if it can."""
    half_width, half_height = gel.width_mm / 2, gel.height_mm / 2
    if not (abs(at[0]) <= half_width and abs(at[1]) <= half_height):
        return f"lies beside the gel, at ({at[0]:.3g}, {at[1]:.3g}) mm: see x_px, y_px"
    thick = checks.thickness_mm(gel) - gel.drop_mm(*at)
    low, high = SHALLOWEST * thick, DEEPEST * thick / deeper
    if low <= depth <= high:
        return ""
    return f"must be from {low:.3g} to {high:.3g} mm in a gel of {thick:.3g} mm there (got {depth:.3g}): is it in mm?"
