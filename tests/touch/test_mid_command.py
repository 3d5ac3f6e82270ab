"""The command: its plan, its copy, its parts for job arrays, and what it refuses."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result
from helpers.command import tacgen_

from tacgen.touch import copies, into_rerun, sources
from touch.made_source import COARSE, MOUNT, Made, ball, episode, over

GAPS = [60.0, 9.0, 0.6, -0.2, -0.4, 0.5, 12.0]
PLACE = ",".join(map(str, (*MOUNT.position_mm, *MOUNT.quaternion)))
SENSOR = ["--sensor", "left=gelsight_mini@hand", "--mount", f"left={PLACE}"]


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What was to be written: the episodes of two sources that are not read from files, and their touch."""
    force = np.zeros((len(GAPS), 3))
    force[3:5, 2] = -2.0
    source = Made([episode({"ball": over(GAPS)}, forces=force), "episode 1: joints jump"], [ball("ball", 0.02)])
    found: list[Any] = []
    monkeypatch.setattr(sources, "open_source", lambda *given: source)
    write = lambda source, episodes, touches, out, **how: found.append((out, episodes, touches)) or [out]  # noqa: E731
    monkeypatch.setattr(copies, "write", write)
    monkeypatch.setattr(copies, "refuse", lambda *given, **how: None)
    return found


def run(*args: str) -> Result:
    quality = [part for text in COARSE for part in ("--set", text)]
    return tacgen_("touch", "made", *SENSOR, *quality, *args)


def test_a_plan_writes_nothing(tmp_path: Path, written: list[Any], kept_workers: None) -> None:
    done = run("-o", str(tmp_path / "out"), "--plan")
    assert done.exit_code == 0, done.output
    assert "1 episodes, 7 rows (0.7 s): 29 % of them in contact" in done.output
    assert "to be solved: 1 intervals, 7 frames; the rest is the untouched sensor" in done.output
    assert "  ball at left: 1" in done.output
    assert "of one core" in done.output
    assert written == []
    assert list(tmp_path.iterdir()) == []


def test_parts_are_solved_and_the_whole_is_written(tmp_path: Path, written: list[Any], kept_workers: None) -> None:
    out = tmp_path / "felt"
    part = run("-o", str(out), "--shard", "1/2")
    assert part.exit_code == 0, part.output
    assert written == []
    assert sorted(path.name for path in (tmp_path / "felt-bundles").glob("*.h5")) == ["scene-00001.h5"]
    done = run("-o", str(out))
    assert done.exit_code == 1  # an episode could not be read
    assert "episode 1: joints jump" in done.output
    assert "engine / tacgen" in done.output
    ((where, episodes, touches),) = written
    assert where == out
    assert [one.index for one in episodes] == [0]
    assert touches[0][0].touched == [""] * 3 + ["ball"] * 2 + [""] * 2


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["--match", "both"], "--match both: must be one of pose, force, grip"),
        (["--near-mm", "0"], "--near-mm 0: must be more than 0"),
        (["--set", "trajectory[0].replay.every=2"], "trajectory comes from the episodes"),
        (["--episodes", "1"], "episode 1: joints jump"),
    ],
)
def test_what_is_refused_is_one_line(args: list[str], said: str, tmp_path: Path, written: list[Any]) -> None:
    done = run("-o", str(tmp_path / "out"), *args)
    assert done.exit_code == 2
    assert said in done.output
    assert len([line for line in done.output.splitlines() if not line.startswith("warning")]) == 1
    assert written == []


ROWS, BALL = 20, "ball={shape: sphere, radius_mm: 4}"
GOOD = {
    "time": np.arange(ROWS) / 10,
    "object_position": 100.0 + np.outer(np.abs(np.linspace(-60, 60, ROWS)) + 0.5, [0, 0, 1]),
    "object_quaternion": np.tile([1.0, 0, 0, 0], (ROWS, 1)),
    "sensor_position": np.full((ROWS, 3), 100.0),
    "sensor_quaternion": np.tile([1.0, 0, 0, 0], (ROWS, 1)),
}


def moved(**by: Any) -> dict[str, Any]:
    """The good log with something added to some of its arrays."""
    return GOOD | {name: GOOD[name] + np.asarray(value) for name, value in by.items()}


def up(*rows: int, by: float) -> np.ndarray:
    """By how much the object is higher in some rows, or in all [mm]."""
    return np.where(np.isin(np.arange(ROWS), rows or range(ROWS)), by, 0.0)[:, None] * np.array([0, 0, 1])


ODD = {
    "good": GOOD,
    "gap": {name: np.delete(values, 7, axis=0) for name, values in GOOD.items()},
    "jump": moved(object_position=up(9, by=900.0)),
    "metres": GOOD | {name: GOOD[name] / 1000 for name in ("object_position", "sensor_position")},
    "far": moved(object_position=up(by=500.0)),
    "lost": moved(object_position=up(4, by=np.nan)),
    "open": GOOD | {"force": np.zeros((ROWS, 3))},
    "short": {name: values[:1] for name, values in GOOD.items()},
}
HERE = ["--sensor", "left=gelsight_mini@sensor"]


def touched(folder: Path, names: Sequence[str], *args: str, thing: str = BALL) -> Result:
    """The command on a folder of odd logs."""
    (folder / "logs").mkdir()
    for name in names:
        np.savez(folder / f"logs/{name}.npz", units="mm", quaternion="wxyz", **ODD[name])
    objects = ["--object", thing] if thing else []
    return tacgen_("touch", folder / "logs", *objects, "-o", folder / "out/felt", *args)


@pytest.mark.parametrize(
    ("name", "thing", "args", "said"),
    [
        ("gap", BALL, HERE, "logs: episode gap: row 7: 1 row before it is missing, at 10 rows a second: record"),
        ("jump", BALL, HERE, "logs: episode jump: row 9: ball jumps: it moves at "),
        ("metres", BALL, HERE, "episode metres: all bodies lie within 0.0605 mm: are its lengths metres? Say units: m"),
        ("far", BALL, HERE, "logs: nothing comes near a gel: closest is ball, about 50"),
        ("lost", BALL, HERE, "lost.npz: object_quaternion: row 4: a pose needs numbers"),
        ("short", BALL, HERE, "short.npz: has 1 rows, and at least 2 are needed"),
        ("good", "ball", HERE, "object ball: without a model it needs a surface: --object ball=MESH, or --model"),
        ("good", "ball=none.stl", HERE, "none.stl: no such object file"),
        ("good", "", HERE, "logs: no objects: name them by --object BODY"),
        ("good", BALL, ["--sensor", "left=gelsight_mimi@sensor"], "'gelsight_mimi'; did you mean gelsight_mini?"),
        ("good", BALL, ["--sensor", "left=digit@hand"], "has no body hand for --sensor left (it has: ball, sensor)"),
        ("good", BALL, ["--sensor", "left=digit@ball"], "no object but the bodies of the sensors: name one by"),
        ("good", BALL, [*HERE, "--sensor", "right=digit@sensor"], "--sensor right: is where left is, on sensor: name"),
        ("good", BALL, [*HERE, "--match", "grip"], "--match grip: needs two fingers, and 1 are given by --sensor"),
        ("good", BALL, [*HERE, "--episodes", "3"], "logs: holds no episode of those that are asked for"),
    ],
)
def test_odd_episodes_are_told_in_one_line_and_nothing_is_written(
    name: str, thing: str, args: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(into_rerun, "refuse", lambda: None)
    done = touched(tmp_path, [name], *args, thing=thing)
    assert done.exit_code == 2, done.output
    assert said in done.output
    assert len(done.output.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["logs"]


def test_what_is_odd_is_told_of_the_episodes_that_are_asked_for(tmp_path: Path, kept_workers: None) -> None:
    names = ["far", "good", "open"]  # in this order
    done = touched(tmp_path, names, *HERE, "--episodes", "1", "--plan")
    assert (done.exit_code, "warning" in done.output) == (0, False), done.output
    done = tacgen_("touch", tmp_path / "logs", "--object", BALL, *HERE, "-o", "x", "--plan")
    assert done.exit_code == 0
    (line,) = [line for line in done.output.splitlines() if line.startswith("warning")]
    assert "episode open: its gripper never closes, and no --object presses on it: check grip and forces" in line


def test_a_package_that_lacks_is_told_before_solving(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    done = touched(tmp_path, ["good"], *HERE)
    assert (done.exit_code, done.output) == (2, "touch into Rerun needs Rerun: pip install 'tacgen[rerun]'\n")
