"""The command that solves the contacts of another simulator again, and compares the forces."""

from pathlib import Path
from typing import Annotated

import typer

from tacgen.base.errors import UserError
from tacgen.cli import common

RECIPE_HELP = "A recipe: all but its movements is used, and the sensor_pose and indenter_pose of a replay."


def replay(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Logs of contacts: CSV, npz or HDF5.")],
    recipe: Annotated[str, typer.Option(help=RECIPE_HELP)],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for recipe, bundles and the comparison.")],
    layout: Annotated[
        str, typer.Option("--from", help="Whose names the arrays have: tacgen, isaaclab, mujoco, newton or genesis.")
    ] = "tacgen",
    quaternion: Annotated[str, typer.Option(help="Order of quaternions in arrays: wxyz or xyzw.")] = "",
    units: Annotated[str, typer.Option(help="Unit of lengths, where the log does not say: m or mm.")] = "",
    force_on: Annotated[str, typer.Option(help="Whom the log's force acts on: sensor or object.")] = "sensor",
    force_frame: Annotated[str, typer.Option(help="Axes of the log's force: world, or those of the sensor.")] = "world",
    near_mm: Annotated[float, typer.Option(help="Rows are solved that bring the object so near to the gel.")] = 1.0,
    every: Annotated[int, typer.Option(min=1, help="Of these, take every n-th.")] = 1,
    rows: Annotated[str, typer.Option(metavar="FIRST:LAST", help="Only these rows of the log, from 0.")] = "",
    environments: Annotated[
        list[int] | None, typer.Option("--env", min=0, help="Number of an environment; can be given many times.")
    ] = None,
    group: Annotated[str, typer.Option(help="Group of an HDF5 file that holds the arrays.")] = "/",
    sets: common.Sets = None,
    workers: common.Workers = "1",
    overwrite: common.Overwrite = False,
    as_json: common.AsJson = False,
) -> None:
    """Solve the contacts in the logs of another simulator, and compare its forces with tacgen's."""
    from tacgen import replay as replaying
    from tacgen.replay import comparison
    from tacgen.replay.contact_log import Conventions

    processes = common.workers_of(workers)
    how = Conventions(layout, quaternion, units, force_on, force_frame, group)
    choice = replaying.Choice(near_mm, every, *_rows(rows))
    with common.writing(out):
        common.probe(out)
        prepared = replaying.prepare(
            logs, recipe, out, how, choice, environments=environments or (), sets=sets or (), overwrite=overwrite
        )
        common.warn(prepared.notes)
        plan = common.plan_of(str(prepared.recipe), list(prepared.sets))
        results = common.made(plan, out, workers=processes, overwrite=overwrite)
        found = replaying.compared(prepared, results)
        written = comparison.write(found, out, logs, overwrite=overwrite)
    plain = {"files": [str(path) for path in written], "logs": [one.summary() for one in found]}
    lines = [comparison.text(found), *(str(path) for path in written)]
    lines += [f"{result.name}: {result.status}: {result.reason}" for result in results if result.status == "failed"]
    common.show_result(plain, "\n".join(lines), as_json)
    raise typer.Exit(0 if all(result.status == "ok" for result in results) else 1)


def _rows(text: str) -> tuple[int, int | None]:
    """`100:200` as its first and last row; None for an open end."""
    first, colon, last = text.partition(":")
    if not text:
        return 0, None
    if not (colon and all(part == "" or (part.isdecimal() and len(part) < 10) for part in (first, last))):
        raise UserError(f"--rows {text}: must be FIRST:LAST, such as 100:200, 100: or :200")
    return int(first or 0), int(last) if last else None
