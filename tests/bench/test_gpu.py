"""The bench of a GPU: what it counts, compares, and reads of a board; its code runs on PyTorch's CPU backend too."""

import argparse
import os
import time
from pathlib import Path

import numpy as np
import pytest
from helpers.needs import needs

from benchmarks import gpu
from benchmarks.gpu import Alone, Board

COARSE = "{edge_mm: 1.6, dhat_mm: 0.14}"


def test_rates_of_a_run() -> None:
    ends = [(5.0, 10), (6.0, 10), (14.0, 10), (15.5, 4), (25.0, 10)]
    ran = gpu.Made({"ok": 4, "rejected": 1}, ends, 30.0, 2.2, Board([100.0, 400.0]))
    assert str(ran) == (
        "4 ok, 1 rejected; 44 frames in 30.0 s: 1.5 a second; the first scene at 5.0 s, then 1.7 a second, 3.0 in the"
        " best 10 s; 50.0 ms of a core a frame; 0.5 kJ of the GPU's board, at most 400 W"
    )


def test_bundles_that_differ(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        for scene in ("scene-0.h5", "scene-1.h5"):
            (tmp_path / name / scene).write_bytes(scene.encode())
    assert [*gpu.unlike(tmp_path / "a", tmp_path / "b")] == []
    (tmp_path / "b" / "scene-1.h5").write_bytes(b"scene-2.h5")
    (tmp_path / "b" / "scene-0.h5").unlink()
    assert [*gpu.unlike(tmp_path / "a", tmp_path / "b")] == ["scene-0.h5", "scene-1.h5"]


def test_a_command_that_fails_is_told(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match=r"quality\.edge: unknown|unknown"):
        gpu.made(tmp_path / "out", "local", 1, ["quality={edge: 1}"], 1)


def test_board_adds_up_the_gpus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = tmp_path / "nvidia-smi"
    fake.write_text(
        '#!/bin/sh\nif [ "$1" = -L ]; then echo GPU 0; echo GPU 1; exit; fi\n'
        "echo 100.5; echo 50.0; echo 200.0; echo '[N/A]'; echo 1.0; exec sleep 60\n"
    )
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    with gpu.watched() as board:
        end = time.monotonic() + 20
        while (len(board) < 3 or board[-1] == 0) and time.monotonic() < end:
            time.sleep(0.01)
    assert board == [150.5, 200.0, 1.0]
    monkeypatch.setenv("PATH", "")
    with gpu.watched() as board:
        pass
    assert str(board) == "no GPU's board"


def test_forces_are_compared_up_to_the_first_damped_frame(capsys: pytest.CaptureFixture[str]) -> None:
    force = np.array([[0, 0, -1.0], [0, 0, -2.0], [0, 0, -4.0]])
    gpu.compare([Alone(7, force, 2, 1.0, False)], {7: force * [[1.0], [1.01], [3.0]]})
    assert "of 1 of 1 scenes" in (told := capsys.readouterr().out)
    assert "5.0e-03 (median), 5.0e-03 (draw 7); 1 by more than 1e-3" in told


def test_both_engines_solve_a_draw_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    needs("torch")
    monkeypatch.setattr(gpu, "BEGUN", [])
    monkeypatch.setitem(gpu.WARM, "frames", 0)
    core, plan = gpu.alone(1, COARSE), gpu.planned(1, COARSE)
    assert plan is not None
    monkeypatch.setattr(gpu, "BEGUN", [])
    found = gpu.batched([plan], argparse.Namespace(device="cpu", processes=1, seconds=60.0), True)
    ((at, frames),) = found.ends
    assert found.begun < at <= found.ended
    assert frames == len(core.forces)
    assert found.forces[1][: core.stable] == pytest.approx(core.forces[: core.stable], abs=1e-4)


def test_pictures_are_drawn_as_a_run_draws_them() -> None:
    """With the Mini's glare, without which counts are 3 off in the mean."""
    needs("torch")
    told = gpu.pictured("gelsight_mini", "draft", "cpu", count=1)
    assert told.endswith("0.00000 and 0")
