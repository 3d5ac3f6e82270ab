"""The commands: each parses its arguments, calls one function and gives an exit code.

Results go to stdout, progress and errors to stderr. Exit codes: 0 done, 1 findings, rejected or failed scenes,
2 usage or recipe error, 130 interrupted.
"""

from pathlib import Path
from typing import Annotated, Any

import typer

from tacgen.base.errors import UserError
from tacgen.base.terminal import say
from tacgen.base.version import __version__
from tacgen.cli import common
from tacgen.cli.calibrate import calibrations
from tacgen.cli.common import app
from tacgen.cli.look import report, show, view
from tacgen.cli.replay import replay
from tacgen.cli.sensor import sensors
from tacgen.cli.touch import touch
from tacgen.report.sheet import counted

__all__ = ["app"]

RecipeFile = Annotated[str, typer.Argument(metavar="RECIPE", help="A recipe file, or the name of a shipped recipe.")]
RENEW_HELP = "Replace bundles of other inputs or of another tacgen, and remove those that the plan no longer has."
EXPORT_FORMATS = "lerobot, webdataset, zarr, sparsh, feats, feelanyforce, univtac, rerun, vtkhdf or exr"
Merge = Annotated[bool, typer.Option("--merge", help="Take several data sets below the folder as one.")]

app.add_typer(calibrations, name="calibrate")
app.add_typer(sensors, name="sensor")


def _version(wanted: bool) -> None:
    if wanted:
        common.tell(f"tacgen {__version__}")
        raise typer.Exit


@app.callback()
def main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Options of all commands."""


@app.command()
def run(
    recipe: RecipeFile,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the bundles.")],
    sets: common.Sets = None,
    workers: common.Workers = "1",
    shard: Annotated[
        str, typer.Option(metavar="I/N", help="Run only part I of N of the scenes, I from 0 to N-1: for job arrays.")
    ] = "0/1",
    overwrite: Annotated[bool, typer.Option("--overwrite", help=RENEW_HELP)] = False,
    engine: common.Engine = "local",
    scheduler: common.Scheduler = "",
    silence_s: Annotated[float, typer.Option(min=0.1, help="Stop a scene without a new frame for so long.")] = 1800,
    memory_gb: Annotated[
        float | None, typer.Option(min=0.01, help="Stop a scene that uses more memory; default: an equal share.")
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Time a few scenes, print the estimated cost of all, and write nothing.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print events, one JSON object a line.")] = False,
) -> None:
    """Generate all scenes of a recipe; finished scenes are kept, so that the same command resumes."""
    part, processes = common.shard_of(shard), common.workers_of(workers)
    plan = common.plan_of(recipe, sets, part)
    if dry_run:
        frames, cost = sum(plan.frames), common.priced(plan, processes)
        text = f"{out}: would hold {counted(len(plan.rows), 'scene')} of {plan.name}, {frames} frames\n{cost['text']}"
        scenes = [row.name for row in plan.rows]
        common.show_result({"folder": str(out), "scenes": scenes, "frames": frames, "cost": cost}, text, as_json)
        return
    with common.writing(out):
        common.probe(out)
        from tacgen.batch import Limits
        from tacgen.bundle.check import UNIQUE_PATH
        from tacgen.report import dataset_card

        how: dict[str, Any] = {"workers": processes, "engine": engine, "scheduler": scheduler, "overwrite": overwrite}
        how |= {"shard": None if shard == "0/1" else part, "limits": Limits(silence_s, memory_gb)}
        results = common.made(plan, out, as_json=as_json, **how)
        if any(result.status == "ok" for result in results):
            card = dataset_card.write(out, (bundle for result in results for bundle in result.bundles))
            if card != out / dataset_card.CARD_FILE:
                common.warn(
                    [f"{out / dataset_card.CARD_FILE}: not the card that tacgen wrote, kept; the card is {card}"]
                )
    count = {status: sum(r.status == status for r in results) for status in ("ok", "rejected", "failed")}
    if as_json:
        common.line({"event": "end", "folder": str(out), **count})
    else:
        for result in results:
            if result.status != "ok":
                say(f"{result.name}: {result.status}: {result.reason}")
        more = f", {count['failed']} failed" if count["failed"] else ""
        kept = (one for result in results if result.status == "ok" for one in result.bundles)
        marks = [one[UNIQUE_PATH] for one in kept if UNIQUE_PATH in one]
        if folded := sum(int((~mark).sum()) for mark in marks):
            more += f"; {folded} of {sum(map(len, marks))} frames after a fold of the gel, where forces are not unique"
        say(f"{out}: {counted(count['ok'], 'scene')} kept, {count['rejected']} rejected{more}")
    raise typer.Exit(0 if count["ok"] == len(results) else 1)


@app.command()
def status(
    folder: Annotated[Path, typer.Argument(help="A folder that `run` writes into.")], as_json: common.AsJson = False
) -> None:
    """Print the state of a run: scenes that are done, rejected, failed (with reasons), running and waiting."""
    from tacgen.bundle import dataset
    from tacgen.bundle.run_status import survey
    from tacgen.report import estimate

    surveyed = survey(folder)
    count, total = surveyed.count(), len(surveyed.scenes)
    said = [scene for scene in surveyed.scenes if scene.reason]
    plain = [{"scene": scene.name, "state": scene.state, "reason": scene.reason} for scene in surveyed.scenes]
    lines = [f"{scene.name}: {scene.state}: {scene.reason}" for scene in said]
    states = ", ".join(f"{number} {state}" for state, number in count.items())
    lines.append(f"{folder}: {surveyed.name}, {counted(total, 'scene')}: {states}")
    if left_out := dataset.unplanned(folder):
        lines.append(f"not of the plan, left out: {dataset.some([path.name for path in left_out])}")
    if cost := estimate.left(surveyed):
        lines.append(f"left: {cost.text(1)}")
    plain_cost = cost and cost.plain()
    common.show_result(
        {"name": surveyed.name, "count": count, "left": plain_cost, "scenes": plain}, "\n".join(lines), as_json
    )
    raise typer.Exit(0 if count.get("ok", 0) == total else 1)


@app.command()
def validate(file: RecipeFile, sets: common.Sets = None) -> None:
    """Check a recipe with its sensor and all its scenes, or a sensor file."""
    from tacgen.recipe import assets, loading, scene_checks, sensor_checks
    from tacgen.sensor import usual_values, yaml_source

    path = assets.recipe_path(file)
    data = yaml_source.load(path).data
    if isinstance(data, dict) and ("tacgen_sensor" in data or "gel" in data):
        sensor, tree = loading.read_sensor(path)
        common.warn(usual_values.warnings(sensor, tree))
        common.tell(f"{path}: a valid sensor, {sensor.name}")
        assumed = usual_values.assumed(sensor) if sensor.base else []
        for part in [*assumed, *sensor_checks.bonded_note(sensor, loading.solid_folder(tree))]:
            common.tell(f"note: {part}")
        return
    plan = common.plan_of(file, sets)
    row = plan.rows[0]
    names = plan.sensors
    on = f"{'sensors' if len(names) > 1 else 'sensor'} {', '.join(names)}"
    common.tell(f"{path}: a valid recipe, {plan.name}: {counted(len(plan.rows), 'scene')}, {on}")
    bonded = sensor_checks.bonded_note(row.sensor, row.folders.get(("sensor", *loading.SOLID_FILE_KEY)))
    for note in [*row.notes, *bonded, *scene_checks.notes(plan.rows)]:
        common.tell(f"note: {note}")


@app.command()
def schema(
    sensor: Annotated[bool, typer.Option("--sensor", help="The schema of a sensor file instead of a recipe.")] = False,
) -> None:
    """Print the JSON Schema of a recipe, for editors and other programs."""
    import json

    from tacgen.recipe.schema import recipe_schema, sensor_schema

    common.tell(json.dumps(sensor_schema() if sensor else recipe_schema(), indent=1))


@app.command("plan")
def show_plan(
    recipe: RecipeFile,
    sets: common.Sets = None,
    shard: Annotated[str, typer.Option(metavar="I/N", help="Only part I of N of the scenes.")] = "0/1",
    estimate: Annotated[
        bool, typer.Option("--estimate", help="Print what they would cost instead; it times a few of them.")
    ] = False,
    workers: common.Workers = "auto",
    as_csv: Annotated[bool, typer.Option("--csv", help="Print CSV.")] = False,
    as_json: common.AsJson = False,
) -> None:
    """Print the table of scenes of a recipe, or with --estimate their cost."""
    from shutil import get_terminal_size

    from tacgen.recipe import plan_table

    plan = common.plan_of(recipe, sets, common.shard_of(shard))
    if estimate:
        cost = common.priced(plan, common.workers_of(workers))
        common.show_result(cost, f"{counted(len(plan.rows), 'scene')} of {plan.name}: {cost['text']}", as_json)
        return
    table = plan_table.as_json(plan) if as_json else plan_table.as_csv(plan) if as_csv else ""
    common.tell(table or plan_table.as_text(plan, get_terminal_size().columns), end=False)


@app.command()
def init(
    path: Annotated[Path | None, typer.Argument(help="The file to write; default: recipe.yaml or sensor.yaml.")] = None,
    sensor: Annotated[bool, typer.Option("--sensor", help="Write a sensor file instead of a recipe.")] = False,
    start: Annotated[
        str, typer.Option("--from", metavar="NAME", help="Copy this shipped recipe or sensor, or file, as the start.")
    ] = "",
    overwrite: common.Overwrite = False,
) -> None:
    """Write a commented recipe or sensor file as a start, and the JSON Schema for completion in an editor."""
    from tacgen.recipe.schema import write_starter

    kind = "sensor" if sensor else "recipe"
    path = path or Path(f"{kind}.yaml")
    with common.writing(path.parent):
        written, schema_file = write_starter(path, sensor=sensor, start=start, overwrite=overwrite)
    common.tell(f"{written}: a {kind} to start from ({schema_file} completes it in an editor)")


@app.command("list")
def show_list(
    kind: Annotated[
        str, typer.Argument(help="sensors, recipes, objects, shapes, outputs or formats; default: all.")
    ] = "",
    as_json: common.AsJson = False,
) -> None:
    """List the available sensors, recipes, objects, indenter shapes, outputs and export formats."""
    from tacgen.report.catalogue import CATALOGUE_KINDS

    if kind and kind not in CATALOGUE_KINDS:
        from tacgen.sensor.validation_messages import unknown

        raise UserError(f"{kind}: {unknown('kind', kind, CATALOGUE_KINDS)}")
    listed = {name: CATALOGUE_KINDS[name]() for name in ([kind] if kind else CATALOGUE_KINDS)}
    lines: list[str] = []
    for name, entries in listed.items():
        width = max(map(len, entries), default=0)
        lines.append(f"{name}:")
        lines += [f"  {entry:<{width}}  {about}" for entry, about in entries.items()] or ["  none"]
    common.show_result(listed, "\n".join(lines), as_json)


@app.command()
def check(path: common.Bundles, as_json: common.AsJson = False) -> None:
    """Check that bundles are complete and unchanged, values finite, forces balanced; all but notes give exit code 1."""
    from tacgen.bundle.check import check as find

    findings = find(path)
    wrong = any(finding.level != "note" for finding in findings)
    plain = [{"path": str(f.path), "level": f.level, "message": f.message} for f in findings]
    lines = [str(finding) for finding in findings] + ([] if wrong else [f"{path}: nothing found wrong"])
    common.show_result(plain, "\n".join(lines), as_json)
    raise typer.Exit(1 if wrong else 0)


@app.command()
def pack(
    source: Annotated[Path, typer.Argument(help="A folder of bundles.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the shards and their index.")],
    size_mb: Annotated[float, typer.Option(min=0.001, help="Approximate largest size of a shard [MB].")] = 1024,
    merge: Merge = False,
    as_json: common.AsJson = False,
) -> None:
    """Copy finished scenes into a few large files (shards) with an index, in which all frames are one dataset."""
    from tacgen.bundle.dataset import scenes
    from tacgen.bundle.pack import pack as pack_scenes

    with common.writing(out):
        done = pack_scenes(scenes(source, merge=merge), out, size_mb)
    text = f"{out}: {counted(done.scenes, 'scene')} in {counted(len(done.shards), 'shard')}, {done.frames} frames"
    if done.left_out:
        text += f"; left out {counted(len(done.left_out), 'rejected scene')}"
    plain = {"folder": str(out), "scenes": done.scenes, "frames": done.frames, "left_out": done.left_out}
    common.show_result({**plain, "shards": [str(path) for path in done.shards]}, text, as_json)


for command in (replay, report, show, touch, view):
    app.command()(command)


@app.command()
def export(
    kind: Annotated[
        str, typer.Argument(metavar="FORMAT", help=f"{EXPORT_FORMATS}; `tacgen list formats` describes them.")
    ],
    source: common.Bundles,
    out: Annotated[Path, typer.Option("--out", "-o", help="Where to write.")],
    merge: Merge = False,
    card: Annotated[bool, typer.Option("--card", help="Write README.md as a data hub's page needs it.")] = False,
    licence: Annotated[str | None, typer.Option(help="Of the published data, for the card: cc-by-4.0, ...")] = None,
    overwrite: common.Overwrite = False,
    as_json: common.AsJson = False,
) -> None:
    """Write finished bundles in the format of another tool."""
    from tacgen import export as exporting
    from tacgen.report import hub_card

    page = hub_card.writer(kind, source, out, licence=licence, merge=merge) if card else None
    with common.writing(out):
        files = exporting.export(kind, source, out, merge=merge, overwrite=overwrite, card=page, tell=common.warn)
    common.show_result([str(path) for path in files], "\n".join(map(str, files)), as_json)


@app.command()
def doctor(
    warm: Annotated[
        bool, typer.Option("--warm", help="Also compile, and prepare all shipped sensors: a minute or more.")
    ] = False,
    as_json: common.AsJson = False,
) -> None:
    """Test what a run needs on this machine: packages, solvers, rendering, HDF5, threads, disk."""
    from tacgen.cli import doctor as checkup

    findings = checkup.examine()
    if warm:
        findings += checkup.warm()
    lines = [f"{'ok ' if f.ok else 'BAD' if f.needed else '-- '} {f.name:<20} {f.note}" for f in findings]
    common.show_result([f._asdict() for f in findings], "\n".join(lines), as_json)
    raise typer.Exit(1 if any(f.needed and not f.ok for f in findings) else 0)
