"""Logs of simulators: names of arrays, orders of quaternions, units, signs and frames of forces."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tacgen.base.errors import UserError
from tacgen.replay.contact_log import ContactLog, Conventions
from tacgen.replay.log_file import read

Array = np.ndarray
N = 4
RNG = np.random.default_rng(1)
TIME = np.arange(N) * 0.1
POSITION, SENSOR_POSITION = RNG.normal(size=(2, N, 3))  # [m]
TURN, SENSOR_TURN = Rotation.random(N, rng=1), Rotation.random(N, rng=2)
FORCE = RNG.normal(size=(N, 3))  # on the sensor, world frame [N]


def wxyz(turn: Rotation) -> Array:
    return turn.as_quat(scalar_first=True)


def xyzw(turn: Rotation) -> Array:
    return turn.as_quat()


def archive(path: Path, **arrays: Any) -> Path:
    np.savez(path, **({"time": TIME} | arrays))
    return path


def check(log: ContactLog, force: Array = FORCE) -> None:
    """The log is that of the constants above, in mm."""
    for poses, position, turn in ((log.body, POSITION, TURN), (log.sensor, SENSOR_POSITION, SENSOR_TURN)):
        assert poses is not None
        assert poses[:, :3, 3] == pytest.approx(1000 * position)
        assert poses[:, :3, :3] == pytest.approx(turn.as_matrix())
    assert log.force == pytest.approx(force)
    assert log.time == pytest.approx(TIME)


def alone(path: Path, **how: Any) -> ContactLog:
    (log,) = read(path, Conventions(**how))
    return log


def test_arrays_of_mujoco(tmp_path: Path) -> None:
    path = archive(
        tmp_path / "log.npz", xpos=POSITION, xquat=wxyz(TURN), sensor_xpos=SENSOR_POSITION,
        sensor_xquat=wxyz(SENSOR_TURN), force=FORCE,
    )  # fmt: skip
    log = alone(path, layout="mujoco")
    check(log)
    assert log.friction
    assert log.name == "log"


def test_arrays_of_newton_are_transforms(tmp_path: Path) -> None:
    body, sensor = np.hstack([POSITION, xyzw(TURN)]), np.hstack([SENSOR_POSITION, xyzw(SENSOR_TURN)])
    path = archive(tmp_path / "log.npz", body_q=body, sensor_body_q=sensor, total_force=FORCE)
    check(alone(path, layout="newton"))
    matrix = archive(tmp_path / "two.npz", body_q=body, sensor_body_q=sensor, force_matrix=FORCE[:, None, None])
    check(alone(matrix, layout="newton"))


def test_arrays_of_genesis(tmp_path: Path) -> None:
    """An environment axis, of which there is one or one is chosen."""
    arrays = {"pos": POSITION, "quat": wxyz(TURN), "sensor_pos": SENSOR_POSITION, "sensor_quat": wxyz(SENSOR_TURN)}
    path = archive(tmp_path / "log.npz", **{k: v[:, None] for k, v in arrays.items()}, force=FORCE[:, None])
    check(alone(path, layout="genesis"))
    two = {k: np.stack([0 * v, v], 1) for k, v in (arrays | {"force": FORCE}).items()}
    path = archive(tmp_path / "two.npz", **two)
    (log,) = read(path, Conventions("genesis"), [1])
    check(log)
    assert log.name == "two-env-1"
    with pytest.raises(UserError, match=r"two.npz: pos holds 2 environments: choose some with --env, from 0"):
        alone(path, layout="genesis")
    with pytest.raises(UserError, match="holds 2 environments, and no --env 2"):
        read(path, Conventions("genesis"), [2])


def isaac(order: Any, **forces: Array) -> dict[str, Array]:
    """Tensors of one environment, sensor body and filtered body."""
    poses = {"root_pos_w": POSITION, "root_quat_w": order(TURN), "pos_w": SENSOR_POSITION, "quat_w": order(SENSOR_TURN)}
    return {k: v[:, None] for k, v in poses.items()} | {k: v[:, None, None, None] for k, v in forces.items()}


@pytest.mark.parametrize("order", [wxyz, xyzw])
def test_tensors_of_isaac_lab_need_the_order_of_quaternions(tmp_path: Path, order: Any) -> None:
    """It changed with Isaac Lab 3.0: w x y z before."""
    path = archive(tmp_path / "log.npz", **isaac(order, force_matrix_w=FORCE))
    with pytest.raises(UserError, match=r"does not say the order of its quaternions: give --quaternion wxyz or xyzw"):
        alone(path, layout="isaaclab")
    check(alone(path, layout="isaaclab", quaternion=order.__name__))


def test_friction_of_isaac_lab_is_added_to_normal_forces(tmp_path: Path) -> None:
    """It is nan where nothing touches."""
    friction = RNG.normal(size=(N, 3))
    friction[0] = np.nan
    for name, other in (("force_matrix_w", "friction_forces_w"), ("normal_force_matrix_w", "friction_force_matrix_w")):
        path = archive(tmp_path / "log.npz", **isaac(wxyz, **{name: FORCE, other: friction}))
        log = alone(path, layout="isaaclab", quaternion="wxyz")
        check(log, FORCE + np.nan_to_num(friction))
        assert log.friction
    log = alone(archive(tmp_path / "log.npz", **isaac(wxyz, net_forces_w=FORCE)), layout="isaaclab", quaternion="wxyz")
    assert not log.friction
    mixed = isaac(wxyz, force_matrix_w=FORCE) | {"friction_forces_w": friction[:, None, None]}
    several = isaac(wxyz) | {"force_matrix_w": np.zeros((N, 1, 1, 2, 3))}
    for arrays, says in (
        (mixed, "friction_forces_w has another shape than force_matrix_w"),
        (several, r"force_matrix_w has the shape .* record one body and one counterpart"),
    ):
        with pytest.raises(UserError, match=says):
            alone(archive(tmp_path / "log.npz", **arrays), layout="isaaclab", quaternion="wxyz")


def test_a_group_of_an_hdf5_file(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "log.h5", "w") as file:
        for name, array in ({"time": TIME} | isaac(wxyz, force_matrix_w=FORCE)).items():
            file[f"data/demo_0/{name}"] = array
        file["data/demo_0/quaternion"] = "wxyz"
    check(alone(tmp_path / "log.h5", layout="isaaclab", group="data/demo_0"))
    with pytest.raises(UserError, match=r"log.h5: cannot be read: it has no group demo; there are: data"):
        alone(tmp_path / "log.h5", layout="isaaclab", group="demo")


def plain(**more: Any) -> dict[str, Any]:
    poses = {"object_position": POSITION, "object_quaternion": xyzw(TURN)}
    return poses | {"sensor_position": SENSOR_POSITION, "sensor_quaternion": xyzw(SENSOR_TURN), "force": FORCE} | more


def test_a_plain_archive_says_its_units_and_order_or_is_told_them(tmp_path: Path) -> None:
    check(alone(archive(tmp_path / "log.npz", **plain(units="m", quaternion="xyzw"))))
    path = archive(tmp_path / "log.npz", **plain())
    check(alone(path, units="m", quaternion="xyzw"))
    with pytest.raises(UserError, match="does not say the unit of its lengths: give --units mm or m"):
        alone(path, quaternion="xyzw")
    with pytest.raises(UserError, match="its quaternion is xyzw: leave --quaternion wxyz out"):
        alone(archive(tmp_path / "log.npz", **plain(quaternion="xyzw")), units="m", quaternion="wxyz")
    millimetres = plain(object_position=1000 * POSITION, sensor_position=1000 * SENSOR_POSITION)
    check(alone(archive(tmp_path / "log.npz", **millimetres), units="mm", quaternion="xyzw"))


def test_the_force_may_be_on_the_object_or_in_the_axes_of_the_sensor(tmp_path: Path) -> None:
    how = {"units": "m", "quaternion": "xyzw"}
    check(alone(archive(tmp_path / "log.npz", **plain(force=-FORCE)), **how, force_on="object"))
    local = SENSOR_TURN.inv().apply(FORCE)
    check(alone(archive(tmp_path / "log.npz", **plain(force=local)), **how, force_frame="sensor"))
    fixed = {k: v for k, v in plain().items() if not k.startswith("sensor")}
    with pytest.raises(UserError, match="--force-frame sensor: the log has no pose of the sensor"):
        alone(archive(tmp_path / "log.npz", **fixed), **how, force_frame="sensor")


def test_a_table_is_the_plain_format(tmp_path: Path) -> None:
    titles = ["x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"]
    force = [f"force_{axis}_n" for axis in "xyz"]
    header = ",".join(["time_s", *titles, *(f"sensor_{title}" for title in titles), *force])
    rows = np.hstack([TIME[:, None], POSITION, wxyz(TURN), SENSOR_POSITION, wxyz(SENSOR_TURN), FORCE])
    path = tmp_path / "log.csv"
    np.savetxt(path, rows, delimiter=",", header=header, comments="")
    check(alone(path))
    with pytest.raises(UserError, match="is a table, whose columns qw, qx, qy, qz are named"):
        alone(path, quaternion="wxyz")
    rows[2, -1] = np.nan
    np.savetxt(path, rows, delimiter=",", header=header, comments="")
    with pytest.raises(UserError, match=r"log.csv: line 4: the force must be numbers"):
        alone(path)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"time": TIME[::-1]}, "time must increase from row to row"),
        ({"object_quaternion": 2 * xyzw(TURN)}, r"object_quaternion: row 0: a pose needs .* length 1 \(got 2\)"),
        ({"object_position": POSITION[:-1]}, r"object_position has the shape \(3, 3\): expected \(4, ..., 3\)"),
        ({"force": np.full((N, 3), np.nan)}, "force must be numbers, and is not in row 0"),
        ({"force": np.full((N, 3), "one")}, "force holds no numbers"),
        ({"quaternion": "zyxw"}, "its quaternion is 'zyxw', and must be one of wxyz, xyzw"),
        ({"sensor_quaternion": None}, "has sensor_position without sensor_quaternion"),  # not a sensor at rest
        ({"object_position": None}, "has no array object_position and object_quaternion .it has: time"),
    ],
)
def test_what_is_wrong_with_an_archive_is_told_in_a_line(tmp_path: Path, change: dict[str, Any], says: str) -> None:
    arrays = plain(units="m", quaternion="xyzw") | change
    path = archive(tmp_path / "log.npz", **{k: v for k, v in arrays.items() if v is not None})
    with pytest.raises(UserError, match=says) as caught:
        alone(path)
    assert len(caught.value.lines) == 1
    assert str(path) in caught.value.lines[0]


def test_files_and_options_that_are_none(tmp_path: Path) -> None:
    (tmp_path / "log.npz").write_bytes(b"PK\x03\x04 cut short")
    for name, says in (
        ("log.npz", "cannot be read"),
        ("gone.npz", "No such file"),
        ("log.bag", "is no log: it must be"),
    ):
        with pytest.raises(UserError, match=says):
            alone(tmp_path / name)
    for how, says in (({"layout": "gazebo"}, "--from gazebo: must be one of tacgen, isaaclab, mujoco"),
                      ({"quaternion": "wxzy"}, "--quaternion wxzy: must be one of wxyz, xyzw"),
                      ({"force_on": "gripper"}, "--force-on gripper: must be one of sensor, object")):  # fmt: skip
        with pytest.raises(UserError, match=says):
            Conventions(**how)


def test_a_file_of_another_simulator_is_recognised(tmp_path: Path) -> None:
    path = archive(tmp_path / "log.npz", xpos=POSITION, xquat=wxyz(TURN))
    with pytest.raises(UserError, match=r"has no array body_q .it has: .*; its arrays are those of --from mujoco"):
        alone(path, layout="newton")


def test_the_page_names_the_recorder_of_the_example() -> None:
    root = Path(__file__).parents[2]
    assert (root / "examples/mujoco/recorder.py").is_file()
    assert "`examples/mujoco/recorder.py`" in (root / "docs/cookbook/other_simulators.md").read_text()
