"""Forces of presses: measured ones, and those computed for the gel of a sensor file."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from tacgen import mechanics
from tacgen.base import csv_table
from tacgen.base.errors import UserError
from tacgen.calibrate import solved_presses
from tacgen.calibrate.dent_tables import HERTZ_FORCE_POWER
from tacgen.recipe.row import Row
from tacgen.recipe.trajectory import Press, Segment

Array = np.ndarray
MIN_FORCE_ROWS = 3  # rows of a table at least
CURVE_DEPTHS = 12  # depths at which a curve is solved
FIRST_TOUCH_RANGE = 0.1  # of the largest depth: range of the unknown depth of first touch
MAX_TABLE_NUMBER = 1e6  # of any number: no press has 1 MN, or lasts for 11 days


@dataclass(frozen=True)
class Measured:
    """Rows of a table, in its order: depth (n,) [mm], force (n,) [N], time (n,) [s] or None."""

    name: str
    depth: Array
    force: Array
    time: Array | None = None


def read(table: Path) -> Measured:
    """Read a table with the columns depth_mm, force_n and, for relaxation, time_s since first touch.

    Raises UserError: all problems, a line each.
    """
    wrong: list[str] = []
    columns: dict[str, list[float]] = {"depth_mm": [], "force_n": [], "time_s": []}
    for line, row in csv_table.rows(table, ("depth_mm", "force_n"), (), wrong):
        for name in columns if "time_s" in row else ("depth_mm", "force_n"):
            value = csv_table.number(row[name])
            if not abs(value) < MAX_TABLE_NUMBER:
                wrong.append(f"{table}:{line}: {name}: must be a number below {MAX_TABLE_NUMBER:g} (got {row[name]!r})")
            elif name == "time_s" and columns[name] and not value > columns[name][-1]:
                wrong.append(f"{table}:{line}: time_s: must rise (got {value:.15g} after {columns[name][-1]:.15g})")
            elif name == "time_s" and value < 0:
                wrong.append(f"{table}:{line}: time_s: must be at least 0, first touch (got {value:g})")
            columns[name].append(value)
    depth, force = np.array(columns["depth_mm"]), np.array(columns["force_n"])
    if not wrong and len(depth) < MIN_FORCE_ROWS:
        wrong.append(f"{table}: has {len(depth)} rows, and a fit takes {MIN_FORCE_ROWS} at least")
    elif not wrong and not (depth.max() > 0 and force.max() > 0):
        wrong.append(f"{table}: holds no press: depths and forces count positive into the gel")
    if wrong:
        raise UserError(wrong)
    return Measured(table.name, depth, force, np.array(columns["time_s"]) if columns["time_s"] else None)


def solved(row: Row, depths: Array) -> Array:
    """Quasi-static normal force (n,) [N] of a recipe's indenter at increasing depths (n,) [mm].

    The movements of the recipe are not used. Raises UserError: a depth at which the solver fails.
    """
    presses = tuple(Segment(press=Press(depth_mm=float(depth), frames=1)) for depth in depths)
    recipe = row.recipe.model_copy(update={"trajectory": presses, "dynamics": None})
    forces: list[float] = []
    try:
        _, states = solved_presses.solved_states(replace(row, recipe=recipe))
        forces.extend(mechanics.normal_force(state) for state in states)
    except mechanics.NotConverged as error:
        raise UserError(f"{row.recipe.name}: at a depth of {depths[len(forces)]:.3g} mm: {error}") from None
    return np.array(forces)


def depths_for(largest: float) -> Array:
    """Depths (CURVE_DEPTHS,) [mm] at which a curve is solved, for a table with this largest depth."""
    return np.linspace(0, (1 + FIRST_TOUCH_RANGE) * largest, CURVE_DEPTHS + 1)[1:]


class Curves:
    """Interpolated force over depth, for several values of a second parameter or without one."""

    def __init__(self, depth: Array, force: Array, values: Array | None = None) -> None:
        """depth (n,) [mm] rising from above 0; force (k, n) [N]; values (k,) rising, None where k is 1."""
        self.deepest, self.values = float(depth[-1]), values
        rooted = np.concatenate([np.zeros((len(force), 1)), np.maximum(force, 0) ** HERTZ_FORCE_POWER], axis=1)
        self._over = CubicSpline(np.concatenate([[0.0], depth]), rooted, axis=1)

    def force(self, depth: Array, value: float = 0.0) -> Array:
        """Force (n,) [N] at depths (n,) [mm]; 0 above the gel."""
        rooted = self._over(np.clip(depth, 0, self.deepest))
        rooted = rooted[0] if self.values is None else PchipInterpolator(self.values, rooted)(value)
        return np.asarray(np.maximum(rooted, 0) ** (1 / HERTZ_FORCE_POWER))
