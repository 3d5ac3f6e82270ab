"""The dataset class: plain arrays by index, the same through PyTorch's workers, and no scene in two splits."""

import pickle
import warnings
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.needs import needs
from helpers.synthetic import attributes, write

from tacgen import torch as reading
from tacgen.base.errors import UserError
from tacgen.bundle import bundle, pack
from tacgen.bundle import dataset as source
from tacgen.torch import TactileDataset, TactilePairs

COUNT, FRAMES = 6, 12
SPLITS = ("train", "val", "test")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("torch") / "loose"
    for i in range(COUNT):
        write(out / f"scene-{i:05d}.h5", scene_index=i, seed=i, input_key=f"{i:064d}")
    write(out / "scene-00009.h5", stop=3)
    pack.pack(source.scenes(out), out.parent / "packed", 0.2)
    return out


@pytest.mark.parametrize("kind", ["loose", "packed"])
def test_items_are_what_the_bundles_hold(folder: Path, kind: str) -> None:
    fields = ("rgb", "force", "pressure", "contact", "marker_flow", "quality/force_balance", "nodal_stress")
    dataset = TactileDataset(folder.parent / kind, fields)
    assert len(dataset) == COUNT * FRAMES
    for index in (0, 11, 12, 40, -1):
        item = dataset[index]
        scene, frame = divmod(index % len(dataset), FRAMES)
        assert (item["scene"], item["frame"]) == (scene, frame)
        original = bundle.read(folder / f"scene-{scene:05d}.h5")
        for name in fields:
            inside = f"/fields/{name}" if name == "nodal_stress" else f"/frames/{name}"
            wanted = original.frame(inside, frame)
            assert item[name].dtype == wanted.dtype
            assert np.array_equal(item[name], wanted), name
    with pytest.raises(IndexError):
        dataset[len(dataset)]
    assert [item["frame"] for item in TactileDataset(folder / "scene-00000.h5", ("force",))] == list(range(FRAMES))


def test_the_reference_is_subtracted_without_loss(folder: Path) -> None:
    plain = TactileDataset(folder, ("rgb", "markers", "force"))[7]
    change = TactileDataset(folder, ("rgb", "markers", "force"), subtract_reference=True)[7]
    scene = bundle.read(folder / "scene-00000.h5")
    assert change["rgb"].dtype == np.int16
    assert np.array_equal(change["rgb"] + scene["/reference/rgb"], plain["rgb"])
    assert change["markers"] == pytest.approx(scene.frame("/frames/marker_flow", 7), abs=1e-4)
    assert np.array_equal(change["force"], plain["force"])
    assert (change["rgb"] < 0).any()  # it would have wrapped around


def test_splits_share_no_scene_and_do_not_depend_on_where_scenes_lie(folder: Path) -> None:
    def keys(kind: str, split: str, **how: Any) -> tuple[str, ...]:
        dataset = TactileDataset(folder.parent / kind, split=split, **how)
        return tuple(scene.attrs["input_key"] for scene in dataset.scenes)

    thirds = {"fractions": (0.5, 0.2, 0.3)}
    parts, packed = ([keys(kind, split, **thirds) for split in SPLITS] for kind in ("loose", "packed"))
    assert parts == packed
    assert sorted(chain(*parts)) == [f"{i:064d}" for i in range(COUNT)]
    assert [len(part) for part in parts] == [3, 1, 2]
    assert len({keys("loose", "train", seed=k) for k in range(9)}) > 1


def test_an_object_is_in_one_part_alone_whatever_the_folder(tmp_path: Path) -> None:
    balls = [{"shape": "sphere", "radius_mm": r} for r in (3.0, 4.0)]
    meshes = [{"shape": "mesh", "file": "same_name.stl", "sha256": c * 64} for c in "abc"]
    for i, indenter in enumerate(3 * (balls + meshes)):
        recipe = attributes()["recipe"] | {"indenter": indenter}
        for folder in ("one", "two"):
            key = f"{i if folder == 'one' else 99 - i:064d}"
            known = {"scene_index": i, "input_key": key, "recipe": recipe, "outputs": frozenset({"force"})}
            write(tmp_path / folder / f"scene-{i:05d}.h5", **known)
    how = {"fractions": (0.5, 0.25, 0.25), "by_object": True}
    parts = []
    for folder in ("one", "two"):
        parts.append({})
        for split in SPLITS:
            found = TactileDataset(tmp_path / folder, ("force",), split=split, **how)
            objects = [scene.recipe["indenter"] for scene in found.scenes]
            parts[-1][split] = {each.get("sha256", each["shape"]) for each in objects}
            assert len(objects) == 3 * sum(1 + (name == "sphere") for name in parts[-1][split])
    assert [len(part) for part in parts[0].values()] == [2, 1, 1]
    assert parts[0] == parts[1]  # of the object, not of how it is pressed
    with pytest.raises(UserError, match="split 'val': holds none of 15 scenes, which are of 4 objects"):
        TactileDataset(tmp_path / "one", ("force",), split="val", by_object=True, fractions=(0.9, 0.0, 0.1))


def test_values_are_float32_and_channels_first_where_asked(folder: Path) -> None:
    fields = ("rgb", "height", "traction", "contact", "force", "pose", "stress")
    stored = TactileDataset(folder, fields)[7]
    item = TactileDataset(folder, fields, float32=True, channels_first=True)[7]
    assert {item[name].dtype for name in fields} == {np.dtype(np.float32)}
    assert np.array_equal(item["rgb"], stored["rgb"].transpose(2, 0, 1) / np.float32(255))
    assert np.array_equal(item["traction"], stored["traction"].transpose(2, 0, 1))
    assert item["rgb"].flags.c_contiguous
    for name in ("height", "contact", "force", "pose", "stress"):
        assert item[name].shape == stored[name].shape
        assert np.array_equal(item[name], stored[name].astype(np.float32))
    change = TactileDataset(folder, ("rgb",), subtract_reference=True, float32=True)[7]["rgb"]
    assert change.min() < 0
    turned = TactileDataset(folder, ("rgb",), channels_first=True)[7]["rgb"]
    assert np.array_equal(turned, stored["rgb"].transpose(2, 0, 1))


def test_it_pickles_without_its_open_files_and_forgets_those_of_a_parent(folder: Path) -> None:
    dataset = TactileDataset(folder)
    first = dataset[3]
    again = pickle.loads(pickle.dumps(dataset))
    assert again._files == {}
    assert np.array_equal(again[3]["rgb"], first["rgb"])
    dataset._process = -1  # as after a fork
    dataset._files["stale"] = None  # type: ignore[index,assignment]
    assert np.array_equal(dataset[3]["rgb"], first["rgb"])
    assert "stale" not in dataset._files


def test_scenes_and_datasets_are_one_line_each(folder: Path) -> None:
    dataset = TactileDataset(folder)
    assert repr(dataset) == f"TactileDataset({len(dataset)} frames of {COUNT} scenes: rgb, force)"
    shown = repr(dataset.scenes[0])
    assert shown == "Bundle(scene-00000.h5: 12 frames, sphere, radius 4 mm, on gelsight_mini)"
    assert len(str(dataset.scenes)) < 120 * COUNT


def test_few_files_are_open_at_a_time(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "MAX_OPEN_FILES", 2)
    dataset = TactileDataset(folder)
    for index in range(0, len(dataset), FRAMES // 2):
        dataset[index]
        assert len(dataset._files) <= 2


@pytest.mark.parametrize("spoil", ["cut", "flip"])
def test_a_damaged_frame_is_one_line(folder: Path, tmp_path: Path, spoil: str) -> None:
    path = tmp_path / "scene-00000.h5"
    data = bytearray((folder / "scene-00000.h5").read_bytes())
    path.write_bytes(data)
    dataset = TactileDataset(path, ("rgb",))
    for i in range(len(data) // 4, len(data) - 2000, 997):
        data[i] ^= 255
    path.write_bytes(data if spoil == "flip" else data[: len(data) // 3])
    with pytest.raises(UserError, match="damaged") as caught:
        [dataset[i] for i in range(FRAMES)]
    assert len(caught.value.lines) == 1


def test_mistakes_are_one_line(folder: Path, tmp_path: Path) -> None:
    write(tmp_path / "scene-00000.h5", outputs=frozenset({"force"}))
    for options, says in (
        ({"path": folder, "fields": ["rbg"]}, "'rbg': no such field, did you mean rgb; there are: force, "),
        ({"path": folder, "fields": ["forces"]}, "'forces': no such field, did you mean force; there are: force, "),
        ({"path": tmp_path}, "scene-00000.h5: 'rgb': not among the outputs of this scene; there are: force, "),
        ({"path": tmp_path / "no"}, "no such file or folder"),
        ({"path": folder, "split": "tset"}, "split 'tset': must be all, train, val, test"),
        ({"path": folder, "split": "val", "fractions": (1.0, 0.0, 0.0)}, "split 'val': holds none of 6 scenes"),
        ({"path": folder, "split": "val", "fractions": (0.5, 0.1, 0.1)}, "add up to 1"),
    ):
        with pytest.raises(UserError) as caught:
            TactileDataset(**options)  # type: ignore[arg-type]
        assert says in caught.value.lines[0]
        assert len(caught.value.lines) == 1


def test_pytorch_loads_it_in_two_workers(folder: Path) -> None:
    torch = needs("torch")
    dataset = TactileDataset(folder.parent / "packed", transform=lambda item: {**item, "force": -item["force"]})
    dataset[0]  # a file is open when the workers fork
    loader = torch.utils.data.DataLoader(dataset, batch_size=10, shuffle=True, num_workers=2)
    seen = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # PyTorch forks although it has threads
        for batch in loader:
            assert batch["rgb"].dtype == torch.uint8
            for scene, frame, rgb, force in zip(*(batch[n] for n in ("scene", "frame", "rgb", "force")), strict=True):
                seen.append((int(scene), int(frame)))
                item = dataset[int(scene) * FRAMES + int(frame)]
                assert np.array_equal(rgb, item["rgb"])
                assert np.array_equal(force, item["force"])
    assert sorted(seen) == [(i, k) for i in range(COUNT) for k in range(FRAMES)]


@pytest.fixture(scope="module")
def paired(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight contacts on three sensors; of the last the third was rejected. Beside them a scene of its own."""
    out = tmp_path_factory.mktemp("pairs") / "loose"
    for i in range(24):
        known = {"scene_index": i, "pair": i // 3, "sensor": ("mini", "digit", "ninedtact")[i % 3]}
        write(out / f"scene-{i:05d}.h5", input_key=f"{i:064d}", stop=3 if i == 23 else None, **known,
              edit=lambda k, arrays, i=i: arrays.update({"/frames/force": np.array([i, k, 0.0])}))  # fmt: skip
    write(out / "scene-00099.h5")
    pack.pack(source.scenes(out), out.parent / "packed", 0.2)
    return out


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["loose", "packed"])
def test_pairs_are_frames_of_one_contact(paired: Path, kind: str) -> None:
    pairs = TactilePairs(paired.parent / kind, ("force",))
    assert pairs.sensors == ("mini", "digit", "ninedtact")
    assert len(pairs) == 7 * FRAMES  # the contact that is not on all three is left out
    for index in (0, 11, 12, 40, -1):
        item = pairs[index]
        contact, frame = divmod(index % len(pairs), FRAMES)
        assert {name: part["force"].tolist() for name, part in item.items()} == {
            name: [3 * contact + k, frame, 0] for k, name in enumerate(pairs.sensors)
        }
    two = TactilePairs(paired.parent / kind, ("force",), sensors=("digit", "mini"))
    assert (list(two[0]), len(two)) == (["digit", "mini"], 8 * FRAMES)
    with pytest.raises(IndexError):
        pairs[len(pairs)]


@pytest.mark.slow
def test_a_contact_is_in_one_part_on_all_its_sensors(paired: Path, folder: Path) -> None:
    parts = {}
    for part in SPLITS:
        how = {"split": part, "fractions": (0.5, 0.2, 0.3), "seed": 1}
        scenes = TactileDataset(paired, ("force",), **how).scenes
        parts[part] = {scene.attrs.get("pair") for scene in scenes}
        pairs = TactilePairs(paired, ("force",), sensors=("mini", "digit"), **how)
        assert {int(pairs[i]["mini"]["force"][0]) // 3 for i in range(len(pairs))} == parts[part] - {None}
    assert sum(map(len, parts.values())) == 9 == len(set.union(*parts.values()))
    with pytest.raises(UserError, match="holds no contact on several sensors"):
        TactilePairs(folder, ("force",))
    with pytest.raises(UserError, match="holds no contact on digit and tip"):
        TactilePairs(paired, ("force",), sensors=("digit", "tip"))


@pytest.mark.slow
def test_both_fingers_of_a_grasp_are_in_the_same_part(tmp_path: Path) -> None:
    for i in range(16):
        finger = {"scene_index": i // 2, "finger": ("left", "right")[i % 2], "sensor": "digit"}
        write(tmp_path / f"scene-{i // 2:05d}-{'LR'[i % 2]}.h5", input_key=f"{i:064d}", **finger)
    parts = []
    for part in SPLITS:
        pairs = TactilePairs(tmp_path, ("force",), split=part, fractions=(0.5, 0.25, 0.25))
        assert pairs.sensors == ("left", "right")
        parts.append(len(pairs))
    assert parts == [4 * FRAMES, 2 * FRAMES, 2 * FRAMES]


def test_frames_after_a_fold_are_counted_where_they_are_left_out(tmp_path: Path) -> None:
    """A mean over none would be nan."""
    for name, last in (("some", FRAMES - 1), ("none", 0)):
        edit = lambda i, arrays, last=last: arrays.update({"/frames/quality/unique": i < last})  # noqa: E731
        write(tmp_path / name / "scene.h5", edit=edit)
    assert "left out" not in repr(TactileDataset(tmp_path / "some", ("force",)))
    kept = TactileDataset(tmp_path / "some", ("force",), unique=True)
    assert f"{FRAMES - 1} frames of 1 scenes: force; 1 after a fold left out" in repr(kept)
    assert len(TactileDataset(tmp_path / "none", ("force",))) == FRAMES
    with pytest.raises(UserError, match="no frame of split 'all' is unique"):
        TactileDataset(tmp_path / "none", ("force",), unique=True)


def test_pairs_are_of_frames_that_are_unique_on_both_sides(tmp_path: Path) -> None:
    for side, folded in (("left", 3), ("right", 5)):
        edit = lambda i, arrays, k=folded: arrays.update({"/frames/quality/unique": i != k})  # noqa: E731
        write(tmp_path / f"scene-00000-{side}.h5", edit=edit, input_key=side * 12, scene_index=0, finger=side)
    pairs = TactilePairs(tmp_path, ("force",), unique=True)
    frames = [(pair["left"]["frame"], pair["right"]["frame"]) for pair in (pairs[i] for i in range(len(pairs)))]
    assert frames == [(i, i) for i in range(FRAMES) if i not in (3, 5)]
