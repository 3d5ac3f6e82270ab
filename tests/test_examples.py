"""The examples run, and say what they hold back; skipped where PyTorch is not installed."""

import json
import os
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from helpers.needs import needs
from helpers.program import loaded, ran
from helpers.small_recipe import PICTURE

from tacgen.batch import pipeline
from tacgen.recipe import plan

torch = needs("torch")
ROOT = Path(__file__).parents[1]
SCRIPT = ROOT / "examples" / "baselines.py"
VARIED = """outputs: [force, events, height, normals, rgb]
vary:
  method: grid
  over:
    indenter:
      choice:
        - {shape: sphere, radius_mm: 3.0}
        - {shape: sphere, radius_mm: 5.0}
        - {shape: torus, radius_mm: 3.0, tube_radius_mm: 1.0}
    start.x_mm: {linspace: [-2, 2, 3]}
"""


@pytest.fixture(scope="module")
def baselines() -> ModuleType:
    return loaded(SCRIPT)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Nine scenes of three indenters, of one frame each."""
    out = tmp_path_factory.mktemp("baseline")
    (out / "small.yaml").write_text(PICTURE + VARIED)
    pipeline.run(plan.load(out / "small.yaml").rows, out / "data")
    return out / "data"


@pytest.mark.slow
def test_the_script_writes_weights_scores_plot_and_table(folder: Path, tmp_path: Path) -> None:
    options = ("--seeds", 2, "--epochs", 1, "--workers", 1)
    ran(SCRIPT, folder, "-o", tmp_path, *options, PYTHONPATH=os.pathsep.join(sys.path))
    found = json.loads((tmp_path / "results.json").read_text())
    assert [one["test"] for one in found] == ["scenes"] * 2 + ["indenter"] * 3
    left_out = [one["held_back"] for one in found[2:]]
    assert sorted(k for scenes in left_out for k in scenes) == list(range(9))
    assert {len(scenes) for scenes in left_out} == {3}
    assert all(np.isfinite(list(one["network"].values())).all() for one in found)
    assert "scenes: normal force by range" in (tmp_path / "force_ranges.md").read_text()
    assert all(set(one["normal"]) == {"true", "said", "learned"} for one in found)
    assert (tmp_path / "table.md").read_text().startswith("| | scenes: network | scenes: guess | indenter: network |")
    assert "force x [N]" in (tmp_path / "table.md").read_text()
    assert torch.load(tmp_path / "network.pt")["shapes"] == ["sphere", "torus"]
    assert (tmp_path / "test.png").stat().st_size > 10_000


def test_the_truth_scores_best_and_the_network_comes_near_it(baselines: ModuleType, folder: Path) -> None:
    data = baselines.read(folder)
    frames = data.part(np.ones(9, bool))
    best = baselines.scores(frames, frames)
    assert {name: value for name, value in best.items() if "right" in name} == {
        "mode, right": 1, "mode, right, mean over modes": 1, "shape, right": 1,
    }  # fmt: skip
    assert max(value for name, value in best.items() if "right" not in name) < 0.1
    said = baselines.predicted(*baselines.trained(frames, 2, seed=0, epochs=150), frames)
    network, guess = baselines.scores(said, frames), baselines.scores(baselines.guessed(frames, frames), frames)
    assert network["force z [N]"] < 0.5 * guess["force z [N]"]
    assert network["depth [mm]"] < 0.5 * guess["depth [mm]"]
    assert network["shape, right"] == 1
