"""scripts/sample.py: what it publishes is whole and divided as the data set; its scores are of the test data."""

import json
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from helpers.program import loaded
from helpers.synthetic import write
from ruamel.yaml import YAML

from tacgen.recipe import assets, loading, plan
from tacgen.report import dataset_card
from tacgen.torch import TactileDataset

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def sample() -> ModuleType:
    return loaded(ROOT / "scripts" / "sample.py")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten contacts on two sensors, the contact's mode being told by the image."""
    out = tmp_path_factory.mktemp("sample") / "data"

    def edit(index: int, arrays: dict[str, Any]) -> None:
        arrays["/frames/events/mode"] = 2 if index < 4 else 4

    for i in range(20):
        known = {"scene_index": i, "pair": i // 2, "sensor": ("gelsight_mini", "digit")[i % 2], "input_key": str(i)}
        write(out / f"scene-{i:05d}.h5", outputs=frozenset({"force", "rgb"}), shape=(24, 32), edit=edit, **known)
    dataset_card.write(out)
    return out


@pytest.mark.slow
def test_what_is_published_is_whole_and_in_the_same_splits(sample: ModuleType, data: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "shard-00009.h5").touch()  # of an earlier time
    sample.publish(data, tmp_path / "out")
    assert not (tmp_path / "out" / "shard-00009.h5").exists()
    listed = json.loads((tmp_path / "out" / "splits.json").read_text())
    for split, names in listed.items():
        for folder in (data, tmp_path / "out"):
            scenes = TactileDataset(folder, ("force",), split=split).scenes
            assert [scene.group[1:] or scene.path.stem for scene in scenes] == names
        pairs = {int(name[6:]) // 2 for name in names}
        assert len(names) == 2 * len(pairs)
    _, head, text = (tmp_path / "out" / "README.md").read_text().split("---\n", 2)
    about = YAML(typ="safe").load(head)
    assert about["license"] == "cc-by-4.0"
    assert about["tacgen"]["digest"] == dataset_card.digest(TactileDataset(data, ("force",)).scenes)
    assert {part["name"]: part["num_examples"] for part in about["dataset_info"]["splits"]} == {
        split: 12 * len(names) for split, names in listed.items()
    }
    assert sample.table(json.loads((tmp_path / "out" / "baseline.json").read_text())) in text


@pytest.mark.slow
def test_the_linear_baseline_beats_a_guess_by_errors_of_the_test_data(sample: ModuleType, data: Path) -> None:
    scores = sample.baseline(data)
    assert set(scores) == {"gelsight_mini", "digit"}
    for sensor, methods in scores.items():
        assert methods["linear"]["force z [N]"] < 0.5 * methods["guess"]["force z [N]"]
        assert methods["linear"]["mode, right"] > methods["guess"]["mode, right"]
        part, known = (sample.frames(data, split)[sensor] for split in ("test", "train"))
        off = part["force"][:, 2] - known["force"][:, 2].mean()
        assert methods["guess"]["force z [N]"] == pytest.approx(np.sqrt(np.mean(off**2)))


def test_sensors_keep_their_view_in_smaller_pictures_and_keys_no_folder(sample: ModuleType, tmp_path: Path) -> None:
    plans = [plan.load(sample.small_recipe(tmp_path / name), ["vary.samples=1"]) for name in ("a", "b")]
    rows = plans[0].rows
    assert [row.sensor.name for row in rows] == ["gelsight_mini", "digit", "ninedtact"]
    assert [row.key for row in rows] == [row.key for row in plans[1].rows]
    for row in rows:
        small, whole = row.sensor.camera, loading.read_sensor(assets.sensor_path(row.sensor.name))[0].camera
        assert small.width_px * small.mm_per_px == pytest.approx(whole.width_px * whole.mm_per_px)
        assert small.height_px * small.mm_per_px == pytest.approx(whole.height_px * whole.mm_per_px)
        assert small.width_px * small.height_px < 10_000
