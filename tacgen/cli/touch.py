"""The command that adds what robots' fingers feel to episodes that were recorded without it."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from tacgen.base import output_file
from tacgen.base.errors import UserError
from tacgen.base.terminal import say
from tacgen.cli import common

MIN_TIMED_FRAMES = 500  # to be solved; the cost of fewer is not worth the time that an estimate takes
SENSOR_HELP = "A finger: left=gelsight_mini@left_pad; one for each."
OUT_HELP = "The copy, with touch; or of one episode a film (.webp, .gif) or Rerun's .rrd."
MOUNT_HELP = "Pose of a sensor in its body: the face's middle [mm], z out of the gel."
MATCH_HELP = "What of the log is kept: pose, force, or grip of both fingers, which costs most."


def touch(
    episodes: Annotated[Path, typer.Argument(help="A LeRobot folder, HDF5 of states, UMI's zarr, CSV or npz.")],
    sensors: Annotated[list[str], typer.Option("--sensor", metavar="NAME=SENSOR@BODY", help=SENSOR_HELP)],
    out: Annotated[Path, typer.Option("--out", "-o", help=OUT_HELP)],
    objects: Annotated[
        list[str] | None, typer.Option("--object", help="What fingers may touch; can be given many times.")
    ] = None,
    model: Annotated[Path | None, typer.Option(help="MJCF or URDF, where episodes hold joints.")] = None,
    columns: Annotated[
        Path | None, typer.Option(help="YAML: which columns are joints, poses and forces, and units.")
    ] = None,
    mounts: Annotated[
        list[str] | None, typer.Option("--mount", metavar="NAME=X,Y,Z[,QW,QX,QY,QZ]", help=MOUNT_HELP)
    ] = None,
    match: Annotated[str, typer.Option(help=MATCH_HELP)] = "pose",
    near_mm: Annotated[float, typer.Option(help="Rows are solved that bring an object so near to a gel.")] = 1.0,
    rate: Annotated[
        float | None, typer.Option(min=1e-3, help="Frames of the solve in a second; default: the episodes'.")
    ] = None,
    windows: Annotated[
        list[str] | None,
        typer.Option("--window", metavar="FROM:TO@RATE", help="Seconds of each episode that have another rate."),
    ] = None,
    friction: Annotated[float, typer.Option(min=0, help="Friction between objects and gels.")] = 0.6,
    quality: Annotated[str, typer.Option(help="draft, default or reference.")] = "draft",
    sets: common.Sets = None,
    chosen: Annotated[str, typer.Option("--episodes", metavar="FIRST:LAST", help="Only these, from 0.")] = "",
    bundles: Annotated[Path | None, typer.Option(help="Folder for recipes and bundles; default: OUT-bundles.")] = None,
    workers: common.Workers = "1",
    engine: common.Engine = "local",
    scheduler: common.Scheduler = "",
    shard: Annotated[
        str, typer.Option(metavar="I/N", help="Only solve part I of N; the command without it writes the copy.")
    ] = "0/1",
    dry_run: Annotated[
        bool, typer.Option("--dry-run", "--plan", help="Print contacts and the estimated cost, and write nothing.")
    ] = False,
    overwrite: common.Overwrite = False,
    as_json: common.AsJson = False,
) -> None:
    """Add what robots' fingers feel to recorded episodes, in a copy of them."""
    from tempfile import TemporaryDirectory

    from tacgen.touch import copies, labels, plan_text, scenes, sources
    from tacgen.touch.intervals import Rate

    part, processes = common.shard_of(shard), common.workers_of(workers)
    fingers = _fingers(sensors, mounts or [])
    rates = Rate(rate, tuple(map(_window, windows or [])))
    asked = scenes.TouchChoice(match, near_mm, rates, friction, quality, tuple(sets or ()))
    source = sources.open_source(episodes, model, tuple(objects or ()), columns)
    only = _range(chosen)

    def prepared_in(place: Path) -> tuple[scenes.TouchScenes, dict[str, Any]]:
        prepared = scenes.prepare(source, fingers, asked, place, only, overwrite=overwrite)
        common.warn([*prepared.plan.warnings, *prepared.notes])
        return prepared, plan_text.summary(prepared, source.fps)

    if dry_run:
        with TemporaryDirectory() as name:
            prepared, said = prepared_in(Path(name))
            said["cost"] = common.priced(prepared.plan, processes)
        common.show_result(said, f"{plan_text.text(said)}\n{said['cost']['text']}", as_json)
        return
    copies.refuse(source, len(source) if only is None else len(only), out, overwrite=overwrite)
    folder = bundles or out.with_name(f"{out.name}-bundles")
    with common.writing(folder), output_file.gone_if_refused(folder):
        common.probe(folder)
        prepared, said = prepared_in(folder)
        say(plan_text.text(said), err=True)
        if said["frames"] >= MIN_TIMED_FRAMES:
            said["cost"] = common.priced(prepared.plan, processes)
            say(str(said["cost"]["text"]), err=True)
        how: dict[str, Any] = {"workers": processes, "engine": engine, "scheduler": scheduler, "overwrite": overwrite}
        whole = shard == "0/1"
        planned = prepared.plan if whole else scenes.shard(prepared.plan, part)
        results = common.made(planned, folder, as_json=as_json, shard=None if whole else part, **how)
    failed = [f"{one.name}: {one.status}: {one.reason}" for one in results if one.status != "ok"]
    if not whole:
        common.show_result(
            {"folder": str(folder), **said}, "\n".join([*failed, f"{folder}: part {shard} is solved"]), as_json
        )
        raise typer.Exit(1 if failed else 0)
    touches = labels.felt(prepared, results)
    with common.writing(out):
        paths = copies.write(source, prepared.episodes, touches, out, overwrite=overwrite)
    said |= {"files": [str(path) for path in paths], "engine": plan_text.engine_table(prepared.episodes, touches)}
    lines = [*failed, *plan_text.notes(prepared.episodes, touches), *plan_text.engine_lines(said["engine"])]
    common.show_result(said, "\n".join([*lines, *map(str, paths)]), as_json)
    raise typer.Exit(1 if failed or prepared.notes else 0)


def _fingers(sensors: list[str], mounts: list[str]) -> list[Any]:
    """`left=gelsight_mini@left_pad` and `left=0,0,5` as fingers."""
    from tacgen.recipe.trajectory import Placement
    from tacgen.touch.episode import Finger

    found: dict[str, Any] = {}
    for text in sensors:
        name, equals, rest = text.partition("=")
        sensor, at, body = rest.rpartition("@")
        if not (name and equals and sensor and at and body) or name in found:
            raise UserError(f"--sensor {text}: must be NAME=SENSOR@BODY with a name of its own, such as left=digit@pad")
        found[name] = Finger(name, sensor, body)
    for text in mounts:
        name, _, rest = text.partition("=")
        try:
            numbers = [float(part) for part in rest.split(",")]
            if len(numbers) not in (3, 7) or name not in found:
                raise ValueError
            keys = {"position_mm": numbers[:3], **({"quaternion": numbers[3:]} if numbers[3:] else {})}
            found[name] = replace(found[name], mount=Placement.model_validate(keys))
        except ValueError:
            told = f"must be NAME=X,Y,Z or NAME=X,Y,Z,QW,QX,QY,QZ, of a finger: {', '.join(found)}"
            raise UserError(f"--mount {text}: {told}") from None
    places: dict[Any, str] = {}
    for name, one in found.items():
        if (other := places.setdefault((one.body, one.mount.model_dump_json()), name)) != name:
            raise UserError(f"--sensor {name}: is where {other} is, on {one.body}: name another body, or give --mount")
    return list(found.values())


def _window(text: str) -> tuple[float, float, float]:
    """`1.2:1.5@200` as numbers."""
    times, _, rate = text.partition("@")
    start, _, end = times.partition(":")
    try:
        found = float(start), float(end), float(rate)
    except ValueError:
        found = 0.0, 0.0, 0.0
    if not (found[0] < found[1] and found[2] > 0):
        raise UserError(f"--window {text}: must be FROM:TO@RATE in seconds and 1/s, such as 1.2:1.5@200")
    return found


def _range(text: str) -> range | None:
    """`3:5` as the numbers 3, 4 and 5; `3` alone is one episode."""
    if not text:
        return None
    first, colon, last = text.partition(":")
    if not (first.isdecimal() and (last if colon else first).isdecimal()):
        raise UserError(f"--episodes {text}: must be a number, or FIRST:LAST such as 0:9")
    return range(int(first), int(last or first) + 1)
