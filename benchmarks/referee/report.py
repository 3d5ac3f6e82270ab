"""The referee's figures: tables, a picture, and the page docs/referee.md."""

import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import results_page
from benchmarks.referee import reference, set_up
from benchmarks.referee.case import CASES
from benchmarks.results_page import Cell, Plot, Result, Series, Table, columns

PAGE, NAME = "referee.md", "referee"
OURS, JUDGE = "tacgen", "FElupe"
SHOWN = 2  # tables on the page, the first ones
MOST_SHOWN = 0.9  # largest mean error of a player whose errors by case are shown; to say 0 has 1 [-]
LEFT = f"Left out: what is off by more than {MOST_SHOWN:.0%}."
LEAST_DIFFERENCE = 0.001  # of mean errors of the force that is told [-]
TEXT = Path(__file__).with_name("page.md")
ABOUT = (
    "Each simulator presses, slides, twists and tilts a rigid body on one pad, 20 x 20 x 4 mm, neo-Hookean, E 0.2 MPa,"
    " nu 0.48. Errors of the force are parts of its size in each frame; maps are compared as L2 norms after a blur of"
    " half a millimetre, markers in pixels of 1/16 mm."
)
Entry = dict[str, Any]
MEANS: tuple[tuple[str, str, Callable[[list[float]], float]], ...] = (
    ("normal: .1%", "normal", np.mean),
    ("normal, worst: .1%", "normal", np.max),
    ("tangential: .1%", "tangential", np.mean),
    ("tangential, worst: .1%", "tangential", np.max),
    ("torque: .1%", "torque", np.mean),
    ("pressure: .0%", "pressure", np.mean),
    ("traction: .0%", "traction", np.mean),
    ("markers [px]: .2f", "markers", np.mean),
    ("s a frame: .3g", "seconds", np.median),  # a grasp takes far longer than others
)


def write(folder: Path, found: Sequence[Entry]) -> None:
    """Write tables, picture and page; entries of the same player and setting that are there already are replaced, case
    by case, and others stay."""
    results = folder / "results"
    file = results / f"{NAME}.json"
    there = json.loads(file.read_text())["entries"] if file.exists() else []
    every = {(one["player"], one["setting"]): one for one in there}
    for one in found:
        key = one["player"], one["setting"]
        if one["setting"]:
            every.pop((one["player"], ""), None)  # it was not run before
        elif any(name == one["player"] for name, setting in every if setting):
            continue  # it ran elsewhere
        before = every[key]["cases"] if key in every else {}
        every[key] = {**one, "date": time.strftime("%Y-%m-%d"), "cases": before | one["cases"]}
    made = sorted(every.values(), key=lambda one: (one["player"] != OURS, one["player"], one["setting"]))
    result = Result(ABOUT, tables(made), [picture(made)])
    results_page.write(results, NAME, result, 0.0)
    plain = json.loads(file.read_text()) | {"entries": made}
    file.write_text(json.dumps(plain, indent=1) + "\n")
    parts = [TEXT.read_text().format(first=first(made)).strip(), f"![{NAME}](results/{NAME}.png)"]
    for table in plain["tables"][:SHOWN]:
        parts += [f"### {table['title']}", results_page.grid(table), *filter(None, [table["note"]])]
    (folder / PAGE).write_text("\n\n".join(parts) + "\n")


def scores(entry: Entry) -> dict[str, Entry]:
    """The cases that an entry has played and that something else has judged, by name."""
    return {
        name: one
        for name, one in entry["cases"].items()
        if "not_played" not in one and not one["judge"].startswith(entry["player"])
    }


def values(entry: Entry, part: str) -> list[float]:
    """The errors of one kind in all cases and frames."""
    found = (one[part] for one in scores(entry).values())
    return [v for each in found if each is not None for v in (each if isinstance(each, list) else [each])]


def seconds(entry: Entry) -> float:
    """Seconds a frame: the median over cases, of which a grasp takes far longer than others."""
    return float(np.median(values(entry, "seconds")))


def on_gpu(entry: Entry) -> bool:
    return any(values(entry, "on_gpu"))


def label(entry: Entry) -> str:
    return f"{entry['player']}, {entry['setting']}"


def tables(entries: Sequence[Entry]) -> list[Table]:
    """Players; the errors of the force by case; the references; settings; who did not run."""
    ran = [one for one in entries if one["setting"] and (scores(one) or one["player"] != JUDGE)]
    minutes = set_up.kept()
    rows: list[list[Cell]] = []
    for one in ran:
        numbers: list[Cell] = [float(how(v)) if (v := values(one, part)) else None for _, part, how in MEANS]
        last: tuple[Cell, Cell] = minutes.get(one["player"]), "GPU" if on_gpu(one) else None
        rows.append([one["player"], one["setting"], len(scores(one)), *numbers, *last])
    heads = columns("player", "setting", "cases: d", *(head for head, *_ in MEANS), "minutes to set up: .1f", "on")
    by_case: list[list[Cell]] = [
        [label(one), *(float(np.mean(one["cases"][c.name]["force"])) if c.name in scores(one) else None for c in CASES)]
        for one in ran
        if np.mean(values(one, "force") or 1.0) < MOST_SHOWN
    ]
    kept = reference.kept()
    errors = [float(np.mean(kept[c.name].force_error) / _size(c.name)) if c.name in kept else None for c in CASES]
    by_case.append(["the reference's own error", *errors])
    judges: list[list[Cell]] = [
        [c.name, kept[c.name].judge, "; ".join(" ".join(f"{v:.3f}" for v in f) for f in kept[c.name].answer.force), e]
        for c, e in zip(CASES, errors, strict=True)
        if c.name in kept
    ]
    settings: list[list[Cell]] = [
        [label(one), one["version"], ", ".join(f"{k} {v}" for k, v in one["settings"].items()), one["date"]]
        for one in ran
    ]
    absent: list[list[Cell]] = [[one["player"], "all", one["not_run"]] for one in entries if not one["setting"]]
    absent += [
        [label(one), name, case["not_played"]]
        for one in ran
        for name, case in one["cases"].items()
        if "not_played" in case
    ]
    return [
        Table("Players", heads, rows),
        Table("Error of the force by case", columns("player", *(f"{c.name}: .1%" for c in CASES)), by_case, LEFT),
        Table("References", columns("case", "judged by", "force in each frame [N]", "own error: .2%"), judges),
        Table("Settings", columns("player", "version", "settings", "date"), settings),
        Table("Not run", columns("player", "case", "why"), absent),
    ]


def _size(name: str) -> float:
    return float(np.linalg.norm(reference.kept()[name].answer.force, axis=1).max())


def picture(entries: Sequence[Entry]) -> Plot:
    """Error of the force against time."""
    series = dict[str, Series]()
    for one in entries:
        if values(one, "force"):
            name = one["player"] + ", on a GPU" * on_gpu(one)
            points = series.setdefault(name, Series(name, [], [], []))
            points.x.append(seconds(one))
            points.y.append(float(np.mean(values(one, "force"))))
            points.labels.append(one["setting"])
    return Plot("Error of the contact force", "s a frame", "mean error of the force [-]", list(series.values()))


def first(entries: Sequence[Entry]) -> str:
    """Where tacgen loses, told from the figures."""
    ran = {label(one): one for one in entries if values(one, "force")}
    if (ours := ran.get(f"{OURS}, default")) is None:
        return "tacgen has not played yet."
    errors = {name: float(np.mean(one["force"])) for name, one in scores(ours).items()}
    worst = max(errors, key=lambda name: errors[name])
    text = f"At default quality tacgen's forces are off by {np.mean(list(errors.values())):.1%} in the mean of"
    text += f" {len(errors)} cases, and most in `{worst}`: {errors[worst]:.1%}."
    sure = sum(bool(one["resolved"]) for one in scores(ours).values())
    text += f" The reference is ten times as sure as that in {sure} of them."
    others = {name: one for name, one in ran.items() if one["player"] != OURS}
    lost = []
    for name, error in errors.items():
        better = {who: float(np.mean(scores(one)[name]["force"])) for who, one in others.items() if name in scores(one)}
        apart = max(float(np.mean(scores(ours)[name]["own"])), LEAST_DIFFERENCE)
        if better and better[who := min(better, key=lambda one: better[one])] < error - apart:
            lost.append(f"`{name}` ({who}: {better[who]:.1%})")
    text += f" It is beaten in {', '.join(lost)}." if lost else " No other player is nearer in any of them."
    if faster := sorted({one["player"] for one in others.values() if not on_gpu(one) and seconds(one) < seconds(ours)}):
        text += f" Faster a frame than its {seconds(ours):.2g} s: {', '.join(faster)}."
    return text
