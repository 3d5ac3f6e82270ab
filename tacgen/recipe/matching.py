"""Forces that a replayed table asks for: of its rows, smoothed; and what a table lacks for them."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from tacgen.recipe import pose_table
from tacgen.recipe.pose_table import TimedPose
from tacgen.recipe.trajectory import Replay

if TYPE_CHECKING:
    from numpy import ndarray as Array

# below it a row asks for no contact: a thousandth of a firm touch, and less than the noise of a simulator's contacts
MIN_MATCHED_FORCE_N = 1e-3
USUAL_FILTER_ROWS = 3  # rows whose median is a row's force: spikes of one row go


def asked(rows: Sequence[TimedPose], move: Replay) -> "Array":
    """Normal forces (n,) [N] that all rows of a table ask for, pressing on the gel, at least 0; in a grasp those of the
    grip. Each is the median over the rows next to it, the last one repeated at an end; nan where the table has none."""
    import numpy as np

    if move.match == "grip":
        found = np.array([row.grip for row in rows])
    else:
        (mount,) = pose_table.matrices([move.sensor_pose.position_mm], [move.sensor_pose.quaternion])
        bodies = [row.sensor for row in rows if row.sensor is not None]
        outward = (np.array(bodies) @ mount if bodies else mount)[..., :3, 2]
        found = -(np.array([row.force or (math.nan,) * 3 for row in rows]) * outward).sum(1)
    count = move.filter_rows or USUAL_FILTER_ROWS
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(found, count // 2, mode="edge"), count)
    known = np.where(np.isnan(windows), found[:, None], windows)  # nan stays, and beside a force counts as that
    return np.asarray(np.maximum(np.median(known, axis=1), 0.0))


def lacks(rows: Sequence[TimedPose], move: Replay) -> str | None:
    """Why a table's rows have nothing to match, in words; None: they have."""
    if move.match == "force" and all(math.isnan(row.normal) for row in rows):
        columns = ", ".join(f"{name}_n" for name in pose_table.FORCE_COLUMNS)
        return f"needs forces, and {move.file} has none in {columns}: add them, or take match: pose"
    if move.match == "grip" and all(math.isnan(row.normal) and math.isnan(row.width) for row in rows):
        return f"needs forces or widths, and {move.file} has none in grip_n or width_mm: add them, or take match: pose"
    return None
