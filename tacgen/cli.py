"""Commands: arguments in, exit code out, nothing computed.

Results go to stdout, progress and errors to stderr. Exit codes: 0 done, 1 findings, rejected or failed scenes,
2 usage or recipe error, 130 interrupted.
"""

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import click
import typer
from typer.core import TyperGroup

from tacgen import __version__
from tacgen.errors import UserError

DISK = tuple(
    getattr(errno, name)
    for name in ("ENOSPC", "EACCES", "EPERM", "EROFS", "ENOTDIR", "EISDIR", "EEXIST", "EDQUOT", "ENAMETOOLONG", "EFBIG")
)


class Commands(TyperGroup):
    """Turns what a person can act on into lines and an exit code; bugs keep their traceback."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command that was asked for."""
        try:
            return super().invoke(ctx)
        except UserError as error:
            for line in error.lines:
                typer.echo(line, err=True)
            raise typer.Exit(2) from None
        except (KeyboardInterrupt, SystemError) as error:
            if not _interrupted(error):
                raise
            typer.echo("interrupted; finished scenes are kept, run again to go on", err=True)
            raise typer.Exit(130) from None


def _interrupted(error: BaseException | None) -> bool:
    """Whether an error is Ctrl-C, which compiled code passes on as a SystemError that it caused."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Declarative recipes in, labelled datasets of vision-based tactile sensors out.",
)

RecipeFile = Annotated[str, typer.Argument(metavar="RECIPE", help="A recipe file, or the name of a shipped recipe.")]
Sets = Annotated[
    list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="Override a value; can be given many times.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"tacgen {__version__}")
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
    sets: Sets = None,
    workers: Annotated[int, typer.Option(min=1, help="Scenes at a time, a process and a core each.")] = 1,
    shard: Annotated[
        str, typer.Option(metavar="I/N", help="Only this part of the scenes, 0/N to N-1/N: for job arrays.")
    ] = "0/1",
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace bundles made from other inputs, and remake finished ones.")
    ] = False,
    engine: Annotated[str, typer.Option(help="local: this machine; dask: a cluster.")] = "local",
    scheduler: Annotated[str, typer.Option(help="Address of a Dask scheduler, such as tcp://host:8786.")] = "",
    silence_s: Annotated[float, typer.Option(min=0.1, help="Stop a scene after so long without a new frame.")] = 1800,
    memory_gb: Annotated[
        float | None, typer.Option(min=0.01, help="Stop a scene that uses more; by default an even share of it all.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be done, and do nothing.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print events, a JSON object a line.")] = False,
) -> None:
    """Generate every scene of a recipe; scenes that are finished already are kept."""
    part = _shard(shard)
    plan = _plan(recipe, sets, part)
    if dry_run:
        frames = sum(row.frames for row in plan.rows)
        _show(
            {"folder": str(out), "scenes": [row.name for row in plan.rows], "frames": frames},
            f"{out}: would hold {_count(len(plan.rows), 'scene')} of {plan.name}, {frames} frames",
            as_json,
        )
        return
    with _writing(out):
        _probe(out)
        from tacgen import batch
        from tacgen.progress import Progress

        with Progress(plan.rows) as progress:

            def hear(event: dict[str, Any]) -> None:
                progress(event)
                if as_json:
                    _line(event)

            results = batch.run(
                plan,
                out,
                workers=workers,
                overwrite=overwrite,
                shard=None if shard == "0/1" else part,
                limits=batch.Limits(silence_s, memory_gb),
                engine=engine,
                scheduler=scheduler,
                hear=hear,
            )
    count = {status: sum(r.status == status for r in results) for status in ("ok", "rejected", "failed")}
    if as_json:
        _line({"event": "end", "folder": str(out), **count})
    else:
        for result in results:
            if result.status != "ok":
                typer.echo(f"{result.name}: {result.status}: {result.reason}")
        more = f", {count['failed']} failed" if count["failed"] else ""
        typer.echo(f"{out}: {_count(count['ok'], 'scene')} kept, {count['rejected']} rejected{more}")
    raise typer.Exit(0 if count["ok"] == len(results) else 1)


@app.command()
def status(
    folder: Annotated[Path, typer.Argument(help="A folder that `run` writes into.")],
    as_json: AsJson = False,
) -> None:
    """Say how far a folder is: scenes done, rejected or failed with their reasons, at work and waiting."""
    from tacgen.survey import survey

    found = survey(folder)
    count, total = found.count(), len(found.scenes)
    said = [scene for scene in found.scenes if scene.reason]
    plain = [{"scene": scene.name, "state": scene.state, "reason": scene.reason} for scene in found.scenes]
    lines = [f"{scene.name}: {scene.state}: {scene.reason}" for scene in said]
    lines.append(f"{folder}: {found.name}, {_count(total, 'scene')}: {', '.join(f'{n} {s}' for s, n in count.items())}")
    _show({"name": found.name, "count": count, "scenes": plain}, "\n".join(lines), as_json)
    raise typer.Exit(0 if count.get("ok", 0) == total else 1)


@app.command()
def validate(file: RecipeFile, sets: Sets = None) -> None:
    """Check a recipe with its sensor and every scene of it, or a sensor file alone."""
    from tacgen import assets, load, yamlfile

    path = assets.recipe_path(file)
    data = yamlfile.load(path).data
    if isinstance(data, dict) and "tacgen_sensor" in data:
        sensor, _ = load.read_sensor(path)
        typer.echo(f"{path}: a valid sensor, {sensor.name}")
        return
    plan = _plan(file, sets)
    row = plan.rows[0]
    typer.echo(f"{path}: a valid recipe, {plan.name}: {_count(len(plan.rows), 'scene')}, sensor {row.sensor.name}")


@app.command()
def schema(
    sensor: Annotated[bool, typer.Option("--sensor", help="Of a sensor file instead of a recipe.")] = False,
) -> None:
    """Print the JSON Schema of a recipe, for editors and other programs."""
    import json

    from tacgen.schema import recipe_schema, sensor_schema

    typer.echo(json.dumps(sensor_schema() if sensor else recipe_schema(), indent=1))


@app.command("plan")
def show_plan(
    recipe: RecipeFile,
    sets: Sets = None,
    shard: Annotated[str, typer.Option(metavar="I/N", help="Only this part of the scenes.")] = "0/1",
    as_csv: Annotated[bool, typer.Option("--csv", help="Print CSV.")] = False,
    as_json: AsJson = False,
) -> None:
    """Show the table of scenes that a recipe gives."""
    from tacgen import table

    plan = _plan(recipe, sets, _shard(shard))
    typer.echo((table.as_json if as_json else table.as_csv if as_csv else table.as_text)(plan), nl=False)


@app.command()
def init(
    path: Annotated[Path, typer.Argument(help="The recipe to write.")] = Path("recipe.yaml"),
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a file that is there.")] = False,
) -> None:
    """Write a commented recipe to start from, and the schema that editors complete it with."""
    from tacgen.schema import write_starter

    with _writing(path.parent):
        written, schema_file = write_starter(path, overwrite=overwrite)
    typer.echo(f"{written}: a recipe to start from ({schema_file} completes it in an editor)")


@app.command("list")
def show_list(
    kind: Annotated[str, typer.Argument(help="sensors, recipes, objects, shapes or formats; all when left out.")] = "",
    as_json: AsJson = False,
) -> None:
    """List sensors, recipes, objects, indenter shapes and formats to export to."""
    from tacgen.listing import KINDS

    if kind and kind not in KINDS:
        raise UserError(f"{kind}: must be one of {', '.join(KINDS)}")
    found = {name: KINDS[name]() for name in ([kind] if kind else KINDS)}
    lines: list[str] = []
    for name, entries in found.items():
        lines.append(f"{name}:")
        lines += [f"  {entry:<16} {about}" for entry, about in entries.items()] or ["  none"]
    _show(found, "\n".join(lines), as_json)


@app.command()
def check(
    path: Annotated[Path, typer.Argument(help="A bundle, or a folder of bundles.")],
    as_json: AsJson = False,
) -> None:
    """Check finished bundles: whole, unchanged, finite, balanced. Findings are printed and give exit code 1."""
    from tacgen.check import check as find

    findings = find(path)
    plain = [{"path": str(f.path), "level": f.level, "message": f.message} for f in findings]
    lines = [str(finding) for finding in findings] or [f"{path}: nothing found wrong"]
    _show(plain, "\n".join(lines), as_json)
    raise typer.Exit(1 if findings else 0)


@app.command()
def show(
    path: Annotated[Path, typer.Argument(help="A bundle.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Write a picture here instead of a summary.")] = None,
) -> None:
    """Say what is in a bundle, or draw it: images, pressure, traction and height over the frames."""
    from tacgen import show as showing

    if out is None:
        typer.echo(showing.summary(path))
        return
    with _writing(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        showing.picture(path, out)
    typer.echo(str(out))


@app.command()
def export(
    kind: Annotated[str, typer.Argument(metavar="FORMAT", help="`tacgen list formats` names them.")],
    source: Annotated[Path, typer.Argument(help="A bundle, or a folder of bundles.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Where to write.")],
    as_json: AsJson = False,
) -> None:
    """Write finished bundles in the format of another tool."""
    from tacgen import export as exporting

    with _writing(out):
        made = exporting.export(kind, source, out)
    _show([str(path) for path in made], "\n".join(map(str, made)), as_json)


@app.command()
def doctor(as_json: AsJson = False) -> None:
    """Try what a run needs on this machine: packages, solvers, rendering, HDF5, threads, disk."""
    from tacgen import doctor as checkup

    findings = checkup.examine()
    lines = [f"{'ok ' if f.ok else 'BAD' if f.needed else '-- '} {f.name:<20} {f.note}" for f in findings]
    _show([f._asdict() for f in findings], "\n".join(lines), as_json)
    raise typer.Exit(1 if any(f.needed and not f.ok for f in findings) else 0)


def _plan(recipe: str, sets: list[str] | None, shard: tuple[int, int] = (0, 1)) -> Any:
    """The plan of a recipe given by path or name, or a shard of it."""
    from tacgen import assets, plan

    return plan.load(assets.recipe_path(recipe), sets or (), shard)


def _shard(text: str) -> tuple[int, int]:
    """`1/4` as numbers."""
    index, slash, count = text.partition("/")
    if not (slash and index.isdecimal() and count.isdecimal() and int(index) < int(count)):
        raise UserError(f"--shard {text}: must be I/N with I from 0 to N - 1, such as 0/4, 1/4, 2/4 and 3/4")
    return int(index), int(count)


def _show(plain: Any, text: str, as_json: bool) -> None:
    """Print a result for a person or a program."""
    import json

    typer.echo(json.dumps(plain, indent=1) if as_json else text)


def _line(event: dict[str, Any]) -> None:
    """Print an event for a program that listens while the run goes on."""
    import json

    typer.echo(json.dumps(event))


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}" + ("" if n == 1 else "s")


@contextmanager
def _writing(place: Path) -> Iterator[None]:
    """A disk that is full, read-only or not ours is no bug: one line."""
    try:
        yield
    except OSError as error:
        if error.errno not in DISK:
            raise
        raise UserError(f"{error.filename or place}: cannot be written: {error.strerror}") from None


def _probe(folder: Path) -> None:
    """Make the folder and write to it now, not after the first scene is solved."""
    import tempfile

    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"\0" * 4096)
    except OSError as error:  # whatever stands in the way, it is the folder that must be another
        raise UserError(f"{folder}: cannot be written: {error.strerror}") from None
