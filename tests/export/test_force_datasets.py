"""FeelAnyForce's tables and Sparsh's pickles, read by the rules of their TacForceDataset and VisionForceSlipDataset."""

import csv
import io
import json
import pickle
from glob import glob
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.export_scenes import FRAMES, SENSOR, SHAPE, real
from helpers.synthetic import OUTPUTS, write
from PIL import Image

from tacgen.base.errors import UserError
from tacgen.bundle.bundle import Bundle, read
from tacgen.export import export, sparsh
from tacgen.torch import TactileDataset

LOW, HIGH, BIAS = -8.311515796355053, 27.03226967220051, 5  # by which it scales depths


def rows(base: str, split: str) -> list[dict[str, str]]:
    with open(f"{base}TacForce_{split}_set.csv", encoding="utf-8") as file:
        return [{**row, "tactile": base + row["tactile"], "depth": base + row["depth"]} for row in csv.DictReader(file)]


@pytest.mark.slow
def test_its_loader_finds_pictures_depths_and_wrenches(folder: Path, scene: Bundle, tmp_path: Path) -> None:
    base = f"{tmp_path.parent / 'faf'}/"  # a path without the word it replaces
    export("feelanyforce", folder, Path(base))
    read = rows(base, "train")
    assert len(read) == 2 * FRAMES
    assert rows(base, "val") == rows(base, "test") == []
    for k in (0, 5, 11):
        row = read[FRAMES + k]
        assert np.array_equal(Image.open(row["tactile"]), scene.frame("/frames/rgb", k))
        plain = np.asarray(Image.open(row["tactile"].replace("tactile", "tactile_nobg"))).astype(int)
        assert np.array_equal(
            plain, np.clip(scene.frame("/frames/rgb", k) - scene["/reference/rgb"].astype(int) + 127, 0, 255)
        )
        numbers = np.array(row["FT"].split(" "), float)
        assert numbers[:3] == pytest.approx(-scene.frame("/frames/force", k), abs=1e-6)
        assert numbers[3:] == pytest.approx(-scene.frame("/frames/torque", k) / 1000, abs=1e-6)
        depth = np.load(row["depth"])
        assert (depth.shape, depth.dtype) == (SHAPE, np.float32)
        scaled = (depth - (LOW - BIAS)) / (2 * BIAS + HIGH - LOW)
        assert (scaled > 0).all()
        assert (scaled < 1).all()
        mm = depth.reshape(60, 4, 80, 4).mean((1, 3)) * SENSOR["camera"]["mm_per_px"]
        assert mm == pytest.approx(-scene.frame("/frames/height", k), abs=0.02)
        assert numbers[2] > 0
        assert depth.max() > 0
    assert np.array_equal(Image.open(f"{base}tactile/background.png"), scene["/reference/rgb"])


@pytest.mark.parametrize("kind", ["FeelAnyForce", "FEATS"])
def test_other_pictures_are_refused(tmp_path: Path, kind: str) -> None:
    write(tmp_path / "scene.h5", outputs=OUTPUTS, edit=real)
    with pytest.raises(UserError, match=f"{kind} takes images of 240 x 320 pixels, these have 48 x 64"):
        export(kind.lower(), tmp_path, tmp_path / "out")


class Reader:
    """The parts of Sparsh's data set that read files and index labels; its crop is for pictures of other shapes."""

    def __init__(self, folder: Path, name: str, sensor: str) -> None:
        self.frames: list[bytes] = []
        for path in sorted(glob(str(folder / name / f"dataset_{sensor}*"))):
            self.frames += pickle.loads(Path(path).read_bytes())
        labels = pickle.loads((folder / name / "dataset_slip_forces.pkl").read_bytes())
        self.in_contact, self.trajectories = labels["in_contact"], labels["trajectories"]
        self.background = self.image(np.where(self.in_contact == 0)[0][0])
        self.places = [
            (number, sample)
            for number, trajectory in self.trajectories.items()
            for sample in range(len(trajectory["indexes"][5:]))
        ]

    def image(self, index: int) -> np.ndarray:
        assert isinstance(self.frames[index], bytes)
        return np.array(Image.open(io.BytesIO(self.frames[index])))

    def item(self, place: tuple[int, int], stride: int = 5) -> dict[str, Any]:
        number, sample = place
        trajectory = self.trajectories[number]
        before = int(np.clip(sample - stride, 0, len(trajectory["indexes"]) - 1))
        slip = trajectory["slip_label"][np.clip(sample + np.arange(1), 0, len(trajectory["slip_label"]) - 1)]
        now, then = (self.image(trajectory["indexes"][k]).astype(int) - self.background for k in (sample, before))
        assert now.shape[0] / now.shape[1] == 4 / 3  # neither turned nor cropped
        force = trajectory["forces"][sample]
        return {"image": (now, then), "force": force, "delta": force - trajectory["forces"][before],
                "slip": int(slip.astype(int).sum() > 0)}  # fmt: skip


def slipping(index: int, arrays: dict[str, Any]) -> None:
    """A contact that begins in frame 2 and slides from frame 5 on."""
    real(index, arrays)
    arrays["/frames/events/mode"] = 0 if index < 2 else 2 if index < 5 else 4


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("sparsh")
    for i in range(8):
        balls = {"shape": "sphere", "radius_mm": 3.0 + i % 2}
        recipe = {"indenter": balls, "trajectory": [{"press": {"frames": FRAMES}}], "contact": {"friction": 0.4}}
        known = {"sensor": "digit" if i < 2 else "gelsight_mini", "recipe": recipe, "input_key": str(i)}
        write(out / f"scene-{i:05d}.h5", shape=(128, 96) if i < 2 else (96, 128), outputs=OUTPUTS, edit=slipping,
              reference_height=np.zeros((32, 24) if i < 2 else (24, 32)), scene_index=i, **known)  # fmt: skip
    return out


@pytest.mark.slow
def test_its_loader_finds_pictures_background_forces_and_slip(scenes: Path, tmp_path: Path) -> None:
    export("sparsh", scenes, tmp_path)
    lists = json.loads((tmp_path / "gelsight" / "datasets.json").read_text())
    assert lists["list_datasets"] == ["sphere/batch_1"]
    trained = [scene for scene in TactileDataset(scenes, split="train").scenes if scene.attrs["sensor"] != "digit"]
    reader = Reader(tmp_path / "gelsight", "sphere/batch_1", "gelsight")
    assert len(reader.frames) == len(reader.in_contact) == 1 + FRAMES * len(trained)
    upright = np.rot90(trained[0]["/reference/rgb"], -1)
    assert np.array_equal(reader.background, upright)
    assert len(reader.places) == len(trained) * (FRAMES - 5)
    for place in reader.places:
        number, sample = place
        scene, item = trained[number], reader.item(place)
        assert np.array_equal(item["force"], scene.frame("/frames/force", sample))
        assert item["slip"] == (sample >= 5)
        assert np.array_equal(item["image"][0], np.rot90(scene.frame("/frames/rgb", sample), -1).astype(int) - upright)
    assert (item["delta"] == item["force"] - trained[-1].frame("/frames/force", FRAMES - 6 - 5)).all()
    assert reader.in_contact[:4].tolist() == [0, 0, 0, 1]  # untouched, and two frames before the contact
    assert reader.trajectories[0]["coef_friction"] == 0.4


def test_each_split_is_a_batch_in_files_of_some_pictures_and_any_numpy_reads_its_labels(
    scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So is each untouched picture, and no sensor is mixed."""
    monkeypatch.setattr(sparsh, "PICTURES_PER_FILE", 7)
    made = export("sparsh", scenes, tmp_path)
    for sensor in ("digit", "gelsight"):
        lists = json.loads((tmp_path / sensor / "datasets.json").read_text())
        batches = [name for names in lists.values() for name in names]
        assert len(set(batches)) == len(batches) == len(list((tmp_path / sensor).glob("*/*")))
        total = sum(len(Reader(tmp_path / sensor, name, sensor).trajectories) for name in batches)
        assert total == (2 if sensor == "digit" else 6)
    assert not list((tmp_path / "digit").rglob("dataset_gelsight*"))
    labels = next(path for path in made if path.name == "dataset_slip_forces.pkl")
    assert b"numpy.core" not in labels.read_bytes()
    assert b"numpy._core" not in labels.read_bytes()
    files = sorted(set(labels.parent.glob("dataset_*_*.pkl")) - {labels})
    counts = [len(pickle.loads(path.read_bytes())) for path in files]
    assert set(counts[:-1]) == {7}
    assert sum(counts) == len(pickle.loads(labels.read_bytes())["in_contact"])


def test_what_sparsh_cannot_use_is_refused(tmp_path: Path, folder: Path) -> None:
    write(tmp_path / "other.h5", outputs=OUTPUTS, edit=slipping, sensor="ninedtact", shape=(96, 128))
    with pytest.raises(UserError, match="Sparsh knows digit and gelsight, not ninedtact"):
        export("sparsh", tmp_path, tmp_path / "out")
    short: Bundle = read(folder / "scene-00000.h5")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sparsh, "SKIPPED_FRAMES", short.frames)
        with pytest.raises(UserError, match="needs scenes of more than 12 frames"):
            export("sparsh", folder, tmp_path / "out")
