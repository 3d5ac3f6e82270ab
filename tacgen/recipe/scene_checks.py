"""Scenes that a run refuses, and those that do not touch the gel: not `ok` unless a recipe says `may_miss`."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from tacgen.base.errors import UserError

if TYPE_CHECKING:
    from tacgen.recipe.model import Recipe
    from tacgen.recipe.row import Row

MAX_BUILT_SCENES = 50  # scenes that are built: some hundredths of a second each
MAX_BUILT_MESH_SCENES = 3  # of scenes with a mesh from a file: some seconds each
NO_CONTACT_MESSAGE = "touches the gel in no frame"
MISSED_MESSAGE = NO_CONTACT_MESSAGE + ": closest approach {:.3g} mm"
KEEP_HINT = "check its start or poses, and their unit; may_miss: true keeps such scenes"


def notes(rows: "Sequence[Row]") -> list[str]:
    """Lines about the first scenes: those that touch in no frame, and the expected error of the first one's force.

    Raises:
        UserError: a run would refuse one of them.
    """
    looked = rows[: MAX_BUILT_MESH_SCENES if rows[0].recipe.indenter.shape == "mesh" else MAX_BUILT_SCENES]
    found = []
    for row in looked:
        try:
            found.append(_looked_at(row))
        except UserError as error:
            raise UserError(f"{row.name}: {line}" for line in error.lines) from None
    pairs = zip(looked, found, strict=True)
    missed = [(row, gap) for row, (gap, _) in pairs if gap >= row.recipe.resolved().dhat_mm]
    said = [error for _, error in found[:1] if error]
    if not missed:
        return said
    row, gap = missed[0]
    more = f"; nor do {len(missed) - 1} more of the first {len(looked)} scenes" if len(missed) > 1 else ""
    rejected = "" if row.recipe.may_miss else f": a run rejects it; {KEEP_HINT}"
    return [f"{row.name} {MISSED_MESSAGE.format(gap)}{more}{rejected}", *said]


def _looked_at(row: "Row") -> tuple[float, str]:
    """How close a scene comes to contact [mm], 0 if it touches or a force is searched for; and a line on the expected
    error of its force, "" where that is not known."""
    from tacgen.geometry.first_touch import closest
    from tacgen.mechanics.expected_error import Expected
    from tacgen.recipe import grasp_of_row, scene_of_row

    if row.other is not None:
        return grasp_of_row.build(row).apart, ""
    scene = scene_of_row.build(row)
    if scene.forced is not None:
        return 0.0, ""
    if expected := Expected.of(scene):
        expected.refuse()
        return 0.0, expected.note()
    pressed = any(step.press for step in row.recipe.trajectory)
    return 0.0 if pressed else closest(scene.shape, scene.gel, scene.poses), ""


def verdict(recipe: "Recipe", gap: float) -> tuple[bool, str]:
    """Whether a scene without force is ok, whose indenter came as close as `gap` [mm], and a line that says so."""
    quality = recipe.resolved()
    if gap < -quality.dhat_mm:
        finer = f"ask for a finer mesh, as in quality: {{edge_mm: {quality.edge_mm / 2:.2g}}}"
        return False, f"the indenter is {-gap:.3g} mm inside the gel without force, between contact points: {finer}"
    text = f"the indenter {MISSED_MESSAGE.format(gap)}"
    return recipe.may_miss, text if recipe.may_miss else f"{text}; {KEEP_HINT}"
