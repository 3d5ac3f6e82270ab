"""The replay buffer, read by Zarr with the rules of diffusion policies' ReplayBuffer."""

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.export_scenes import FRAMES
from helpers.needs import needs
from helpers.synthetic import write

from tacgen.bundle.bundle import Bundle, read
from tacgen.export import export

zarr = needs("zarr")


def buffer(folder: Path) -> dict[str, dict[str, np.ndarray]]:
    """As its constructor and copy_from_store read it: every array has as many rows as the last episode's end."""
    root = zarr.open(str(folder / "replay_buffer.zarr"), mode="r")
    assert "data" in root
    assert "episode_ends" in root["meta"]
    end = root["meta"]["episode_ends"][-1]
    for _, value in root["data"].arrays():
        assert value.shape[0] == end
        assert len(value.chunks) == len(value.shape)
        assert value.chunks[1:] == value.shape[1:]  # only time is divided
    return {group: {key: value[:] for key, value in root[group].arrays()} for group in ("data", "meta")}


def test_a_replay_buffer_holds_all_frames_one_after_the_other(
    folder: Path, scene: Bundle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tacgen.export.zarr.CHUNK_BYTES", 500_000)
    export("zarr", folder, tmp_path / "out")
    stored = zarr.open(str(tmp_path / "out" / "replay_buffer.zarr"), mode="r")["data"]
    assert stored["img"].chunks == (3, 240, 320, 3), "whole frames"
    assert stored["force"].chunks == (2 * FRAMES, 3)
    found = buffer(tmp_path / "out")
    data, ends = found["data"], found["meta"]["episode_ends"]
    assert (ends.tolist(), ends.dtype) == ([FRAMES, 2 * FRAMES], np.int64)
    second = slice(ends[0], ends[1])
    assert np.array_equal(data["img"][second], scene["/frames/rgb"])
    assert data["img"].dtype == np.uint8
    for name in ("force", "traction", "events/mode", "contact"):
        assert np.array_equal(data[name.replace("/", "_")][second], scene[f"/frames/{name}"])
    assert data["state"][second][:, :3] == pytest.approx(scene["/frames/pose"][:, :3, 3])
    assert np.array_equal(data["action"][second][:-1], data["state"][second][1:])
    assert not [key for key in data if key.startswith("quality")]
    attrs = json.loads((tmp_path / "out/replay_buffer.zarr/data/force/.zattrs").read_text())
    assert attrs["units"] == "N"
    assert json.loads((tmp_path / "out/replay_buffer.zarr/data/force/.zarray").read_text())["zarr_format"] == 2


def test_both_fingers_are_one_episode_and_its_poses_one_state(tmp_path: Path) -> None:
    for i in range(4):
        known = {"scene_index": i // 2, "finger": ("left", "right")[i % 2], "sensor": "digit"}
        path = tmp_path / "in" / f"scene-{i // 2:05d}-{'LR'[i % 2]}.h5"
        write(path, shape=((48, 64), (60, 40))[i % 2], outputs=frozenset({"force", "rgb"}), **known)
    export("zarr", tmp_path / "in", tmp_path / "out")
    found = buffer(tmp_path / "out")
    assert found["meta"]["episode_split"].tolist() == [0, 0]
    assert found["data"]["state"].shape == (2 * FRAMES, 14)
    right = read(tmp_path / "in" / "scene-00001-R.h5")
    assert np.array_equal(found["data"]["img_right"][FRAMES:], right["/frames/rgb"])
    assert found["data"]["img_left"].shape[1:] == (48, 64, 3)
    assert np.array_equal(found["data"]["force_right"][FRAMES:], right["/frames/force"])
