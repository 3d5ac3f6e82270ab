"""Checks of scenes that a run makes before it solves them, for `validate`."""

from collections.abc import Sequence

from tacgen.base.errors import UserError
from tacgen.recipe import approach
from tacgen.recipe.row import Row

MAX_BUILT_SCENES = 50  # scenes that are built: some hundredths of a second each
MAX_BUILT_MESH_SCENES = 3  # of scenes with a mesh from a file: some seconds each


def notes(rows: Sequence[Row]) -> list[str]:
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
    gaps = [(row, gap) for row, (gap, _) in zip(looked, found, strict=True)]
    return [line for line in (approach.note(gaps), found[0][1]) if line]


def _looked_at(row: Row) -> tuple[float, str]:
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
