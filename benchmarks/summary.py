"""A table of the most important results, for the head of the results page."""

import json
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from statistics import median
from typing import Any

Row = dict[str, Any]
ALONE = "without an engine"  # the column of efficiency
SENSORS = {"gelsight_mini": "Mini", "digit": "DIGIT", "ninedtact": "9DTact"}


def short(folder: Path) -> str:
    """The table in Markdown, of the benches with results in `folder`; those of an unusual machine name it."""
    lines = ["| figure | value | bench |", "|---|---|---|"]
    every = {name: json.loads(file.read_text()) for name in TOLD if (file := folder / f"{name}.json").exists()}
    machines = {name: f"{found['made']['processor']}, {found['made']['cores']} cores" for name, found in every.items()}
    usual = Counter(machines.values()).most_common(1)[0][0] if machines else ""
    for name, found in every.items():
        tables = {
            table["title"]: [dict(zip(table["columns"], row, strict=True)) for row in table["rows"]]
            for table in found["tables"]
        }
        where = name if machines[name] == usual else f"{name}, on {machines[name]}"
        with suppress(KeyError):  # results of another version have other columns
            lines += [f"| {what} | {figure} | {where} |" for what, figure in TOLD[name](tables)]
    return "\n".join(lines)


Tables = dict[str, list[Row]]
Told = Iterator[tuple[str, str]]


def _by_sensor(rows: list[Row], write: Callable[[Row], str]) -> str:
    return ", ".join(f"{SENSORS[row['sensor']]} {write(row)}" for row in rows)


def _mechanics(tables: Tables) -> Told:
    rows = [row for row in tables.get("Presets on every sensor", ()) if row["quality"] == "default"]
    if rows:
        yield "force error of `default` against `reference`", _by_sensor(rows, lambda row: f"{row['force']:.1%}")
        yield "pressure map error of `default`, L2", _by_sensor(rows, lambda row: f"{row['pressure map']:.1%}")


def _ordinary(tables: Tables) -> Told:
    for row in tables.get("Together", ()):
        if row["scenes of"] != "ordinary":
            continue
        ends = ("ok", "refused", "rejected", "out of time", "crashed")
        parts = [f"{row[status]} {status}" for status in ends if row[status]]
        parts += [f"{row['J <= 0']} with an element inside out"] if row["J <= 0"] else []
        named = (("mean", "mean"), ("median", "p50"), ("90 % quantile", "p90"))
        ended = ", ".join(parts)
        if row["ok"]:
            ended += "; seconds a frame: " + ", ".join(
                f"{name} {row[f's a frame, {what}']:.2f}" for name, what in named
            )
            ended += f"; {row['unique frames']:.0%} of the frames unique"
            ended += f"; a million frames {row['core-hours a million']:.0f} core-hours"
        yield f"{row['scenes']} ordinary scenes at `{row['quality']}`, a core each, solve alone", ended
        if row["compared"]:
            median, worst = row["force error, median"], row["force error, worst"]
            what = f"force error of long frames, {row['compared']} ordinary scenes"
            calm = row["force error in stable frames, worst"]
            told = "" if calm is None else f"; {calm:.1%} before the gel's first instability"
            for all_ in tables.get("Against half the edge", [])[:1]:
                told += f"; by the mesh, to half the edge, median {all_['median']:.1%}, told {all_['told, median']:.1%}"
            yield what, f"median {median:.1%}, worst {worst:.1%}{told}"


def _pipeline(tables: Tables) -> Told:
    found = tables.get("Where the time goes", [])
    for quality in ("draft", "default"):
        rows = [row for row in found if (row["asked for"], row["quality"]) == ("everything", quality)]
        if rows:
            yield (
                f"a ball at `{quality}`, everything: seconds a frame, one core (solve / labels / images / writing)",
                _by_sensor(rows, _stages),
            )
    rows = [row for row in found if row["quality"] == "draft" and "," in row["asked for"]]
    if rows:
        asked = rows[0]["asked for"]
        yield f"GB of a million frames, {asked}", _by_sensor(rows, lambda row: f"{row['GB a million']:.0f}")
    rows = [row for row in tables.get("The first scene", ()) if row["caches"] == "empty"]
    if rows:
        yield (
            "seconds to the first frame with empty caches",
            _by_sensor(rows, lambda row: f"{row['s to the first frame']:.0f}"),
        )
    for row in tables.get("Workers", ())[-1:]:
        alone = f"parallel efficiency {row['efficiency']:.2f}, of independent processes {row[ALONE]:.2f}"
        yield f"frames a second on {row['workers']} workers", f"{row['frames a second']:.1f}; {alone}"


def _stages(row: Row) -> str:
    """Seconds in total, and of four stages."""
    parts = " / ".join(f"{row[f'{stage} [ms]'] / 1000:.2f}" for stage in ("solve", "fields", "render", "bundle"))
    return f"{row['ms a frame'] / 1000:.2f} ({parts})"


def _peers(tables: Tables) -> Told:
    parts = []
    for row in tables.get("At equal error, and at equal time", ()):
        if "P1" in row["method"] and row["best error in our time"] is not None:
            parts.append(f"linear tetrahedra {row['best error in our time']:.0%} off in our time")
        if row["method"].startswith("CalculiX") and row["times ours"] is not None:
            parts.append(f"{row['method']}: {row['times ours']:.0f} times our time to 1 %")
    if parts:
        yield "force of one press by other methods", "; ".join(parts)


def _optics(tables: Tables) -> Told:
    rows = [row for row in tables.get("Pictures", ()) if row["setting"] == "default"]
    for method in dict.fromkeys(row["method"] for row in rows):
        mine = [row for row in rows if row["method"] == method]
        each = {sensor: [row for row in mine if row["sensor"] == sensor] for sensor in SENSORS}
        worst = [min(group, key=lambda row: row["dB"]) for group in each.values() if group]
        yield (
            f"PSNR of images by `{method}` against `path` [dB]",
            _by_sensor(worst, lambda row: f"{row['dB']:.0f}" + (f" +- {row['+-']:.0f}" if row["+-"] >= 1 else "")),
        )


def _stability(tables: Tables) -> Told:
    for row in tables.get("Together", ()):
        parts = [f"{row[status]} {status}" for status in ("ok", "refused", "rejected") if row[status]]
        yield f"{row['scenes']} extreme {row['what']}", ", ".join([*parts, f"{row['wrong']} wrong"])


def _sharp(tables: Tables) -> Told:
    meshes = tables.get("Sharp edges and tips", ())
    rows = {quality: [row for row in meshes if row["quality"] == quality] for quality in ("default", "draft")}
    errors = {
        quality: [abs(row["error"]) for row in some if row["error"] is not None] for quality, some in rows.items()
    }
    if not all(errors.values()):
        return
    middle, worst = ([f"{of(some):.1%}" for some in errors.values()] for of in (median, max))
    told = [Counter(row["within its factor"].partition(":")[0] for row in some) for some in rows.values()]
    yield (
        f"force error of {len(rows['default'])} sharp meshes at `default` (`draft`)",
        f"median {middle[0]} ({middle[1]}), worst {worst[0]} ({worst[1]}); within a factor of 2 of the expected:"
        f" {told[0]['yes']} ({told[1]['yes']}); refused: {told[0]['refused']} ({told[1]['refused']})",
    )


def _pay(tables: Tables) -> Told:
    rows = tables.get("Labels: cost and agreement", [])
    if rows:
        yield "time of stress and maps over that of the solve", _by_sensor(rows, lambda row: f"{row['share']:.1%}")


def _real(tables: Tables) -> Told:
    rows = tables.get("Normals inside the contact circle", [])
    if rows:
        heads = ("flat [deg]", "rendered to real [deg]", "rendered to rendered [deg]", "real to real, left out [deg]")
        yield (
            "error of real normals [deg]: flat / trained on rendered / the same on rendered presses / trained on real",
            _by_sensor(rows, lambda row: " / ".join(f"{row[head]:.1f}" for head in heads if row[head] is not None)),
        )
    for row in tables.get("A population on a unit that it has not seen", []):
        told = " / ".join(f"{row[head]:.1f}" for head in list(row)[2:])
        yield f"the same on {row['unit']}, left out: flat / population of the others / own file / trained on real", told
    for row in tables.get("Depth from grey", []):
        yield "profile of a real press, off by, of its peak", f"9DTact {row['profile off, of peak']:.1%}"


TOLD = {
    "pipeline": _pipeline,
    "ordinary": _ordinary,
    "mechanics": _mechanics,
    "peers": _peers,
    "optics": _optics,
    "real": _real,
    "stability": _stability,
    "sharp": _sharp,
    "pay": _pay,
}
