"""Presses and slides of a pad against a ball and a bolt in MuJoCo, as logs. python examples/mujoco/presses.py FOLDER

Needs `pip install mujoco`. The pad is a tactile sensor on a robot: stiff servos move it, face down, and the object is
fixed. docs/cookbook/other_simulators.md replays the logs with tacgen.
"""

import argparse
from pathlib import Path

import mujoco
from recorder import Recorder

BOLT = Path(__file__).parents[2] / "objects/hex_bolt/hex_bolt.stl"  # MuJoCo takes its convex hull
SHAPES = {
    "ball": '<geom type="sphere" size="0.004" {contact}/>',
    "bolt": '<geom type="mesh" mesh="bolt" {contact}/>',
}
TOPS = {"ball": 4.0, "bolt": 3.5}  # height of the object's highest point above its origin [mm]
FACE = 24.0  # of the gel above the origin of the sensor's body [mm]
PRESSES = [(0.3, 0.0), (0.5, 0.0), (0.7, 0.0), (0.9, 0.0), (1.1, 0.0)]  # depth and slide that are asked for [mm]
SLIDES = [(0.3, 1.0), (0.5, 1.0), (0.7, 1.0), (0.9, 1.0), (1.1, 1.0)]
MOTIONS = {"ball": PRESSES + SLIDES, "bolt": [(0.2, 0.0), (0.4, 0.0), (0.2, 1.0), (0.4, 1.0)]}
MODEL = """
<mujoco>
  <option timestep="0.001" gravity="0 0 0" cone="elliptic" impratio="10"/>
  <asset><mesh name="bolt" file="{bolt}" scale="0.001 0.001 0.001"/></asset>
  <worldbody>
    <body name="sensor" pos="0.4 0.1 0.5" quat="0 1 0 0">
      <joint name="x" type="slide" axis="1 0 0" damping="200"/>
      <joint name="y" type="slide" axis="0 1 0" damping="200"/>
      <joint name="z" type="slide" axis="0 0 1" damping="200"/>
      <geom type="box" size="0.0126 0.0104 0.002" pos="0 0 0.022" mass="0.5" {contact}/>
    </body>
    <body name="object" pos="0.4 0.1 0.4">{shape}</body>
  </worldbody>
  <actuator>
    <position joint="x" kp="20000"/><position joint="y" kp="20000"/><position joint="z" kp="20000"/>
  </actuator>
</mujoco>
"""


def record(thing: str, depth: float, slide: float, contact: str, path: Path, rows: int = 20) -> None:
    """Press the pad onto an object and slide along it by these lengths [mm]; a row each 20 ms."""
    text = MODEL.format(bolt=BOLT, shape=SHAPES[thing].format(contact=contact), contact=contact)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[2] = -(TOPS[thing] + FACE + 0.1) / 1000 + 0.1
    log = Recorder(model, "sensor", "object")
    touch = (TOPS[thing] + FACE) / 1000 - 0.1  # way of the sensor's body to first touch, up [m]
    count = rows if slide == 0 else 2 * rows
    for row in range(count):
        for step in range(20):
            at = row + (step + 1) / 20
            down, along = min(at / rows, 1.0), max(at / rows - 1.0, 0.0)
            up = touch + (0.1 - (depth + 0.1) * down) / 1000
            data.ctrl[:] = slide * along / 1000, 0.0, -up  # the body's z points down
            mujoco.mj_step(model, data)
        log.add(data)
    log.save(path)


def main(folder: Path, contact: str, rows: int = 20) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for thing, motions in MOTIONS.items():
        for depth, slide in motions:
            name = f"{thing}-{'slide' if slide else 'press'}-{depth:g}.npz"
            record(thing, depth, slide, contact, folder / name, rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--contact", default="", help="attributes of the geoms, such as 'solref=\"-20000 -200\"'")
    given = parser.parse_args()
    main(given.folder, f'friction="0.6 0.005 0.0001" {given.contact}')
