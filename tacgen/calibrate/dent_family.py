"""Presses of a ball into gels of all thicknesses, from a few that are solved.

Scaled by its depth and by the radius of its contact, the face under a ball changes slowly with the thickness; so does
the force over that of Hertz. The tables of the solved gels are interpolated in the logarithm of the thickness, row by
row: each row is the same share of the largest depth. Moduli only scale the forces.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.interpolate import BarycentricInterpolator

from tacgen.calibrate import dent_tables, steps
from tacgen.calibrate.dent_tables import DENT_RADII, Dents, with_thickness
from tacgen.sensor.model import LitSensor

Array = np.ndarray
SOLVED_THICKNESS_FACTORS = (0.5, 0.8, 1.26, 2.0)  # thicknesses that are solved, over the file's
DENTS_SOLVE_S = 40.0  # expected work of a table [s of a core]


def solved(
    sensor: LitSensor, widest: Mapping[float, float], at: tuple[float, float], factors: Sequence[float],
    friction: float, quality: str,
) -> tuple[list[dict[float, Dents]], float]:  # fmt: skip
    """Presses at (x, y) [mm] into gels of the file's thickness times each of `factors`, and the largest relative error
    of their forces by the interpolation.

    Args:
        widest: radius of the widest contact [mm] by the ball's radius [mm].
        factors: rising; those within the range of SOLVED_THICKNESS_FACTORS are interpolated if there are several.

    Raises UserError: a press that cannot be solved.
    """
    nodes = SOLVED_THICKNESS_FACTORS if len(factors) > len(SOLVED_THICKNESS_FACTORS) else tuple(factors)
    thick = sensor.gel.thickness_mm
    jobs = [(with_thickness(sensor, factor * thick), ball, at, most, friction, quality)
            for ball, most in widest.items() for factor in nodes]  # fmt: skip
    texts = [f"ball of {job[1]:g} mm on a gel of {job[0].gel.thickness_mm:.3g} mm: solved" for job in jobs]
    steps.expect(DENTS_SOLVE_S * len(jobs))
    tables = steps.on_workers(dent_tables.solved, jobs, texts, DENTS_SOLVE_S)
    each = {ball: tables[k * len(nodes) : (k + 1) * len(nodes)] for k, ball in enumerate(widest)}
    if nodes == tuple(factors):
        return [{ball: found[k] for ball, found in each.items()} for k in range(len(nodes))], 0.0
    wanted = [factor * thick for factor in factors]
    found = [{ball: interpolated(known, thickness) for ball, known in each.items()} for thickness in wanted]
    return found, max(error(known) for known in each.values())


def interpolated(known: Sequence[Dents], thickness: float) -> Dents:
    """Presses into a gel of another thickness [mm], from those into solved ones of rising thickness."""
    ball, rows = known[0].ball, min(len(one.depth) for one in known)
    nodes = np.log([one.thickness for one in known])

    def between(values: Sequence[Array]) -> Array:
        return np.asarray(BarycentricInterpolator(nodes, np.array(values))(np.log(thickness)))

    depth = np.exp(between([np.log(one.depth[:rows]) for one in known]))
    hertz = between([np.log(one.force[:rows] / np.sqrt(ball * one.depth[:rows] ** 3)) for one in known])
    reach = [np.sqrt(ball * one.depth[:rows]) for one in known]
    scaled = [one.contact[:rows] / far for one, far in zip(known, reach, strict=True)]
    contact = between(scaled)
    drop, slope = (
        between([_stretched(getattr(one, part)[:rows], old / contact) for one, old in zip(known, scaled, strict=True)])
        for part in ("drop", "slope")
    )
    force = np.exp(hertz) * np.sqrt(ball * depth**3)
    return Dents(ball, thickness, depth, force, drop, slope, contact * np.sqrt(ball * depth))


def _stretched(table: Array, by: Array) -> Array:
    """Rows (n, DENT_RADII) of a table at `by` (n,) times their radii, so that the rims of contacts lie together."""
    return np.array([np.interp(DENT_RADII * k, DENT_RADII, row) for row, k in zip(table, by, strict=True)])


def error(known: Sequence[Dents]) -> float:
    """Largest relative error of interpolated forces: the inner tables by the others, over what the nodes' distance
    brings (a quarter of it, twice as near)."""
    worst = 0.0
    for k in range(1, len(known) - 1):
        again = interpolated([one for one in known if one is not known[k]], known[k].thickness)
        rows = min(len(again.force), len(known[k].force))
        worst = max(worst, float(np.abs(again.force_at(known[k].depth[:rows]) / known[k].force[:rows] - 1).max()))
    return worst / 4
