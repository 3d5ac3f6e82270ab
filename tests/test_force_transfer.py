"""The example of forces from real pictures: its inputs, its gauge's lag, and its script; skipped without PyTorch."""

import json
import shutil
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from helpers.needs import needs
from helpers.program import loaded
from helpers.small_recipe import PICTURE
from PIL import Image

from tacgen.batch import pipeline
from tacgen.bundle.bundle import read
from tacgen.recipe import plan

torch = needs("torch")
SCRIPT = Path(__file__).parents[1] / "examples" / "force_transfer.py"
DEPTHS = """outputs: [force, rgb]
vary: {method: grid, over: {"trajectory[0].press.depth_mm": {linspace: [0.1, 0.8, 4]}}}
"""


@pytest.fixture(scope="module")
def transfer() -> ModuleType:
    return loaded(SCRIPT)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
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


def test_a_photograph_is_seen_as_the_frame_it_was_taken_of(transfer: ModuleType, folder: Path) -> None:
    frames, photos = transfer.rendered(folder / "data"), transfer.photographed(folder / "photos")
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
    transfer: ModuleType, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(transfer, "BATCH", 8)
    monkeypatch.setattr(transfer, "STEPS", 100)
    monkeypatch.setattr(transfer, "FEW_STEPS", 100)
    photos, two = folder / "photos", tmp_path / "two"
    shutil.copytree(photos, two)
    header, first, *_, last = (photos / "presses.csv").read_text().splitlines()
    (two / "presses.csv").write_text(f"{header}\n{first}\n{last}\n")
    command = ["x", folder / "data", "--few", photos, "--judge", two, "-o", tmp_path, "--seeds", "1"]
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
