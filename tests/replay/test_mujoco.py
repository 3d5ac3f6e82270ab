"""MuJoCo's own contact forces, as the example records them: signs and frames. Skipped where MuJoCo is not installed."""

import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from helpers.needs import needs
from scipy.spatial.transform import Rotation
from test_python_examples import loaded

from tacgen import replay
from tacgen.recipe import plan
from tacgen.recipe.trajectory import Placement
from tacgen.replay import log_file, selection
from tacgen.replay.contact_log import Conventions

mujoco = needs("mujoco")
Array = np.ndarray
EXAMPLE = Path(__file__).parents[2] / "examples" / "mujoco"
TILT = Rotation.from_rotvec([0.3, -1.1, 2.0])  # of everything in the world
# a pad that slides along its own axes, and below its face a fixed ball; the ball's geom stands first or last
MODEL = """
<mujoco>
  <option gravity="0 0 0" cone="elliptic" impratio="10"/>
  <worldbody>
    <body name="ball" pos="{ball}"><geom type="sphere" size="0.004" friction="0.6"/></body>
    <body name="pad" quat="{quat}">
      <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="slide" axis="0 0 1"/>
      <geom type="{kind}" size="0.01 0.01 0.002" pos="0 0 -0.002" mass="0.2" friction="0.6"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def example() -> dict[str, ModuleType]:
    sys.path.insert(0, str(EXAMPLE))
    return {name: loaded(EXAMPLE / f"{name}.py") for name in ("recorder", "presses")}


def pressed(example: dict[str, ModuleType], name: str, depth: float, slide: float, folder: Path) -> replay.Prepared:
    log = folder / "log.npz"
    example["presses"].record(name, depth, slide, 'friction="0.6" solref="-2100 -90"', log, rows=4)
    recipe = str(EXAMPLE / f"{name}.yaml")
    return replay.prepare([log], recipe, folder / "out", Conventions("mujoco"), replay.Choice())


@pytest.mark.parametrize("kind", ["box", "ellipsoid"])
def test_the_recorded_force_is_that_on_the_sensor(example: dict[str, ModuleType], kind: str, tmp_path: Path) -> None:
    """It equals the constraint force that MuJoCo applies to the pad's joints, whichever geom a contact names first."""
    ball = TILT.apply([0, 0, 0.0038])
    quat = " ".join(map(str, TILT.as_quat(scalar_first=True)))
    model = mujoco.MjModel.from_xml_string(MODEL.format(ball=" ".join(map(str, ball)), quat=quat, kind=kind))
    data = mujoco.MjData(model)
    data.qvel[:] = [0.05, 0.02, 0.0]
    mujoco.mj_forward(model, data)
    log = example["recorder"].Recorder(model, "pad", "ball")
    log.add(data)
    log.save(tmp_path / "log.npz")
    (read,) = log_file.read(tmp_path / "log.npz", Conventions("mujoco"))
    assert read.force is not None
    assert data.qfrc_constraint[2] < -0.01  # the ball pushes the pad down, along its own -z
    assert np.hypot(*data.qfrc_constraint[:2]) > 0.001
    assert read.force[0] == pytest.approx(TILT.apply(data.qfrc_constraint), rel=1e-6)
    assert read.sensor is not None
    assert read.sensor[0, :3, :3] == pytest.approx(TILT.as_matrix())
    poses = selection.relative(read, Placement(), Placement())
    assert poses[0, :3, 3] == pytest.approx([0, 0, 3.8], abs=1e-9)  # the ball's centre, over the pad


def test_the_example_presses_as_deep_as_it_is_asked_to(example: dict[str, ModuleType], tmp_path: Path) -> None:
    """The logs that docs/cookbook/other_simulators.md replays: the ball meets the gel, compressed and dragged along."""
    made = pressed(example, "ball", 0.5, 0.5, tmp_path)
    (log,) = made.logs
    centre = selection.relative(log, made.sensor_pose, Placement())[:, :3, 3]
    assert 3.5 < centre[:, 2].min() < 3.7  # of a ball of 4 mm over the face
    assert log.sensor is not None
    mount = log.sensor[:, :3, :3]
    force = np.einsum("nji,nj->ni", mount, log.force)
    assert force[-1, 2] < -0.5
    assert force[-1, 0] == pytest.approx(0.6 * force[-1, 2], rel=0.02)  # the sensor moves along +x: held back


def test_a_bolt_under_a_sensor_that_looks_down_is_turned(example: dict[str, ModuleType], tmp_path: Path) -> None:
    """The sensor looks down, so the axis of the file that points away from its gel is -z."""
    (row,) = plan.load(pressed(example, "bolt", 0.3, 0.0, tmp_path).recipe).rows
    assert row.recipe.indenter.up == "-z"
    low = np.array([pose.pose for pose in row.replayed(0)])[:, :3, :]
    assert low[:, 2, 2] == pytest.approx(1)  # upright
    assert -0.3 < low[-1, 2, 3] < -0.01  # its lowest point is in the gel
