"""Small files of every format that episodes are read from, made by hand; none needs a simulator."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import trimesh
from helpers.needs import needs

from tacgen.base.errors import LeftOut, UserError
from tacgen.touch.sources import open_source

BALL = "cup={shape: sphere, radius_mm: 10}"
ROWS, FPS = 12, 30


def path_of(name: str) -> np.ndarray:
    """Poses (ROWS, 7) [m], w x y z: a hand comes down 60 mm onto a cup that rests, turning by half a right angle."""
    rows, part = np.zeros((ROWS, 7)), np.linspace(0, 1, ROWS)
    rows[:, 3] = 1.0
    if name == "hand":
        rows[:, 2] = 0.1 - 0.06 * part
        rows[:, 3], rows[:, 6] = np.cos(np.pi / 8 * part), np.sin(np.pi / 8 * part)
    return rows


def as_pose(row: np.ndarray) -> np.ndarray:
    """The pose (4, 4) [mm] of one row, by hand: turns are about z."""
    angle = 2 * np.arctan2(row[6], row[3])
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    pose[:3, 3] = 1000 * row[:3]
    return pose


def lerobot(folder: Path, states: list[np.ndarray], lengths: list[int] | None = None, version: str = "v3.0") -> Path:
    """A data set with the features `observation.state` (hand and cup) and `action` (a grip)."""
    pa = needs("pyarrow")
    from pyarrow import parquet

    names = [f"{body}.{part}" for body in ("hand", "cup") for part in ("x", "y", "z", "qw", "qx", "qy", "qz")]
    features = {
        "observation.state": {"dtype": "float32", "shape": [14], "names": {"poses": names}},
        "action": {"dtype": "float32", "shape": [1], "names": ["close"]},
        "timestamp": {"dtype": "float32", "shape": [1], "names": None},
        "episode_index": {"dtype": "int64", "shape": [1], "names": None},
        "observation.images.top": {"dtype": "video", "shape": [4, 4, 3], "names": None},
    }
    place = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
    info = {"codebase_version": version, "fps": FPS, "features": features, "data_path": place}
    for part in ("meta/episodes/chunk-000", "data/chunk-000"):
        (folder / part).mkdir(parents=True)
    (folder / "meta/info.json").write_text(json.dumps(info))
    index = np.repeat(np.arange(len(states)), [len(state) for state in states])
    time = np.concatenate([np.arange(len(state)) / FPS for state in states]).astype(np.float32)
    grip = [[5.0 if k % ROWS > 8 else -1.0] for k in range(len(index))]
    table = {
        "observation.state": pa.array(np.concatenate(states).tolist(), pa.list_(pa.float32(), 14)),
        "action": pa.array(grip, pa.list_(pa.float32())),
        "timestamp": time,
        "episode_index": index,
    }
    parquet.write_table(pa.table(table), folder / "data/chunk-000/file-000.parquet")
    entries = {
        "episode_index": np.arange(len(states)),
        "length": lengths or [len(state) for state in states],
        "data/chunk_index": np.zeros(len(states), int),
        "data/file_index": np.zeros(len(states), int),
    }
    parquet.write_table(pa.table(entries), folder / "meta/episodes/chunk-000/file-000.parquet")
    return folder


STATE = np.hstack([path_of("hand"), path_of("cup")])
BODIES = {"hand": "observation.state[0:7]", "cup": "observation.state[cup.x,cup.y,cup.z,cup.qw,cup.qx,cup.qy,cup.qz]"}
COLUMNS = {"bodies": BODIES, "grip": "2 * action[close]"}


def test_a_lerobot_folder_gives_poses_and_grip_of_each_episode(tmp_path: Path) -> None:
    source = open_source(lerobot(tmp_path / "set", [STATE, STATE[:10]]), objects=[BALL], columns=COLUMNS)
    first, second = map(source.episode, range(2))
    assert (source.kind, source.fps, len(source), len(first), len(second)) == ("lerobot", 30.0, 2, ROWS, 10)
    np.testing.assert_allclose(first.time, np.arange(ROWS) / FPS, rtol=0, atol=1e-12)
    for row in (0, 5, ROWS - 1):
        np.testing.assert_allclose(first.bodies["hand"][row], as_pose(path_of("hand")[row]), atol=1e-4)
    assert first.grip is not None
    assert first.grip.tolist() == [0.0] * 9 + [10.0] * 3
    assert source.things["cup"].surface.pose[2, 3] == -10.0  # a ball's frame is at its lowest point


def damaged(what: str) -> np.ndarray:
    state = STATE.copy()
    if what == "nan":
        state[4, 2] = np.nan
    elif what == "jump":
        state[6:, 0] += 0.4
    elif what == "turn":
        state[6:, 3:7] = [0, 0, 0, 1]
    elif what == "mm":
        state[:, [0, 1, 2, 7, 8, 9]] *= 1000
    elif what == "quaternion":
        state[3, 3] = 0.5
    return state


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("nan", "episode 1: row 4: the pose of hand is missing"),
        ("jump", "episode 1: row 6: hand jumps: it moves at 1.2e+04 mm/s"),
        ("turn", "episode 1: row 6: hand jumps: it turns at"),
        ("mm", "episode 1: its bodies are 100 m apart: are its lengths mm? Say units: mm"),
        ("quaternion", "episode 1: row 3: its quaternion is of length 0.5"),
    ],
)
def test_odd_rows_are_told_with_episode_and_row(tmp_path: Path, what: str, said: str) -> None:
    source = open_source(lerobot(tmp_path / "set", [STATE, damaged(what)]), objects=[BALL], columns=COLUMNS)
    source.episode(0)
    with pytest.raises(UserError) as error:
        source.episode(1)
    assert said in str(error.value)
    assert len(error.value.lines) == 1


def test_a_data_set_that_lacks_rows_or_is_older_is_refused(tmp_path: Path) -> None:
    short = open_source(lerobot(tmp_path / "short", [STATE], lengths=[20]), objects=[BALL], columns=COLUMNS)
    with pytest.raises(UserError, match="episode 0: has 12 rows, and its data set says 20"):
        short.episode(0)
    with pytest.raises(UserError, match=r"is LeRobot v2.1: bring it to v3.0"):
        open_source(lerobot(tmp_path / "old", [STATE], version="v2.1"))


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"bodies": {"cup": "observation.cup"}}, "there is no observation.cup; there are: observation.state, action"),
        ({"bodies": {"cup": "observation.state[8:20]"}}, "it has 14 numbers, counted from 0"),
        ({"bodies": {"cup": "observation.state[0:5]"}}, "a pose is 7 numbers"),
        ({"bodies": {"hand": "observation.state[0:7]"}}, "has no poses of cup (of hand)"),
        ({"bodies": BODIES, "grip": "action[open]"}, "action has no 'open'; there are: close"),
    ],
)
def test_columns_that_are_not_there_are_told(tmp_path: Path, columns: dict[str, object], said: str) -> None:
    with pytest.raises(UserError) as error:
        open_source(lerobot(tmp_path / "set", [STATE]), objects=[BALL], columns=columns).episode(0)
    assert said in str(error.value)


def test_a_gripper_that_never_closes_is_a_note(tmp_path: Path) -> None:
    source = open_source(lerobot(tmp_path / "set", [STATE[:8]]), objects=[BALL], columns=COLUMNS)
    with pytest.warns(LeftOut, match="episode 0: its gripper never closes"):
        source.episode(0)


def test_an_object_needs_a_surface_in_mm(tmp_path: Path) -> None:
    folder = lerobot(tmp_path / "set", [STATE])
    with pytest.raises(UserError, match="object cup: without a model it needs a surface"):
        _ = open_source(folder, objects=["cup"]).things
    with pytest.raises(UserError, match="no objects: name them"):
        _ = open_source(folder).things
    metres = tmp_path / "small.stl"
    trimesh.creation.box([0.02, 0.03, 0.04]).export(metres)
    with pytest.raises(UserError, match=r"small.stl is 0.04 mm long: its lengths are probably metres"):
        _ = open_source(folder, objects=[f"cup={metres}"]).things
    thing = open_source(folder, objects=[f"cup={{shape: mesh, file: {metres}, scale: 1000}}"]).things["cup"]
    np.testing.assert_allclose(thing.surface.pose[:3, 3], [0, 0, -20], atol=1e-6)  # the file's middle is the body's


def test_maniskill_actors_are_bodies(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "trajectory.h5", "w") as file:
        for name in ("traj_10", "traj_2"):
            states = file.create_group(f"{name}/env_states/actors")
            for body in ("hand", "cup"):
                states[body] = np.hstack([path_of(body), np.zeros((ROWS, 6))]).astype(np.float32)
            file[f"{name}/actions"] = np.zeros((ROWS - 1, 8))
    source = open_source(tmp_path / "trajectory.h5", objects=[BALL])
    assert (source.kind, source.fps) == ("maniskill", 20.0)
    assert [source.episode(k).name for k in range(len(source))] == ["traj_2", "traj_10"]
    np.testing.assert_allclose(source.episode(1).bodies["hand"][-1], as_pose(path_of("hand")[-1]), atol=1e-4)


def test_umi_gives_both_fingers_by_the_width(tmp_path: Path) -> None:
    zarr = needs("zarr")
    root = zarr.open_group(tmp_path / "demo.zarr", mode="w", zarr_format=2)
    data, meta = root.create_group("data"), root.create_group("meta")
    hand, width = np.tile(path_of("hand"), (2, 1)), np.linspace(0.08, 0.02, 2 * ROWS)[:, None]
    turn = np.column_stack([np.zeros((2 * ROWS, 2)), 2 * np.arctan2(hand[:, 6], hand[:, 3])])
    arrays = {
        "robot0_eef_pos": hand[:, :3],
        "robot0_eef_rot_axis_angle": turn,
        "robot0_gripper_width": width,
        "cup_pose": np.tile(path_of("cup"), (2, 1)),
    }
    for name, values in arrays.items():
        data.create_array(name, data=values.astype(np.float32))
    meta.create_array("episode_ends", data=np.array([ROWS, 2 * ROWS]))
    source = open_source(tmp_path / "demo.zarr", objects=[BALL], columns={"bodies": {"cup": "cup_pose"}})
    first, second = map(source.episode, range(2))
    assert (source.kind, len(first), len(second)) == ("umi", ROWS, ROWS)
    assert source.fps == pytest.approx(59.94, abs=0.001)
    left, right = first.bodies["robot0_left"], first.bodies["robot0_right"]
    apart = right[:, :3, 3] - left[:, :3, 3]
    np.testing.assert_allclose(np.linalg.norm(apart, axis=1), 1000 * width[:ROWS, 0], atol=1e-4)
    for finger, sign in ((left, 1), (right, -1)):  # the face's z points to the other finger, its frame is right-handed
        np.testing.assert_allclose(finger[:, :3, 2], sign * apart / (1000 * width[:ROWS]), atol=1e-6)
        np.testing.assert_allclose(np.linalg.det(finger[:, :3, :3]), 1.0, atol=1e-9)
        np.testing.assert_allclose(finger[:, :3, 1], first.bodies["robot0"][:, :3, 2], atol=1e-9)


def test_logs_of_replay_are_episodes_with_forces(tmp_path: Path) -> None:
    hand, cup = path_of("hand"), path_of("cup")
    logs = tmp_path / "logs"
    logs.mkdir()
    for name in ("b", "a"):
        pose = {"object_pose": cup, "sensor_pose": hand, "force": np.tile([0.0, 0.0, 2.0], (ROWS, 1))}
        np.savez(logs / f"{name}.npz", time=5 + np.arange(ROWS) / 50, quaternion="wxyz", units="m", **pose)
    source = open_source(logs, objects=[BALL])
    assert (source.kind, source.fps, [source.episode(k).name for k in range(2)]) == ("log", 50.0, ["a", "b"])
    episode = source.episode(0)
    assert episode.time[0] == 0.0
    np.testing.assert_allclose(episode.bodies["sensor"][-1], as_pose(hand[-1]), atol=1e-9)
    np.testing.assert_array_equal(episode.forces["sensor", "cup"][3], [0, 0, 2])


def test_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.pdf").write_text("x")
    with pytest.raises(UserError, match="is none of these: a LeRobot folder"):
        open_source(tmp_path / "notes.pdf")
    with pytest.raises(UserError, match="there is no such file or folder"):
        open_source(tmp_path / "nothing")
    with pytest.raises(UserError, match="unknown key, did you mean units"):
        open_source(tmp_path, columns={"unit": "m"})
