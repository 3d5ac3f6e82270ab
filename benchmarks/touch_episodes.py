"""Episodes of a parallel gripper in MuJoCo, for `tacgen touch`: a LeRobot data set, robomimic's HDF5 and the model.

    python -m benchmarks.touch_episodes FOLDER [--episodes 20] [--seed 0]

Needs MuJoCo and, for FOLDER/lerobot, LeRobot, whose own writer makes it. In each episode the hand comes down to one of
five objects in its stand, grasps, lifts and turns it by 90 degrees, inserts it into a second stand and releases it.
Pads are rigid here; their frames are those of sensors: z out of the face, y down. Rows are at FPS.
"""

import argparse
import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray
OBJECTS_FOLDER = Path(__file__).parents[1] / "objects"
FPS, STEP = 30, 0.002  # rows in a second; MuJoCo's time step [s]
PICTURE = 64  # side of the picture [px]
STANDS = 0.12  # distance of the stands of two objects, and of those of one object [m]
WALL, RISE, PLAY = 0.003, 0.006, 0.0007  # walls of a stand: thickness, height, distance from the object [m]
HOME = 0.1  # height of the pads' centre above the grasp, where an episode begins and ends [m]
LIFT = 0.035  # [m]
HAND = ("hand_x", "hand_y", "hand_z", "hand_yaw")
HAND_JOINTS = (("slide", "1 0 0", 150), ("slide", "0 1 0", 150), ("slide", "0 0 1", 150), ("hinge", "0 0 1", 2))
JOINTS = (*HAND, "left_finger", "right_finger")
PASSES = 'contype="0" conaffinity="0"'  # of geoms that touch nothing
FREE = ("x", "y", "z", "qw", "qx", "qy", "qz")
PADS = ("left_pad", "right_pad")
# phases of an episode and how long they take [s]
PHASES = {"come": 1.8, "close": 0.5, "lift": 0.8, "turn": 1.2, "insert": 0.9, "open": 0.4, "go": 1.6, "wait": 0.8}


@dataclass(frozen=True)
class Kind:
    """An object: its geoms, mass [kg], footprint [m], height of its origin in the stand and of the grasp [m]."""

    name: str
    geoms: str
    mass: float
    foot: tuple[float, float]
    origin: float
    grasp: float


def _nut() -> str:
    """Six boxes around a hole, the axis along x."""
    parts = []
    for k in range(6):
        turn = np.radians(60 * k)
        y, z = 0.010 * np.sin(turn), 0.010 * np.cos(turn)
        quat = f"{np.cos(turn / 2):.9f} {-np.sin(turn / 2):.9f} 0 0"
        parts.append(
            f'<geom class="thing" type="box" size="0.005 0.006928 0.002" pos="0 {y:.9f} {z:.9f}" quat="{quat}"/>'
        )
    return "".join(parts)


ON_EDGE = "1 0 -1 0"  # the file's x up, its z along -x
MESH = '<geom class="thing" type="mesh" mesh="{}" pos="{}" quat="{}"/>'
KINDS = (
    Kind("box", '<geom class="thing" type="box" size="0.009 0.011 0.0225"/>', 0.08, (0.018, 0.022), 0.0225, 0.03),
    # the key stands on end, its flat sides towards the pads; the gear and the nut stand on edge
    Kind("key", MESH.format("key", "0.002 0 0", ON_EDGE), 0.03, (0.004, 0.012), 0.014, 0.0185),
    Kind("gear", MESH.format("gear", "0.003 0 0", ON_EDGE), 0.04, (0.006, 0.02), 0.01, 0.0185),
    Kind(
        "bottle",
        '<geom class="thing" type="cylinder" size="0.012 0.02"/>'
        '<geom class="thing" type="cylinder" size="0.006 0.012" pos="0 0 0.026"/>',
        *(0.1, (0.024, 0.024), 0.02, 0.025),
    ),
    Kind("nut", _nut(), 0.05, (0.010, 0.0208), 0.012, 0.0185),
)


def _stand(x: float, y: float, foot: tuple[float, float]) -> str:
    """Four walls around a footprint."""
    a, b = (side / 2 + PLAY for side in foot)
    walls = [(a + WALL / 2, 0, WALL / 2, b), (0, b + WALL / 2, a, WALL / 2)]
    return "".join(
        f'<geom type="box" pos="{x + s * u:.6f} {y + s * v:.6f} {RISE / 2}" size="{p:.6f} {q:.6f} {RISE / 2}"/>'
        for u, v, p, q in walls
        for s in (-1, 1)
    )


def model_text() -> str:
    """The MJCF of gripper, stands and objects; the meshes key.stl and gear.stl are beside it."""
    places = [(kind, STANDS * (number - 2)) for number, kind in enumerate(KINDS)]
    things = "".join(
        f'<body name="{kind.name}" pos="0 {y:.6f} {kind.origin}"><freejoint name="{kind.name}"/>'
        f'<inertial pos="0 0 0" mass="{kind.mass}" diaginertia="1e-5 1e-5 1e-5"/>{kind.geoms}</body>'
        for kind, y in places
    )
    stands = "".join(_stand(0.0, y, kind.foot) + _stand(STANDS, y, (kind.foot[1], kind.foot[0])) for kind, y in places)
    fingers = "".join(
        f'<body name="{side}_finger" pos="{-0.03 * sign} 0 0" gravcomp="1">'
        f'<joint name="{side}_finger" type="slide" axis="{sign} 0 0" range="0 0.03" damping="5"/>'
        f'<geom type="box" size="0.003 0.011 0.02" pos="{-0.007 * sign} 0 0.02" mass="0.05" {PASSES}/>'
        f'<body name="{side}_pad" gravcomp="1" xyaxes="0 {-sign} 0 0 0 -1">'
        '<geom class="pad" type="box" size="0.012625 0.010375 0.002" pos="0 0 -0.002" mass="0.05"/></body></body>'
        for side, sign in (("left", 1), ("right", -1))
    )
    hand = "".join(
        f'<joint name="{name}" type="{kind}" axis="{axis}" damping="{damping}"/>'
        for name, (kind, axis, damping) in zip(HAND, HAND_JOINTS, strict=True)
    )
    servos = "".join(f'<position name="{n}" joint="{n}" kp="{8 if "yaw" in n else 8000}"/>' for n in HAND)
    motors = "".join(f'<motor name="{name}" joint="{name}"/>' for name in JOINTS[4:])
    return f"""<mujoco model="parallel_gripper">
  <option timestep="{STEP}" cone="elliptic" impratio="20" integrator="implicitfast"/>
  <visual><quality shadowsize="0" offsamples="0"/></visual>
  <default>
    <default class="pad">
      <geom friction="0.8 0.01 0.0001" condim="4" solref="0.005 1" priority="1" rgba=".2 .2 .2 1"/>
    </default>
    <default class="thing"><geom friction="0.5 0.01 0.0001" condim="4" solref="0.005 1" rgba=".8 .6 .2 1"/></default>
  </default>
  <asset>
    <mesh name="key" file="key.stl" scale="0.002 0.002 0.002"/>
    <mesh name="gear" file="gear.stl" scale="0.002 0.002 0.002"/>
  </asset>
  <worldbody>
    <light pos="0 0 1"/>
    <camera name="side" pos="0.06 -0.45 0.35" xyaxes="1 0 0 0 0.6 0.8"/>
    <geom name="table" type="plane" size="1 1 0.1"/>
    {stands}{things}
    <body name="hand" gravcomp="1">{hand}
      <geom type="box" size="0.04 0.011 0.01" pos="0 0 0.05" mass="0.4" {PASSES}/>{fingers}
    </body>
  </worldbody>
  <equality><joint joint1="left_finger" joint2="right_finger" polycoef="0 1 0 0 0" solref="0.004 1"/></equality>
  <actuator>{servos}{motors}</actuator>
</mujoco>
"""


@dataclass(frozen=True)
class RecordedGrasp:
    """The n rows of an episode: time (n,) [s], states of the model, commands (n, 6), forces of the object on both pads
    (n, 6) [N] in the world, pictures (n, PICTURE, PICTURE, 3)."""

    kind: Kind
    time: Array
    qpos: Array
    qvel: Array
    commands: Array
    forces: Array
    pictures: Array

    @property
    def task(self) -> str:
        return f"put the {self.kind.name} into the other stand"


def recorded(model: Any, number: int, seed: int, picture: Callable[[Any], Array]) -> RecordedGrasp:
    """An episode of the object number % 5; its grip, and where it is grasped, are drawn by seed and number."""
    import mujoco

    kind, rng = KINDS[number % len(KINDS)], np.random.default_rng([seed, number])
    grip, aside, height = rng.uniform(4.0, 8.0), rng.uniform(-0.001, 0.001), rng.uniform(0.0, 0.0015)
    y, low = STANDS * (number % len(KINDS) - 2) + aside, kind.grasp + height
    rows: list[list[Array]] = []
    data, drawn = mujoco.MjData(model), []
    data.qpos[-6:], data.ctrl[:4] = (0, y, low + HOME, 0, 0, 0), (0, y, low + HOME, 0)
    for step in range(round(sum(PHASES.values()) / STEP)):
        data.ctrl[:] = _command(step * STEP, y, low, grip)
        if step * STEP * FPS >= len(rows) - 1e-9:
            mujoco.mj_forward(model, data)
            force = np.hstack([contact_force(model, data, pad, kind.name) for pad in PADS])
            rows.append([part.copy() for part in (data.qpos, data.qvel, data.ctrl, force)])
            drawn.append(picture(data))
        mujoco.mj_step(model, data)
    qpos, qvel, commands, forces = (np.array(part) for part in zip(*rows, strict=True))
    return RecordedGrasp(kind, np.arange(len(rows)) / FPS, qpos, qvel, commands, forces, np.array(drawn))


def _command(time: float, y: float, low: float, grip: float) -> tuple[float, ...]:
    """Where the hand shall be, and what the fingers press with, at a time [s]."""
    part, ends = {}, 0.0
    for name, takes in PHASES.items():
        u = float(np.clip((time - ends) / takes, 0, 1))
        part[name], ends = u * u * u * (10 - 15 * u + 6 * u * u), ends + takes
    up = HOME * (1 - part["come"] + part["go"]) + LIFT * (part["lift"] - part["insert"])
    force = -2.0 + (grip + 2.0) * (min(2 * part["close"], 1.0) - min(2 * part["open"], 1.0))
    return STANDS * part["turn"], y, low + up, np.pi / 2 * part["turn"], force, force


def contact_force(model: Any, data: Any, first: str, second: str) -> Array:
    """The force (3,) [N] in the world on the body `first` by `second`."""
    import mujoco

    total, wrench = np.zeros(3), np.zeros(6)
    for k in range(data.ncon):
        names = [model.body(model.geom_bodyid[g]).name for g in data.contact[k].geom]
        if set(names) == {first, second}:
            mujoco.mj_contactForce(model, data, k, wrench)
            world = data.contact[k].frame.reshape(3, 3).T @ wrench[:3]  # on the second of its geoms
            total += world if names[1] == first else -world
    return total


def camera(model: Any) -> Callable[[Any], Array]:
    """Takes pictures of the model's state; black ones where MuJoCo finds no OpenGL."""
    import mujoco

    try:
        renderer = mujoco.Renderer(model, PICTURE, PICTURE)
    except Exception:  # whatever the OpenGL of a machine raises
        return lambda data: np.zeros((PICTURE, PICTURE, 3), np.uint8)

    def picture(data: Any) -> Array:
        renderer.update_scene(data, "side")
        return np.asarray(renderer.render())

    return picture


def _vector(names: list[str]) -> dict[str, Any]:
    return {"dtype": "float32", "shape": (len(names),), "names": names}


def write_lerobot(recordings: Iterator[RecordedGrasp], model: Any, folder: Path) -> Iterator[RecordedGrasp]:
    """Write a LeRobot data set by its own code, handing on each recording."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    things = [f"{kind.name}.{part}" for kind in KINDS for part in FREE]
    features = {
        "observation.state": _vector(list(JOINTS)),
        "observation.environment_state": _vector(things),
        "observation.velocity": _vector([f"qvel_{k}" for k in range(model.nv)]),
        "observation.pad_force": _vector([f"{pad}.f{axis}" for pad in PADS for axis in "xyz"]),
        "observation.images.side": {
            "dtype": "image",
            "shape": (PICTURE, PICTURE, 3),
            "names": ["height", "width", "channels"],
        },
        "action": _vector(list(JOINTS)),
    }
    made = LeRobotDataset.create("touch_episodes", FPS, features, folder, "parallel_gripper", use_videos=False)
    for one in recordings:
        n = 7 * len(KINDS)
        columns = (one.qpos[:, n:], one.qpos[:, :n], one.qvel, one.forces, one.pictures, one.commands)
        for row in zip(*columns, strict=True):
            frame = {name: v if v.ndim > 1 else v.astype(np.float32) for name, v in zip(features, row, strict=True)}
            made.add_frame({**frame, "task": one.task})
        made.save_episode()
        yield one
    made.finalize()


def write_robomimic(recordings: list[RecordedGrasp], path: Path) -> None:
    """Write states, actions and pictures as robosuite's collector and robomimic's converter do."""
    import h5py

    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        about = {"env_name": "ParallelGripper", "type": 1, "env_kwargs": {"control_freq": FPS}}
        data.attrs["env_args"], data.attrs["total"] = json.dumps(about), sum(len(one.time) for one in recordings)
        for number, one in enumerate(recordings):
            demo = data.create_group(f"demo_{number}")
            demo.attrs["model_file"], demo.attrs["num_samples"] = model_text(), len(one.time)
            demo["states"] = np.column_stack([one.time, one.qpos, one.qvel])
            demo["actions"] = one.commands
            demo["obs/side_image"] = one.pictures
            demo["obs/joint_pos"] = one.qpos[:, 7 * len(KINDS) :]
        names = [f"demo_{number}".encode() for number in range(len(recordings))]
        file["mask/train"], file["mask/valid"] = names[: -(len(names) // 5) or None], names[len(names) * 4 // 5 :]


def prepared(folder: Path) -> Any:
    """The compiled model, written into a folder with its meshes."""
    import mujoco

    folder.mkdir(parents=True, exist_ok=True)
    for name in ("key", "gear"):
        shutil.copyfile(OBJECTS_FOLDER / name / f"{name}.stl", folder / f"{name}.stl")
    (folder / "model.xml").write_text(model_text())
    return mujoco.MjModel.from_xml_path(str(folder / "model.xml"))


def write(folder: Path, episodes: int, seed: int) -> None:
    """Make all three in a folder that is not there yet, or is empty."""
    os.environ.setdefault("MUJOCO_GL", "egl")  # needs no screen
    model = prepared(folder)
    picture, done = camera(model), []
    each = (recorded(model, number, seed, picture) for number in range(episodes))
    for one in write_lerobot(each, model, folder / "lerobot"):
        done.append(one)
        print(f"{len(done)} of {episodes}: {one.task}, {len(one.time)} rows", file=sys.stderr)
    write_robomimic(done, folder / "robomimic.hdf5")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    write(given.folder, given.episodes, given.seed)
