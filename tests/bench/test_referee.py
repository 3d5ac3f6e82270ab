"""The referee: what is played, how an answer is scored, and what the page says of players that fail."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks import calculix
from benchmarks.referee import __main__ as referee
from benchmarks.referee import reference, report, set_up
from benchmarks.referee.case import CASES, CELL_MM, SHAPES, Case, mesh_of, spread
from benchmarks.referee.player import Answer, NotPlayed
from benchmarks.referee.players import calculix_player, felupe_player
from benchmarks.referee.players.tacgen_player import Tacgen
from benchmarks.referee.score import score
from tacgen.base.errors import UserError

pytestmark = pytest.mark.usefixtures("own_cache")
COARSE = "{edge_mm: 1.0, dhat_mm: 0.05}"
NAMED = {case.name: case for case in CASES}
PRESS, SLIDE, GRASP = NAMED["press ball"], NAMED["slide ball, friction .3"], NAMED["grasp box"]


class Stubborn:
    """A player that says twice the force and plays no grasp, or is not installed."""

    name, settings = "stubborn", ("default", "tuned")

    def __init__(self, missing: str | None = None) -> None:
        self.missing = missing

    def available(self) -> str | None:
        return self.missing

    def version(self) -> str:
        return "stubborn 1"

    def play(self, case: Case, setting: str) -> Answer:
        if case.mass_kg:
            raise NotPlayed("holds nothing")
        right = reference.kept()[case.name].answer
        times = 2.0 if setting == "default" else 1.001
        return replace(right, force=times * right.force, seconds=0.5, settings={"times": times})


def test_two_cases_by_two_players(tmp_path: Path) -> None:
    hexes = Tacgen("tacgen", {"default": COARSE})
    tets = Tacgen("linear tets", {"default": COARSE}, ("mesh=linear_tet",))
    stubborn, absent = Stubborn(), Stubborn("not installed: pip install stubborn")
    absent.name = "absent"
    cases = [PRESS, SLIDE, GRASP]
    found = [entry for one in (hexes, tets) for entry in referee.entries(one, cases[:2], print)]
    found += [entry for one in (stubborn, absent) for entry in referee.entries(one, cases, print)]
    ours, theirs = found[0]["cases"], found[1]["cases"]
    assert max(ours[PRESS.name]["force"]) < 0.13
    assert min(theirs[PRESS.name]["force"]) > 2 * max(ours[PRESS.name]["force"])
    assert ours[SLIDE.name]["judge"].startswith("FElupe")
    judge = {**found[0], "player": "FElupe"}
    assert not report.scores(judge)  # what it judges itself is no score of its own
    assert found[2]["cases"][PRESS.name]["normal"] == pytest.approx([1.0] * 3)
    report.write(tmp_path, found)
    page = (tmp_path / report.PAGE).read_text()
    assert f"beaten in `{PRESS.name}` (stubborn, tuned" in page
    assert f"| stubborn | default | 2 | {np.mean(report.values(found[2], 'normal')):.1%} |" in page
    told = json.loads((tmp_path / "results" / "referee.json").read_text())
    missing = next(table for table in told["tables"] if table["title"] == "Not run")["rows"]
    assert ["absent", "all", absent.missing] in missing
    assert ["stubborn, default", GRASP.name, "holds nothing"] in missing
    report.write(tmp_path, list(referee.entries(Stubborn("gone"), cases, print)))
    again = json.loads((tmp_path / "results" / "referee.json").read_text())["entries"]
    assert {(one["player"], one["setting"]) for one in again} == {
        (one["player"], one["setting"]) for one in found
    }  # what ran elsewhere stays


def test_a_player_of_markers_alone_has_no_force_and_one_on_a_gpu_says_so(tmp_path: Path) -> None:
    class OnGpu(Stubborn):
        """Without forces by default."""

        def play(self, case: Case, setting: str) -> Answer:
            known = np.nan if setting == "default" else 1.0
            said = super().play(case, setting)
            return replace(said, force=known * said.force, torque=known * said.torque, on_gpu=True)

    found = list(referee.entries(OnGpu(), [SLIDE], print))
    one = found[0]["cases"][SLIDE.name]
    assert one["force"] == one["normal"] == one["own"] == one["torque"] == [] != one["markers"] == 0
    assert not one["resolved"]
    slow = found[1]["cases"][SLIDE.name] | {"on_gpu": False, "seconds": 9.0}
    ours = {"player": "tacgen", "setting": "default", "version": "", "settings": {}, "cases": {SLIDE.name: slow}}
    report.write(tmp_path, [*found, ours])
    page = (tmp_path / report.PAGE).read_text()
    assert "No other player is nearer" in page
    assert "Faster" not in page  # on a core
    assert [line.split("|")[-2].strip() for line in page.splitlines() if line.startswith("| stubborn |")] == ["GPU"] * 2


def test_a_right_answer_has_no_error_and_a_wrong_sign_one_of_two() -> None:
    right = reference.kept()[SLIDE.name]
    none = score(SLIDE, right.answer, right)
    assert max(*none.force, *none.torque, none.pressure or 0, none.traction or 0, none.markers or 0) == 0
    wrong = score(SLIDE, replace(right.answer, force=-right.answer.force), right)
    assert wrong.force == pytest.approx([2.0] * 3)
    moved = replace(right.answer, markers=np.asarray(right.answer.markers) + np.array([0.1, 0.0]))
    assert score(SLIDE, moved, right).markers == pytest.approx(1.6, rel=1e-6)


def test_the_references_are_kept_and_keep_statics() -> None:
    kept = reference.kept()
    assert kept.keys() == NAMED.keys()
    for case in CASES:
        answer = kept[case.name].answer
        assert answer.force.shape == answer.torque.shape == (len(case.judged), 3)
        if answer.pressure is not None:
            total = CELL_MM**2 * answer.pressure.sum((1, 2))
            assert total == pytest.approx(-answer.force[:, 2], abs=2e-3 * abs(answer.force).max()), case.name
    assert kept[GRASP.name].answer.force[0] == pytest.approx([0, GRASP.weight, 0], abs=1e-5)
    assert not kept["release ball"].answer.force[-1].any()


def test_forces_are_spread_over_cells_without_loss() -> None:
    rng = np.random.default_rng(0)
    points, forces = rng.uniform(-9, 9, (50, 3)), rng.normal(size=(50, 3))
    pressure, traction = spread(points, forces)
    assert -(CELL_MM**2) * pressure.sum() == pytest.approx(forces[:, 2].sum())
    assert CELL_MM**2 * traction.sum((0, 1)) == pytest.approx(forces[:, :2].sum(0))


@pytest.mark.parametrize("shape", [*SHAPES, "box"])
def test_shapes_are_closed_and_stand_on_the_origin(shape: str) -> None:
    made = mesh_of(shape)  # type: ignore[arg-type]
    assert made.is_watertight
    assert made.bounds[0, 2] == pytest.approx(0, abs=1e-9)


@pytest.mark.slow
@pytest.mark.skipif(not calculix.installed(), reason="needs CalculiX: apt install calculix-ccx")
def test_calculix_gives_the_reference_on_a_coarse_mesh() -> None:
    case = replace(PRESS, poses=PRESS.poses[-1:], judged=(0,))
    found = calculix_player.run(case, {"scale": 3.0})
    assert found.force[0] == pytest.approx(reference.kept()[case.name].answer.force[-1], abs=0.06)


def test_errors_are_for_people(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(felupe_player.PLAYERS[0]), "available", lambda _: "not installed")
    assert referee.main(["--players", "linear_tets", "--cases", PRESS.name, "--reference"]) == 2
    assert "pip install felupe pypardiso" in capsys.readouterr().err


def test_minutes_to_set_up_are_those_of_pip_and_the_first_press(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = list[list[str]]()

    def run(command: list[str], **known: Any) -> SimpleNamespace:
        asked.append(list(command))
        assert not Path(known["env"]["XDG_CACHE_HOME"]).exists()
        return SimpleNamespace(returncode="felupe" in command, stderr="Traceback\nno such package")

    monkeypatch.setattr(set_up.subprocess, "run", run)
    assert 0 <= set_up.minutes("mujoco_rigid") < 0.1
    assert "mujoco" in asked[0]
    assert asked[1][-4:-2] == ["--cases", PRESS.name]
    with pytest.raises(UserError, match="felupe was not set up: no such package"):
        set_up.minutes("felupe")
    with pytest.raises(UserError, match="calculix was not set up: pip does not install it"):
        set_up.minutes("calculix")
    monkeypatch.setattr(
        set_up.subprocess, "run", lambda *_, **__: SimpleNamespace(returncode=0, stderr="x: not run: y")
    )
    with pytest.raises(UserError, match="mujoco_flex was not set up: x: not run: y"):
        set_up.minutes("mujoco_flex")
