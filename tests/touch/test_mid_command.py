"""The command: its plan, its copy, its parts for job arrays, and what it refuses."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

from tacgen.cli.main import app
from tacgen.touch import copies, sources
from tacgen.touch.episode import EpisodeLog, Episodes, Touch
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

    def write(
        source: Episodes,
        episodes: Sequence[EpisodeLog],
        touches: Sequence[Sequence[Touch]],
        out: Path,
        *,
        overwrite: bool,
    ) -> list[Path]:
        found.append((out, episodes, touches))
        return [out]

    monkeypatch.setattr(sources, "open_source", lambda *given: source)
    monkeypatch.setattr(copies, "write", write)
    monkeypatch.setattr(copies, "refuse", lambda *given, **how: None)
    return found


def run(*args: str) -> Result:
    quality = [part for text in COARSE for part in ("--set", text)]
    return CliRunner().invoke(app, ["touch", "made", *SENSOR, *quality, *args])


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
        (["--episodes", "7"], "made: holds no episode of those that are asked for"),
        (["--episodes", "1"], "episode 1: joints jump"),
        (["--sensor", "right=gelsight_mimi@hand"], "gelsight_mimi"),
        (["--sensor", "right=digit@arm"], "has no body arm for --sensor right (it has: ball, hand)"),
    ],
)
def test_what_is_refused_is_one_line(args: list[str], said: str, tmp_path: Path, written: list[Any]) -> None:
    done = run("-o", str(tmp_path / "out"), *args)
    assert done.exit_code == 2
    assert said in done.output
    assert len([line for line in done.output.splitlines() if not line.startswith("warning")]) == 1
    assert written == []
