"""Scenes that do not touch the gel: told before they are run, and not kept as `ok` unless a recipe says `may_miss`."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from tacgen.errors import UserError

if TYPE_CHECKING:
    from tacgen.recipe.model import Recipe
    from tacgen.recipe.row import Row

LOOKED_AT = 50  # scenes of a plan whose paths are followed: some hundredths of a second each
NO_CONTACT = "touches the gel in no frame"
MISSED = NO_CONTACT + ": closest approach {:.3g} mm"
KEEP = "check its start or poses, and their unit; may_miss: true keeps such scenes"


def verdict(recipe: "Recipe", gap: float) -> tuple[bool, str]:
    """Whether a scene without force is ok, whose indenter came as close as `gap` [mm], and a line that says so."""
    quality = recipe.resolved()
    if gap < -quality.dhat_mm:
        finer = f"ask for a finer mesh, as in quality: {{edge_mm: {quality.edge_mm / 2:.2g}}}"
        return False, f"the indenter is {-gap:.3g} mm inside the gel without force, between contact points: {finer}"
    text = f"the indenter {MISSED.format(gap)}"
    return recipe.may_miss, text if recipe.may_miss else f"{text}; {KEEP}"


def note(rows: Sequence["Row"]) -> str:
    """A line about those of the first scenes that touch in no frame, or "".

    Raises:
        UserError: one of them cannot be followed.
    """
    looked, missed = rows[:LOOKED_AT], []
    for row in looked:
        try:
            missed += [(row, gap)] if (gap := _gap(row)) > 0 else []
        except UserError as error:
            raise UserError(f"{row.name}: {line}" for line in error.lines) from None
    if not missed:
        return ""
    row, gap = missed[0]
    more = f"; nor do {len(missed) - 1} more of the first {len(looked)} scenes" if len(missed) > 1 else ""
    rejected = "" if row.recipe.may_miss else f": a run rejects it; {KEEP}"
    return f"{row.name} {MISSED.format(gap)}{more}{rejected}"


def _gap(row: "Row") -> float:
    """How close a scene comes to contact [mm]; 0 if it touches, or may do so: a press ends below first touch, and a
    force is searched for until it is found.
    """
    pressed, file = any(step.press for step in row.recipe.trajectory), row.recipe.indenter.shape == "mesh"
    if (pressed or row.other) and (row.index if file else not row.other):
        return 0.0  # a file is read for the first of such scenes alone; other shapes are looked at with the recipe
    if row.other is not None:
        from tacgen.recipe import grasp_of_row

        return grasp_of_row.build(row).apart
    from tacgen.geometry.first_touch import closest
    from tacgen.recipe.path import indenter_path
    from tacgen.recipe.scene_of_row import gel_of, shape_of

    gel = gel_of(row.sensor, row.solid_path if row.sensor.gel.solid else None)
    shape = shape_of(row)
    path = indenter_path(row.recipe, shape, gel, row.replayed)
    if pressed or path.forced is not None:
        return 0.0
    gap = closest(shape, gel, path.poses)
    return gap if gap >= row.recipe.resolved().dhat_mm else 0.0
