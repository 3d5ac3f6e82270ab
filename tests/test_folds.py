"""Folds of the gel: frames from them on are marked, or `folds: end` ends a scene before them, in every reader."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command import told
from helpers.small_recipe import BALL, HEAD

import tacgen
from tacgen import mechanics
from tacgen.batch import pipeline
from tacgen.bundle import bundle
from tacgen.bundle.check import FOLDED_NOTE, check
from tacgen.recipe import plan
from tacgen.report import dataset_card, dataset_summary

OUT_OF_BALANCE = 0.023  # of the force, in a frame that folds
ROUGH = f"""{BALL}outputs: [force]
quality: {{edge_mm: 1.2, dhat_mm: 0.15}}
contact: {{friction: 1.0}}
"""


def made(folder: Path, text: str, *sets: str) -> tacgen.Frames:
    (folder / "recipe.yaml").write_text(text)
    row = plan.load(folder / "recipe.yaml", sets).rows[0]
    return tacgen.read(pipeline.run_scene(row, folder / "-".join(["out", *sets])).path)


@pytest.fixture
def folding(monkeypatch: pytest.MonkeyPatch) -> None:
    """A solver whose second frame needs a damped step; without leave to take it, it fails there."""
    states = mechanics.states

    def some(scene: Any, problem: mechanics.Problem, **more: Any) -> Iterator[mechanics.State]:
        folded = touched = False
        for state in states(scene, problem, **more):
            if state.index == 1 and not problem.options.through_folds:
                raise mechanics.NotConverged(mechanics.Failure.folds)
            folded, touched = state.index == 1 or (folded and touched), bool(state.normal_force.any())
            residual = OUT_OF_BALANCE if state.index == 1 else state.residual
            damped = int(state.index == 1)
            yield replace(state, damped=damped, unique=not folded, residual=residual, balance=residual)

    monkeypatch.setattr(mechanics, "states", some)


PRESS = f"{HEAD}  - press: {{depth_mm: 0.3, frames: 3}}\n"


@pytest.mark.usefixtures("folding")
def test_a_scene_ends_before_a_fold_and_every_reader_says_so(tmp_path: Path) -> None:
    frames = made(tmp_path, PRESS, "folds=end")
    file, attrs = frames.bundle.path, frames.bundle.attrs
    assert (len(frames), attrs["frames_planned"], attrs["status"]) == (1, 3, "ok")
    assert attrs["reason"].startswith("ends before frame 2 of 3: the gel folds")
    assert "1 of 3 frames" in repr(frames)
    assert not [finding for finding in check(file) if finding.level == "error"]
    bundle.read(file).verify()


@pytest.mark.usefixtures("folding")
def test_kept_frames_are_marked_from_the_fold_on(tmp_path: Path) -> None:
    frames = made(tmp_path, f"{PRESS}  - release: {{frames: 1}}\n  - press: {{depth_mm: 0.3, frames: 1}}\n")
    assert frames.unique.tolist() == [True, False, False, False, True], "untouched, the gel is as it was"
    findings = check(frames.bundle.path)
    assert {finding.level for finding in findings} == {"note"}, "a fold may be out of balance"
    (note,) = [finding.message for finding in findings if FOLDED_NOTE in finding.message]
    assert "frames 1, 2, 3" in note
    assert "by 2.3% out of balance at most" in note


@pytest.mark.usefixtures("folding")
def test_the_card_and_the_last_line_of_a_run_count_folds(tmp_path: Path) -> None:
    (tmp_path / "recipe.yaml").write_text(PRESS)
    by_kind = "in 2 of 3 frames (`/frames/quality/unique`): sphere 2 of 3; press 2 of 3"
    for folds, says in (("keep", by_kind), ("end", "ended before the gel folds: 1 frames are here")):
        out = tmp_path / folds
        pipeline.run(plan.load(tmp_path / "recipe.yaml", (f"folds={folds}",)).rows, out)
        assert says in dataset_card.text(dataset_summary.look(out))
    said = " ".join(told("run", tmp_path / "recipe.yaml", "-o", tmp_path / "keep", "--set", "folds=keep").split())
    assert "1 scene kept, 0 rejected; 2 of 3 frames after a fold of the gel, where forces are not unique" in said


@pytest.mark.slow
@pytest.mark.parametrize(("depth", "reached", "same"), [(1.2, 6, 5), (1.6, 7, 7)])
def test_shorter_load_steps_go_where_no_damping_is(tmp_path: Path, depth: float, reached: int, same: int) -> None:
    """A rough ball slid by 4 mm: the last frame at 1.2 mm of depth is a fold; at 1.6 mm, steps are only too long."""
    moves = f"trajectory: [press: {{depth_mm: {depth}, frames: 1}}, slide: {{x_mm: 4, frames: 6}}]\n"
    text = ROUGH.replace("radius_mm: 4.0", "radius_mm: 3.0") + moves
    kept, ended = (made(tmp_path, text, f"folds={folds}") for folds in ("keep", "end"))
    assert kept.unique.all() == (reached == 7)
    assert ended.unique.all()
    assert (len(kept), len(ended)) == (7, reached)
    assert np.abs(kept.force[:same] - ended.force[:same]).max() < 0.006 * np.abs(kept.force).max()
    assert json.loads(ended.bundle.attrs["recipe"])["folds"] == "end"
