"""What a run would find of a scene before it solves it: the same refusals, and the expected error of the force."""

from collections.abc import Sequence

from tacgen.errors import UserError
from tacgen.recipe.row import Row

LOOKED_AT, OF_MESHES = 50, 4  # scenes that are built: some hundredths of a second each, with meshes some seconds


def notes(rows: Sequence[Row]) -> list[str]:
    """The expected error of the first scene's force, and which scenes are not looked at.

    Raises:
        UserError: one of the first scenes would be refused when it is run.
    """
    most = OF_MESHES if rows[0].recipe.indenter.shape == "mesh" else LOOKED_AT
    said = [_note(row, several=len(rows) > 1) for row in rows[:most]]
    return [note for note in said[:1] if note]


def _note(row: Row, *, several: bool) -> str:
    from tacgen.mechanics.expected_error import Expected
    from tacgen.recipe import grasp_of_row, scene_of_row

    try:
        if row.other is not None:
            grasp_of_row.build(row)
            return ""
        scene = scene_of_row.build(row)
        if scene.forced is not None or (expected := Expected.of(scene)) is None:
            return ""
        expected.refuse()
    except UserError as refused:
        if several:
            raise UserError(f"{row.name}: {line}" for line in refused.lines) from None
        raise
    return expected.note()
