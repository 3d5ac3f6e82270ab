"""Files of other tools, read back by their own loader where it is installed, and by its rules where it is not."""

import io
import json
import tarfile
import warnings
from itertools import chain
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from helpers.export_scenes import FRAMES, SENSOR, SHAPE, needs_package_of, real
from helpers.needs import needs
from helpers.synthetic import OUTPUTS, attributes, frame, image, states, write
from PIL import Image
from scipy.spatial.transform import Rotation

from tacgen import export
from tacgen.base.errors import LeftOut, UserError
from tacgen.bundle import dataset, pack
from tacgen.bundle.bundle import Bundle, Writer, read
from tacgen.bundle.caption import caption, task
from tacgen.export import feats, lerobot
from tacgen.torch import TactileDataset


@pytest.mark.slow
def test_feats_gets_forces_by_cell_that_sum_to_the_force(folder: Path, scene: Bundle, tmp_path: Path):
    made = export.export("feats", folder, tmp_path)
    assert len(made) == 2 * FRAMES + 1
    root = f"{tmp_path}/train/"  # what FEATSDataset(root_dir, norm_file) does with the paths
    norm = np.load(str(Path(root).parent.parent / tmp_path.name / "normalization.npy"), allow_pickle=True).item()
    for k in range(FRAMES):
        data = np.load(f"{root}scene-00001_{k:05d}.npy", allow_pickle=True).item()
        assert list(data) == ["gs_img", "grid_x", "grid_y", "grid_z", "f_x", "f_y", "f_z"]
        assert np.array_equal(data["gs_img"], scene.frame("/frames/rgb", k))
        assert np.stack([data[f"grid_{a}"] for a in "xyz"], 2).shape == (24, 32, 3)
        force = scene.frame("/frames/force", k)
        assert [data["f_x"], data["f_y"], data["f_z"]] == pytest.approx(force * [-1, -1, 1], rel=1e-5, abs=1e-9)
        assert data["grid_z"].max() <= 0  # negative in compression
        for key in norm:
            assert norm[key]["min"] <= np.min(data[key]) <= np.max(data[key]) <= norm[key]["max"]
    pressed = np.argwhere(data["grid_z"] < 0.5 * data["grid_z"].min()).mean(0) + 0.5
    pressure = scene.frame("/frames/pressure", FRAMES - 1)
    middle = np.argwhere(pressure > 0.5 * pressure.max()).mean(0) + 0.5
    assert pressed / (24, 32) == pytest.approx(middle / pressure.shape, abs=0.02)


def test_shares_lose_nothing_whatever_the_sizes():
    for n, cells in ((240, 24), (60, 24), (7, 24), (24, 24), (100, 32)):
        found = feats.shares(n, cells)
        assert found.shape == (cells, n)
        assert found.sum(0) == pytest.approx(1.0)
        assert found.sum(1) == pytest.approx(n / cells)


def opened(value: bytes) -> np.ndarray:
    """As cv2.imdecode gives it: blue first."""
    return np.asarray(Image.open(io.BytesIO(value)))[..., ::-1]


def test_univtac_reads_images_markers_depths_and_poses(folder: Path, scene: Bundle, tmp_path: Path):
    made = export.export("univtac", folder, tmp_path)
    assert [path.relative_to(tmp_path).as_posix() for path in made] == ["hdf5/0.hdf5", "hdf5/1.hdf5", "metadata.json"]
    with h5py.File(made[1]) as file:
        tactile = file["tactile/left_tactile"]
        images = np.array([opened(value) for value in tactile["rgb"][()]])
        assert images.shape == (FRAMES, *SHAPE, 3)
        error = images.astype(int) - scene["/frames/rgb"]
        assert abs(error).mean() < 3  # JPEG, of noise; blue for red would be tens
        assert abs(error.mean((0, 1, 2))).max() < 1
        markers = tactile["marker"][()]
        assert markers.shape == (FRAMES, 2, 63, 2)
        assert np.allclose(markers[:, 1] - markers[:, 0], scene["/frames/marker_flow"], atol=1e-4)
        assert np.array_equal(tactile["press_depth"][()], np.maximum(-scene["/frames/height"], 0))
        assert (tactile["depth"][()] > 5).all()  # mm from the pinhole, which is below the gel
        assert np.ptp(tactile["depth"][()]) == pytest.approx(np.ptp(scene["/frames/height"]), rel=1e-5)
        assert np.array_equal(tactile["force"][()], scene["/frames/force"])
        assert np.array_equal(tactile["torque"][()], scene["/frames/torque"])
        pose = file["actor/indenter"][()]
        assert pose[:, :3] == pytest.approx(scene["/frames/pose"][:, :3, 3] / 1000)
        half = np.arccos(np.clip(scene["/frames/pose"][:, 0, 0], -1, 1)) / 2
        assert pose[:, 3:] == pytest.approx(np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], 1))
        assert file["step"][()].tolist() == list(range(FRAMES))
        assert file["atom/tag"][()].astype(str).tolist() == list(scene.segments)
        assert set(file) == {"actor", "atom", "step", "tactile"}
    assert json.loads(made[-1].read_text())["1"]["scene"] == "scene-00001"


@pytest.mark.slow
def test_webdataset_streams_what_the_bundles_hold(folder: Path, scene: Bundle, tmp_path: Path):
    webdataset = needs("webdataset")
    made = export.export("webdataset", folder, tmp_path / "one")
    assert made[0].name == "train-000000.tar"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a single shard, and its own deprecations
        data = webdataset.WebDataset(str(made[0]), shardshuffle=False).decode("rgb8")
        found = {sample["__key__"]: sample for sample in data}
    assert list(found) == [f"scene-{i:05d}-{k:05d}" for i in range(2) for k in range(FRAMES)]
    sample = found["scene-00001-00007"]
    assert np.array_equal(sample["rgb.png"], scene.frame("/frames/rgb", 7))
    for name in ("force", "pressure", "marker_flow", "pose", "contact"):
        assert np.array_equal(sample[f"{name}.npy"], scene.frame(f"/frames/{name}", 7))
    assert (sample["grasp_width_mm.npy"], sample["uncertainty_force.npy"][2]) == (2.5, pytest.approx(7 / 9))
    assert not [name for name in sample if name.startswith(("quality", "events"))]
    assert sample["json"]["values"] == {"start.x_mm": 0.5}
    assert (sample["json"]["frame"], sample["json"]["segment"]) == (7, scene.segments[7])
    assert (sample["json"]["task"], sample["json"]["split"]) == (task(scene), "train")
    events = {name: scene.frame(f"/frames/events/{name}", 7).tolist() for name in sample["json"]["events"]}
    assert sample["json"]["events"] == events | {"mode": "sticking"}
    reference = np.asarray(Image.open(tmp_path / "one" / "reference" / "scene-00001.png"))
    assert np.array_equal(reference, scene["/reference/rgb"])
    again = export.export("webdataset", folder, tmp_path / "two")
    assert [path.name for path in again if path.suffix == ".tar"] == ["train-000000.tar"]
    assert made[0].read_bytes() == again[0].read_bytes()
    with tarfile.open(made[0]) as tar:
        assert {member.mtime for member in tar} == {0}


@pytest.fixture(scope="module")
def tables(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both scenes as a LeRobot data set."""
    needs("pyarrow")
    export.export("lerobot", folder, out := tmp_path_factory.mktemp("lerobot") / "tables")
    return out


@pytest.mark.slow
def test_lerobot_tables_agree_with_each_other_and_with_the_bundles(folder: Path, scene: Bundle, tables: Path):
    parquet = needs("pyarrow.parquet")
    info = json.loads((tables / "meta" / "info.json").read_text())
    assert (info["codebase_version"], info["total_episodes"], info["total_frames"]) == ("v3.0", 2, 2 * FRAMES)
    episodes = parquet.read_table(tables / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [(e["dataset_from_index"], e["dataset_to_index"]) for e in episodes] == [(0, FRAMES), (FRAMES, 2 * FRAMES)]
    last = episodes[1]
    path = info["data_path"].format(chunk_index=last["data/chunk_index"], file_index=last["data/file_index"])
    table = parquet.read_table(tables / path)
    assert set(table.column_names) == set(info["features"])
    rows = table.to_pylist()[last["dataset_from_index"] : last["dataset_to_index"]]
    assert [row["index"] for row in rows] == list(range(FRAMES, 2 * FRAMES))
    assert [row["timestamp"] for row in rows] == pytest.approx(np.arange(FRAMES) / info["fps"])
    for row in rows:
        k = row["frame_index"]
        image = np.asarray(Image.open(io.BytesIO(row["observation.images.tactile"]["bytes"])))
        assert np.array_equal(image, scene.frame("/frames/rgb", k))
        assert row["observation.force"] == pytest.approx(scene.frame("/frames/force", k), rel=1e-6)
        assert len(row["observation.markers"]) == 126
        state = dict(zip(info["features"]["observation.state"]["names"], row["observation.state"], strict=True))
        matrix = scene.frame("/frames/pose", k)
        assert [state["x_mm"], state["y_mm"], state["z_mm"]] == pytest.approx(matrix[:3, 3], rel=1e-6, abs=1e-6)
        turn = Rotation.from_quat([state[f"q{part}"] for part in "wxyz"], scalar_first=True)
        assert turn.as_matrix() == pytest.approx(matrix[:3, :3], abs=1e-6)
        for name in ("torque", "markers", "marker_flow"):
            stored = scene.frame(f"/frames/{name}", k).ravel()
            assert row[f"observation.{name}"] == pytest.approx(stored, rel=1e-6), name
        contact = dict(zip(info["features"]["observation.contact"]["names"], row["observation.contact"], strict=True))
        for name in ("stick_ratio", "friction_used", "patches"):
            assert contact[name] == pytest.approx(scene.frame(f"/frames/events/{name}", k), rel=1e-6), name
        assert contact["area_mm2"] == pytest.approx(scene.frame("/frames/events/contact_area", k))
        center = scene.frame("/frames/events/center_of_pressure", k)
        assert [contact[f"center_{axis}_mm"] for axis in "xyz"] == pytest.approx(center)
        assert row["observation.contact_mode"] == scene.frame("/frames/events/mode", k)
        assert row["action"] == rows[min(k + 1, FRAMES - 1)]["observation.state"]
    for name, feature in info["features"].items():
        if name in ("observation.force", "action", "observation.state"):
            assert table.schema.field(name).type.list_size == feature["shape"][0]
    stats = json.loads((tables / "meta" / "stats.json").read_text())
    force = np.concatenate([bundle["/frames/force"] for bundle in export.bundles(folder)])
    assert stats["observation.force"]["mean"] == pytest.approx(force.mean(0), rel=1e-5)
    assert np.shape(stats["observation.images.tactile"]["std"]) == (3, 1, 1)
    assert last["stats/observation.force/count"] == [FRAMES]
    tasks = parquet.read_table(tables / "meta" / "tasks.parquet")
    assert tasks.to_pylist() == [{"task_index": 0, "task": task(scene)}]
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]


def test_the_task_tells_the_movements_and_none_of_the_labels(scene: Bundle) -> None:
    said = "A sphere, radius 4 mm, on gelsight_mini: pressed 1 mm deep, slid 1 mm along x, held, turned by 10 degrees."
    assert caption(scene).startswith(f"{said} Touching from frame 0, sticking from frame 4. The largest force is")
    assert task(scene) == "Press the object into the sensor, then slide, hold and twist it."


@pytest.mark.slow
def test_lerobot_names_touch_as_planned_there_and_cells_sum_to_the_force(scene: Bundle, tables: Path) -> None:
    parquet = needs("pyarrow.parquet")
    features = json.loads((tables / "meta/info.json").read_text())["features"]
    assert features["observation.tactile.wrench"]["names"][2:5] == ["z_n", "torque_x_n_mm", "torque_y_n_mm"]
    row = parquet.read_table(tables / "data/chunk-000/file-000.parquet").to_pylist()[FRAMES + 9]
    force, torque = scene.frame("/frames/force", 9), scene.frame("/frames/torque", 9)
    assert row["observation.tactile.wrench"] == pytest.approx([*force, *torque], rel=1e-6)
    cells = np.reshape(row["observation.tactile.force"], (12, 16, 3))
    assert cells.sum((0, 1)) == pytest.approx(force, rel=1e-4, abs=1e-6)
    pressure = scene.frame("/frames/pressure", 9)
    pressed = np.argwhere(cells[..., 2] < 0.5 * cells[..., 2].min()).mean(0) + 0.5
    middle = np.argwhere(pressure > 0.5 * pressure.max()).mean(0) + 0.5
    assert pressed / (12, 16) == pytest.approx(middle / pressure.shape, abs=0.05)


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten grasps of two fingers, of which one lacks the right one and another's right one ends early."""
    out = tmp_path_factory.mktemp("many")
    for i in range(10):
        for finger in ("left", "right")[: 1 if i == 3 else 2]:
            known = {"scene_index": i, "finger": finger, "sensor": "digit", "input_key": f"{i}{finger}"}
            path = out / f"scene-{i:05d}-{finger[0].upper()}.h5"
            write(path, shape=(16, 12), outputs=frozenset({"force", "rgb"}), **known)
            if (i, finger) == (5, "right"):
                path.unlink()
                _early(path, **known)
    return out


def _early(path: Path, **known: Any) -> None:
    """A finished scene of half the frames that were planned."""
    rows = states()
    with Writer(path, attributes(**known), frames=len(rows)) as writer:
        writer.put("/reference/rgb", image((16, 12), 0.0, 0.0, 0.0))
        for state in rows[: FRAMES // 2]:
            writer.append(frame(state, (16, 12), frozenset({"force", "rgb"})))
        writer.finish("ok", "ended before a fold")


def splits_of(folder: Path) -> dict[str, list[int]]:
    """Numbers of the grasps in each split of tacgen.torch, without the one that lacks a finger."""
    parts = {split: TactileDataset(folder, ("force",), split=split).scenes for split in ("train", "val", "test")}
    numbers = {split: sorted({scene.attrs["scene_index"] for scene in scenes} - {3}) for split, scenes in parts.items()}
    assert sorted(chain(*numbers.values())) == [0, 1, 2, 4, 5, 6, 7, 8, 9]
    return numbers


@pytest.mark.slow
def test_lerobot_has_the_splits_both_fingers_and_the_frames_that_both_have(many: Path, tmp_path: Path) -> None:
    parquet = needs("pyarrow.parquet")
    with pytest.warns(LeftOut, match="left out scene-00003-L: not on all of left, right"):
        export.export("lerobot", many, tmp_path / "out")
    info = json.loads((tmp_path / "out/meta/info.json").read_text())
    episodes = parquet.read_table(tmp_path / "out/meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for split, numbers in splits_of(many).items():
        first, end = map(int, info["splits"][split].split(":"))
        assert sorted(int(episode["scene"][6:11]) for episode in episodes[first:end]) == numbers
    assert sum(int(at.split(":")[1]) - int(at.split(":")[0]) for at in info["splits"].values()) == 9
    assert {episode["scene"]: episode["length"] for episode in episodes}["scene-00005-L"] == FRAMES // 2
    assert "observation.tactile.right.wrench" in info["features"]
    listed = json.loads((tmp_path / "out/splits.json").read_text())
    assert {name for scenes in listed.values() for name in scenes} == {episode["scene"] for episode in episodes}


@pytest.mark.slow
def test_webdataset_has_the_splits_of_the_data_set_and_both_fingers_in_a_sample(many: Path, tmp_path: Path) -> None:
    needs("webdataset")
    with pytest.warns(LeftOut, match="left out scene-00003-L"):
        exported = export.export("webdataset", many, tmp_path / "out")
    made = {path.name: path for path in exported if path.suffix == ".tar"}
    for split, numbers in splits_of(many).items():
        if not numbers:
            continue
        with tarfile.open(made.pop(f"{split}-000000.tar")) as tar:
            content = {member.name: tar.extractfile(member).read() for member in tar}
        assert sorted({int(name[6:11]) for name in content}) == numbers
        key = f"scene-{numbers[0]:05d}-L-00004"
        about = json.loads(content[f"{key}.json"])
        assert {role: known["sensor"] for role, known in about["sensors"].items()} == {
            "left": "digit",
            "right": "digit",
        }
        for finger in ("left", "right"):
            scene = read(many / f"scene-{numbers[0]:05d}-{finger[0].upper()}.h5")
            found = np.asarray(Image.open(io.BytesIO(content[f"{key}.{finger}.rgb.png"])))
            assert np.array_equal(found, scene.frame("/frames/rgb", 4))
            force = np.load(io.BytesIO(content[f"{key}.{finger}.force.npy"]))
            assert np.array_equal(force, scene.frame("/frames/force", 4))
    assert not made


def test_lerobot_has_an_episode_for_each_contact_on_several_sensors(tmp_path: Path) -> None:
    """In pictures of their own sizes; a contact that one of the sensors lacks is left out."""
    parquet = needs("pyarrow.parquet")
    for i in range(5):
        known = {"scene_index": i, "pair": i // 2, "sensor": ("digit", "mini")[i % 2]}
        write(tmp_path / "in" / f"scene-{i:05d}.h5", shape=((48, 64), (60, 40))[i % 2], **known,
              reference_height=np.zeros(((12, 16), (15, 10))[i % 2]))  # fmt: skip
    with pytest.warns(LeftOut):
        export.export("lerobot", tmp_path / "in", tmp_path / "out")
    info = json.loads((tmp_path / "out/meta/info.json").read_text())
    assert (info["robot_type"], info["total_episodes"], info["total_frames"]) == ("digit, mini", 2, 2 * FRAMES)
    features = info["features"]
    assert features["observation.images.digit"]["shape"] == [48, 64, 3]
    assert features["observation.images.mini"]["shape"] == [60, 40, 3]
    assert features["observation.state"]["names"][7:9] == ["mini.x_mm", "mini.y_mm"]
    rows = parquet.read_table(tmp_path / "out/data").to_pylist()  # in order, a file for each split
    for name, number in (("digit", 2), ("mini", 3)):
        scene, row = read(tmp_path / "in" / f"scene-{number:05d}.h5"), rows[FRAMES + 4]
        image = np.asarray(Image.open(io.BytesIO(row[f"observation.images.{name}"]["bytes"])))
        assert np.array_equal(image, scene.frame("/frames/rgb", 4))
        assert row[f"observation.force.{name}"] == pytest.approx(scene.frame("/frames/force", 4))
        at = features["observation.state"]["names"].index(f"{name}.x_mm")
        assert row["observation.state"][at : at + 3] == pytest.approx(scene.frame("/frames/pose", 4)[:3, 3])
    assert set(rows[0]) == set(features)


def test_lerobot_depth_is_16_bit_in_micrometres(scene: Bundle, tables: Path) -> None:
    parquet = needs("pyarrow.parquet")
    feature = json.loads((tables / "meta/info.json").read_text())["features"]["observation.images.tactile_depth"]
    assert (feature["dtype"], feature["shape"]) == ("image", [60, 80, 1])
    assert feature["info"] == {"is_depth_map": True, "depth_unit": "um"}
    rows = parquet.read_table(tables / "data/chunk-000/file-000.parquet").to_pylist()
    for k in range(FRAMES):
        picture = Image.open(io.BytesIO(rows[FRAMES + k]["observation.images.tactile_depth"]["bytes"]))
        assert picture.mode == "I;16"
        pressed = np.maximum(scene["/reference/height"] - scene.frame("/frames/height", k), 0)
        assert np.asarray(picture) / 1000 == pytest.approx(pressed, abs=5.1e-4)
    stats = json.loads((tables / "meta/stats.json").read_text())["observation.images.tactile_depth"]
    assert np.shape(stats["mean"]) == (1, 1, 1)


@pytest.mark.slow
def test_lerobot_begins_a_file_when_one_is_full(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    parquet = needs("pyarrow.parquet")
    monkeypatch.setattr(lerobot, "PARQUET_FILE_BYTES", 1000)
    monkeypatch.setattr(lerobot, "FILES_PER_FOLDER", 1)
    export.export("lerobot", folder, tmp_path)
    rows = parquet.read_table(tmp_path / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [(row["data/chunk_index"], row["data/file_index"]) for row in rows] == [(0, 0), (1, 0)]
    there = [tmp_path / f"data/chunk-{chunk:03d}/file-000.parquet" for chunk in range(2)]
    assert [parquet.read_table(path)["episode_index"].unique().to_pylist() for path in there] == [[0], [1]]


@pytest.mark.parametrize(
    ("times", "says"),
    [
        ([np.arange(FRAMES) ** 2 / 10] * 2, "evenly spaced frames"),
        ([np.arange(FRAMES) / 10, np.arange(FRAMES) / 5], "one frame rate"),
    ],
)
def test_lerobot_takes_one_even_rate_and_writes_nothing_else(times: list[np.ndarray], says: str, tmp_path: Path):
    needs("pyarrow")
    for k, time in enumerate(times):
        write(tmp_path / "in" / f"scene-{k:05d}.h5", outputs=frozenset({"rgb"}),
              edit=lambda i, arrays, t=time: arrays.update({"/frames/time": t[i]}))  # fmt: skip
    with pytest.raises(UserError, match=says):
        export.export("lerobot", tmp_path / "in", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_lerobot_itself_loads_it(folder: Path, scene: Bundle, tmp_path: Path):
    module = needs("lerobot.datasets.lerobot_dataset")
    export.export("lerobot", folder, tmp_path)
    data = module.LeRobotDataset("tacgen/synthetic", root=tmp_path)
    item = data[FRAMES + 7]
    assert (data.num_episodes, data.num_frames, item["task"]) == (2, 2 * FRAMES, data.meta.tasks.index[0])
    assert np.allclose(item["observation.images.tactile"].permute(1, 2, 0) * 255, scene.frame("/frames/rgb", 7))
    assert np.allclose(item["observation.force"], scene.frame("/frames/force", 7))
    depth = (scene["/reference/height"] - scene.frame("/frames/height", 7)) * 1000
    assert item["observation.images.tactile_depth"].squeeze().numpy() == pytest.approx(np.maximum(depth, 0), abs=0.51)


def test_lerobot_depth_stays_within_the_15_bits_that_its_reader_gives(tmp_path: Path) -> None:
    parquet = needs("pyarrow.parquet")

    def deep(index: int, arrays: dict[str, Any]) -> None:
        arrays["/frames/height"][3, 4] = -40.0

    write(tmp_path / "in" / "scene-00000.h5", outputs=OUTPUTS, edit=deep)
    export.export("lerobot", tmp_path / "in", tmp_path / "out")
    rows = parquet.read_table(tmp_path / "out/data/chunk-000/file-000.parquet").to_pylist()
    picture = np.asarray(Image.open(io.BytesIO(rows[0]["observation.images.tactile_depth"]["bytes"])))
    assert picture[3, 4] == picture.max() == 2**15 - 1


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders of two scenes: `short` ones, and `long` ones for Sparsh."""
    out = tmp_path_factory.mktemp("few")
    for name, frames in (("short", 2), ("long", 6)):
        for i in range(2):
            known = {"scene_index": i, "sensor_document": SENSOR}
            write(out / name / f"scene-{i:05d}.h5", shape=SHAPE, outputs=OUTPUTS, frames=frames, edit=real, **known)
    return out


@pytest.mark.parametrize(
    "kind",
    ["univtac", "webdataset"]
    + [pytest.param(kind, marks=pytest.mark.slow) for kind in ("lerobot", "zarr", "feats", "sparsh", "feelanyforce")],
)
def test_every_exporter_takes_packs_and_refuses_what_is_damaged_foreign_or_lacking(
    few: Path, tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
):
    needs_package_of(kind)
    few = few / ("long" if kind == "sparsh" else "short")
    packed = pack.pack(dataset.scenes(few), tmp_path / "packed").folder
    loose = [path.read_bytes() for path in export.export(kind, few, tmp_path / "a")]
    assert [path.read_bytes() for path in export.export(kind, packed, tmp_path / "b")] == loose

    bad = tmp_path / "bad" / "scene-00000.h5"
    bad.parent.mkdir()

    def refused(content: bytes) -> str:
        bad.write_bytes(content)
        with pytest.raises(UserError) as caught:
            export.export(kind, bad.parent, tmp_path / "c")
        assert len(caught.value.lines) == 1
        return caught.value.lines[0].removeprefix(str(bad))

    good = bytearray((few / "scene-00000.h5").read_bytes())
    assert refused(bytes(good[: len(good) // 2])).startswith(": damaged or cut short")
    good[len(good) // 2] ^= 16
    assert ": damaged" in refused(bytes(good))
    assert refused(b"PK\x03\x04 a zip file") == ": not an HDF5 file"
    write(bad, outputs=frozenset({"force"}))
    if kind not in ("webdataset", "zarr"):  # which take whatever there is
        assert ": has no /frames/" in refused(bad.read_bytes())
    monkeypatch.setattr("tacgen.bundle.schema.BUNDLE_FORMAT", 99)
    write(bad, outputs=frozenset({"force"}))
    monkeypatch.undo()
    assert "bundle format 99" in refused(bad.read_bytes())
