"""The bench of frames to disk with a GPU: what it counts and compares; and what it reads of a GPU's board."""

import os
import time
from pathlib import Path

import pytest

from benchmarks import gpu_board, tensor_disk
from benchmarks.gpu_board import Board


def test_rates_of_a_run() -> None:
    ends = [(5.0, 10), (6.0, 10), (14.0, 10), (15.5, 4), (25.0, 10)]
    ran = tensor_disk.Ran({"ok": 4, "rejected": 1}, ends, 30.0, 2.2, Board([100.0, 400.0], [1.0, 2.0]))
    assert str(ran) == (
        "44 frames in 30.0 s (4 ok, 1 rejected): 1 a second; the first scene at 5.0 s, then 2 a second, 3 in the best"
        " 10 s; 50.0 ms of a core a frame; 0.5 kJ of the GPU's board, at most 400 W, 2.0 GB"
    )


def test_bundles_that_differ(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        for scene in ("scene-0.h5", "scene-1.h5"):
            (tmp_path / name / scene).write_bytes(scene.encode())
    assert [*tensor_disk.unlike(tmp_path / "a", tmp_path / "b")] == []
    (tmp_path / "b" / "scene-1.h5").write_bytes(b"scene-2.h5")
    (tmp_path / "b" / "scene-0.h5").unlink()
    assert [*tensor_disk.unlike(tmp_path / "a", tmp_path / "b")] == ["scene-0.h5", "scene-1.h5"]


def test_a_command_that_fails_is_told(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match=r"quality\.edge: unknown|unknown"):
        tensor_disk.made(tmp_path / "out", "local", 1, ["quality={edge: 1}"], 1)


def test_board_adds_up_the_gpus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = tmp_path / "nvidia-smi"
    fake.write_text(
        '#!/bin/sh\nif [ "$1" = -L ]; then echo GPU 0; echo GPU 1; exit; fi\n'
        "echo 100.5, 2000; echo 50.0, 1000; echo 200.0, 3000; echo '[N/A], 0'; echo 1.0, 4000; exec sleep 60\n"
    )
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    with gpu_board.watched() as board:
        end = time.monotonic() + 20
        while len(board.watts) < 3 and time.monotonic() < end:
            time.sleep(0.01)
    assert board == Board([150.5, 200.0, 1.0], [3.0, 3.0, 4.0])
    assert board.joules == 351.5


def test_no_board(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with gpu_board.watched() as board:
        pass
    assert str(board) == "no GPU's board can be read"
