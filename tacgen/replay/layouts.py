"""Names, units and signs of the arrays that simulators export: one Layout each.

Every array has a first axis of rows. Forces act on the sensor and poses are in the world frame, which is the convention
of each simulator's own arrays; `log_file.read` has options for files that differ.
"""

from collections.abc import Container
from typing import NamedTuple

Names = tuple[str, str, str] | tuple[()]  # of a pose, or of position and rotation; () where they are not complete


def _names(there: Container[str], *known: tuple[str, ...]) -> Names:
    pose, position, rotation = (next((name for name in some if name in there), "") for some in known)
    return (pose, position, rotation) if pose or (position and rotation) else ()


class Force(NamedTuple):
    """Arrays that give a force together: `name` and, if there is one, `friction`, which is added to it."""

    name: str
    friction: str = ""
    total: bool = False  # `name` alone includes friction


class Layout(NamedTuple):
    """Names of a simulator's arrays; of several names the first that the file has is read."""

    position: tuple[str, ...]  # of the object
    rotation: tuple[str, ...]
    pose: tuple[str, ...]  # position and quaternion in one array (rows, 7); further columns are ignored
    sensor_position: tuple[str, ...]
    sensor_rotation: tuple[str, ...]
    sensor_pose: tuple[str, ...]
    forces: tuple[Force, ...]
    quaternion: str = ""  # wxyz or xyzw; empty: the file or the user says
    units: str = ""  # m or mm; empty: the file or the user says
    torque: str = ""  # of the whole contact, about the origin of the sensor's body; empty: the simulator has none

    def names_of_object(self, there: Container[str]) -> Names:
        """The arrays `there` that give the object's pose."""
        return _names(there, self.pose, self.position, self.rotation)

    def names_of_sensor(self, there: Container[str]) -> Names:
        """The arrays `there` that give the pose of the sensor's body."""
        return _names(there, self.sensor_pose, self.sensor_position, self.sensor_rotation)

    @property
    def names(self) -> set[str]:
        """All arrays that are read, with those that say time and conventions."""
        poses = (*self.position, *self.rotation, *self.pose)
        sensors = (*self.sensor_position, *self.sensor_rotation, *self.sensor_pose)
        forces = (name for force in self.forces for name in (force.name, force.friction))
        return {"time", "quaternion", "units", self.torque, *poses, *sensors, *forces} - {""}

    @property
    def half_of_sensor(self) -> tuple[str, ...]:
        """Names of arrays that give the sensor's pose only together with another."""
        return (*self.sensor_position[:1], *self.sensor_rotation[:1])


LOG_LAYOUTS = {
    "tacgen": Layout(
        ("object_position",), ("object_quaternion",), ("object_pose",),
        ("sensor_position",), ("sensor_quaternion",), ("sensor_pose",),
        (Force("force", total=True),), torque="torque",
    ),
    # ContactSensorData and RigidObjectData. Quaternions are w x y z up to Isaac Lab 2, x y z w from 3.0 on. Before 3.0,
    # and with PhysX before 6.2, net_forces_w and force_matrix_w are normal forces alone.
    "isaaclab": Layout(
        ("root_pos_w", "root_link_pos_w"), ("root_quat_w", "root_link_quat_w"),
        ("root_pose_w", "root_link_pose_w", "root_state_w"),
        ("pos_w", "body_pos_w"), ("quat_w", "body_quat_w"), ("pose_w", "body_pose_w"),
        (
            Force("normal_force_matrix_w", "friction_force_matrix_w"),
            Force("net_normal_forces_w", "net_friction_forces_w"),
            Force("force_matrix_w", "friction_forces_w"),
            Force("net_forces_w"),
        ),
        units="m",
    ),
    # mjData.xpos and xquat of the two bodies, and the sums of mj_contactForce over their contacts and of its torques
    "mujoco": Layout(
        ("xpos",), ("xquat",), (), ("sensor_xpos",), ("sensor_xquat",), (),
        (Force("force", total=True),), "wxyz", "m", "torque",
    ),
    # State.body_q: position, then quaternion x y z w; SensorContact gives the force on its sensing object
    "newton": Layout(
        (), (), ("body_q",), (), (), ("sensor_body_q",),
        (Force("force_matrix", total=True), Force("total_force", total=True), Force("net_force", total=True)),
        "xyzw", "m",
    ),
    # entity.get_pos() and get_quat() of the two entities, and the sum of force_a or force_b of get_contacts()
    "genesis": Layout(
        ("pos",), ("quat",), (), ("sensor_pos",), ("sensor_quat",), (),
        (Force("force", total=True),), "wxyz", "m",
    ),
}  # fmt: skip
