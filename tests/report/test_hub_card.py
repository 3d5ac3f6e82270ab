"""The page of an export on a data hub: a header of true figures that the hub's own library reads."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command import refused, told
from helpers.export_scenes import needs_package_of
from helpers.needs import needs
from helpers.synthetic import write
from ruamel.yaml import YAML

from tacgen.bundle.bundle import read
from tacgen.bundle.splits import SPLITS
from tacgen.export import export
from tacgen.report import dataset_card, hub_card
from tacgen.torch import TactileDataset


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten scenes with the card of a data set."""
    out = tmp_path_factory.mktemp("hub") / "data"
    for i in range(10):
        write(out / f"scene-{i:05d}.h5", outputs=frozenset({"force", "rgb"}), input_key=f"{i}", scene_index=i)
    dataset_card.write(out)
    return out


def page(kind: str, source: Path, out: Path, *options: str) -> tuple[dict[str, Any], str]:
    """The header and the text of the page that the command writes."""
    assert str(out / "README.md") in told("export", kind, source, "-o", out, "--card", *options).split()
    _, head, text = (out / "README.md").read_text().split("---\n", 2)
    return YAML(typ="safe").load(head), text


def sizes(data: Path) -> dict[str, int]:
    """Frames of each split."""
    return {split: len(TactileDataset(data, ("force",), split=split)) for split in SPLITS}


@pytest.mark.parametrize("kind", ["lerobot", "webdataset", "zarr"])
def test_the_header_tells_licence_size_splits_features_and_origin(data: Path, tmp_path: Path, kind: str) -> None:
    needs_package_of(kind)
    head, text = page(kind, data, tmp_path / "out", "--licence", "cc-by-4.0")
    assert (head["license"], head["task_categories"], head["size_categories"]) == ("cc-by-4.0", ["robotics"], ["n<1K"])
    assert {split["name"]: split["num_examples"] for split in head["dataset_info"]["splits"]} == sizes(data)
    files = [path for path in (tmp_path / "out").rglob("*") if path.is_file()]
    size = sum(path.stat().st_size for path in files if path.name not in ("README.md", ".tacgen-export.json"))
    assert head["dataset_info"]["download_size"] == size
    about = head["tacgen"]
    assert about["command"] == f"tacgen export {kind} data -o out --card --licence cc-by-4.0"
    assert about["digest"] == dataset_card.digest([read(path) for path in sorted(data.glob("*.h5"))])
    assert {"name": "force", "shape": "3", "dtype": "f8", "unit": "N"} in about["features"]
    assert sum(about["scenes"].values()) == 10
    assert "published under cc-by-4.0" in text
    assert '"radius_mm": 4.0' in text
    assert about["command"] in text
    for place in head["configs"][0]["data_files"] if kind != "zarr" else ():
        paths = place["path"] if isinstance(place["path"], list) else [place["path"]]
        assert all(list((tmp_path / "out").glob(path)) for path in paths), place
    assert head.get("viewer", True) is (kind != "zarr")


def test_without_a_licence_the_page_says_that_it_is_not_known(data: Path, tmp_path: Path) -> None:
    needs("webdataset")
    head, text = page("webdataset", data, tmp_path / "out")
    assert head["license"] == "unknown"
    assert "Whoever publishes this data chooses its licence" in text


def test_both_fingers_count_as_one_example_where_they_are_one_sample(tmp_path: Path) -> None:
    needs("webdataset")
    for finger in ("left", "right"):
        known = {"finger": finger, "sensor": "digit", "input_key": finger}
        write(tmp_path / "in" / f"scene-00000-{finger[0].upper()}.h5", outputs=frozenset({"force", "rgb"}), **known)
    head, _ = page("webdataset", tmp_path / "in", tmp_path / "out")
    assert [split["num_examples"] for split in head["dataset_info"]["splits"]] == [12]


def test_several_data_sets_have_one_page(data: Path, tmp_path: Path) -> None:
    needs("webdataset")
    for name in ("a", "b"):
        write(tmp_path / "in" / name / "scene-00000.h5", outputs=frozenset({"force", "rgb"}), input_key=name)
    head, text = page("webdataset", tmp_path / "in", tmp_path / "out", "--merge")
    assert head["dataset_info"]["splits"][0]["num_examples"] == 24
    assert "--merge" in head["tacgen"]["command"]
    assert "| Scenes | 2 (2 ok) |" in text


def test_the_card_of_a_data_set_goes_with_the_export_and_a_strangers_not(data: Path, tmp_path: Path) -> None:
    needs("webdataset")
    export("webdataset", data, tmp_path / "out")
    assert (tmp_path / "out" / "README.md").read_bytes() == (data / "README.md").read_bytes()
    write(tmp_path / "other" / "scene-00000.h5", outputs=frozenset({"force", "rgb"}))
    (tmp_path / "other" / "README.md").write_text("mine\n")
    export("webdataset", tmp_path / "other", tmp_path / "bare")
    assert not (tmp_path / "bare" / "README.md").exists()


def test_a_file_has_no_card(tmp_path: Path) -> None:
    scene = write(tmp_path / "one" / "scene-00000.h5")
    said = refused("export", "vtkhdf", scene.parent, "-o", tmp_path / "x.vtkhdf", "--card")
    assert said.strip().endswith("a card needs a folder to be in: name one")


@pytest.mark.parametrize("kind", ["lerobot", "webdataset"])
def test_the_hubs_library_loads_all_splits(data: Path, tmp_path: Path, kind: str) -> None:
    datasets = needs("datasets")
    card = hub_card.writer(kind, data, tmp_path / "out", licence="cc-by-4.0")
    export(kind, data, tmp_path / "out", card=card)
    loaded = datasets.load_dataset(str(tmp_path / "out"), cache_dir=str(tmp_path / "cache"))
    assert {name: len(rows) for name, rows in loaded.items()} == sizes(data)
    image = loaded["val"][0]["observation.images.tactile" if kind == "lerobot" else "rgb.png"]
    (scene,) = TactileDataset(data, ("force",), split="val").scenes
    assert np.array_equal(np.asarray(image), scene.frame("/frames/rgb", 0))
