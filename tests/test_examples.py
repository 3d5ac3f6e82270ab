"""The examples that train run, and say what they hold back; skipped where PyTorch is not installed."""

import json
import os
import shutil
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from helpers.needs import needs
from helpers.program import loaded, ran
from helpers.small_recipe import PICTURE
from PIL import Image

from tacgen.batch import pipeline
from tacgen.bundle.bundle import read
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


DEPTHS = """outputs: [force, rgb]
vary: {method: grid, over: {"trajectory[0].press.depth_mm": {linspace: [0.1, 0.8, 4]}}}
"""


@pytest.fixture(scope="module")
def transfer() -> ModuleType:
    return loaded(ROOT / "examples" / "force_transfer.py")


@pytest.fixture(scope="module")
def pressed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four presses as bundles, and their pictures as photographs with forces."""
    out = tmp_path_factory.mktemp("transfer")
    (out / "small.yaml").write_text(PICTURE + DEPTHS)
    pipeline.run(plan.load(out / "small.yaml").rows, out / "data")
    (out / "photos").mkdir()
    lines = ["file,force_n,recording,time_s,untouched"]
    for k in range(4):
        bundle = read(out / "data" / f"scene-{k:05d}.h5")
        Image.fromarray(bundle["/frames/rgb"][0]).save(out / "photos" / f"{k}.png")
        Image.fromarray(bundle["/reference/rgb"]).save(out / "photos" / "plain.png")
        lines.append(f"{k}.png,{-bundle['/frames/force'][0, 2]},grip,{k / 30:.3f},plain.png")
    (out / "photos" / "presses.csv").write_text("\n".join(lines) + "\n")
    return out


def test_a_photograph_is_seen_as_the_frame_it_was_taken_of(transfer: ModuleType, pressed: Path) -> None:
    frames, photos = transfer.rendered(pressed / "data"), transfer.photographed(pressed / "photos")
    assert torch.allclose(frames.picture, photos.picture)
    assert torch.allclose(frames.force, photos.force)
    assert frames.force.min() > 0
    assert photos.time == pytest.approx(np.arange(4) / 30, abs=1e-3)


def test_the_gauges_lag_is_found_for_each_recording(transfer: ModuleType) -> None:
    time = np.arange(20) / 30
    grips = [np.interp(time - lag, time, 25 * np.sin(5 * time).clip(0)) for lag in (0.1, -0.05)]
    said = torch.tensor(np.tile(25 * np.sin(5 * time).clip(0), 2))
    presses = transfer.Presses(
        torch.zeros(40, 3, 1, 1), torch.tensor(np.concatenate(grips)), np.repeat(["a", "b"], 20), np.tile(time, 2)
    )
    assert np.abs(said.numpy() - presses.force.numpy()).mean() > 2
    assert np.abs(transfer.without_lag(said.numpy(), presses) - presses.force.numpy()).max() < 0.1
    timeless = presses._replace(time=np.full(40, np.nan))
    assert np.array_equal(transfer.without_lag(said.numpy(), timeless), said.numpy())


def test_the_script_sets_each_way_beside_floor_and_ceiling(
    transfer: ModuleType, pressed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(transfer, "BATCH", 8)
    monkeypatch.setattr(transfer, "STEPS", 100)
    monkeypatch.setattr(transfer, "FEW_STEPS", 100)
    photos, two = pressed / "photos", tmp_path / "two"
    shutil.copytree(photos, two)
    header, first, *_, last = (photos / "presses.csv").read_text().splitlines()
    (two / "presses.csv").write_text(f"{header}\n{first}\n{last}\n")
    command = ["x", pressed / "data", "--few", photos, "--judge", two, "-o", tmp_path, "--seeds", "1"]
    monkeypatch.setattr("sys.argv", list(map(str, command)))
    transfer.main()
    found = json.loads((tmp_path / "results.json").read_text())
    true = np.array(found.pop("true_n"))
    ways = ("mean of the few", "rendered alone", "rendered, one contrast", "the few alone", "rendered, then the few")
    assert tuple(found) == (*ways, "others, each left out")
    floor = found["mean of the few"][0]
    assert floor["mae_n"] == pytest.approx(
        np.abs(true - transfer.photographed(photos).force.numpy().mean()).mean(), rel=1e-5
    )
    assert floor["r"] is None
    for name in ("rendered alone", "the few alone", "rendered, then the few"):  # the same presses are learned
        assert found[name][0]["mae_n"] < 0.6 * floor["mae_n"], name
    assert (tmp_path / "table.md").read_text().count("\n") == 8
    assert (tmp_path / "forces.png").stat().st_size > 5000
