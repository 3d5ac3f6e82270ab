"""How close an indenter comes to the untouched gel: scenes without contact are told before they are run."""

from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from tacgen.errors import UserError

if TYPE_CHECKING:
    from tacgen.geometry.analytic_sdf import Shape
    from tacgen.geometry.gel import GelBody
    from tacgen.recipe.row import Row

Array = np.ndarray
SPACING, FINER, LEVELS = 0.5, 20, 3  # of the first grid [mm]; times as fine is each next one, around the nearest point
LOOKED_AT = 50  # scenes of a plan whose paths are followed: some hundredths of a second each


def closest(shape: "Shape", gel: "GelBody", poses: Array) -> float:
    """Smallest distance [mm] of an indenter at the poses (N, 4, 4) from the untouched face; 0 or less if it touches."""
    from tacgen.geometry.pose import Pose

    middle, half, step = np.zeros(2), np.array([gel.width, gel.height]) / 2, SPACING
    for _ in range(LEVELS):
        x, y = np.meshgrid(
            *(m + np.linspace(-h, h, 2 * round(h / step) + 1) for m, h in zip(middle, half, strict=True))
        )
        here = gel.contains(x, y)
        face = np.column_stack([x[here], y[here], gel.top(x[here], y[here])])
        gap = [shape.value(Pose.of(pose).local(face)) for pose in poses]
        nearest = int(np.argmin([distance.min() for distance in gap]))
        poses, at = poses[nearest : nearest + 1], face[int(gap[nearest].argmin())]
        if (least := float(gap[nearest].min())) <= 0:
            break
        middle, half, step = at[:2], np.array([step, step]), step / FINER
    return least


def note(rows: Sequence["Row"]) -> str:
    """A line about those of the first scenes that touch in no frame, or ""."""
    looked = rows[:LOOKED_AT]
    missed = [(row.name, gap) for row in looked if (gap := _gap(row)) > 0]
    if not missed:
        return ""
    name, gap = missed[0]
    more = f"; nor do {len(missed) - 1} more of the first {len(looked)} scenes" if len(missed) > 1 else ""
    return f"{name} touches the gel in no frame: closest approach {gap:.3g} mm{more}"


def _gap(row: "Row") -> float:
    """How close a scene comes to contact [mm]; 0 if it touches, or may do so: a press ends below first touch, a force
    is searched for until it is found, and fingers close until they touch. What a scene cannot be built from is left to
    its run, which reports it.
    """
    if row.other is not None or any(step.press for step in row.recipe.trajectory):
        return 0.0
    from tacgen.recipe.path import indenter_path
    from tacgen.recipe.scene_of_row import gel_of, shape_of

    with suppress(UserError):
        gel = gel_of(row.sensor, row.solid_path if row.sensor.gel.solid else None)
        shape = shape_of(row)
        path = indenter_path(row.recipe, shape, gel, row.replayed)
        if path.forced is None and (gap := closest(shape, gel, path.poses)) >= row.recipe.resolved().dhat_mm:
            return gap
    return 0.0
