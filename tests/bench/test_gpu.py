"""The bench of a GPU: what it counts and compares; its code runs on PyTorch's CPU backend too."""

import argparse

import numpy as np
import pytest
from helpers.needs import needs

from benchmarks import gpu
from benchmarks.gpu import Alone

COARSE = "{edge_mm: 1.6, dhat_mm: 0.14}"


def test_rates_of_a_run() -> None:
    ends = [(5.0, 10), (6.0, 10), (14.0, 10), (15.5, 4), (25.0, 10)]
    assert gpu.rates(ends, 30.0) == (
        "44 frames in 30.0 s: 1.5 a second; the first scene at 5.0 s, then 1.7 a second, 3.0 in the best 10 s"
    )


def test_forces_are_compared_up_to_the_first_damped_frame(capsys: pytest.CaptureFixture[str]) -> None:
    force = np.array([[0, 0, -1.0], [0, 0, -2.0], [0, 0, -4.0]])
    gpu.compare([Alone(7, force, 2, 1.0, False)], {7: force * [[1.0], [1.01], [3.0]]})
    assert "of 1 of 1 scenes" in (told := capsys.readouterr().out)
    assert "5.0e-03 (median), 5.0e-03 (draw 7); 1 by more than 1e-3" in told


def test_both_engines_solve_a_draw_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    needs("torch")
    monkeypatch.setattr(gpu, "BEGUN", [])
    monkeypatch.setattr(gpu, "WARM", 0)
    core, plan = gpu.alone(1, COARSE), gpu.planned(1, COARSE)
    assert plan is not None
    monkeypatch.setattr(gpu, "BEGUN", [])
    found = gpu.batched([plan], argparse.Namespace(device="cpu", processes=1, seconds=60.0), True)
    ((at, frames),) = found.ends
    assert found.begun < at <= found.ended
    assert frames == len(core.forces)
    assert found.forces[1][: core.stable] == pytest.approx(core.forces[: core.stable], abs=1e-4)
