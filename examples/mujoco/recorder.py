"""Records a MuJoCo simulation as a log for `tacgen replay --from mujoco`."""

import mujoco
import numpy as np


class Recorder:
    """Poses of an object and of a sensor's body [m], and the contact force on the sensor [N], in the world frame."""

    def __init__(self, model, sensor: str, thing: str) -> None:
        self.model, self.sensor, self.thing = model, model.body(sensor).id, model.body(thing).id
        self.rows = {name: [] for name in ("time", "xpos", "xquat", "sensor_xpos", "sensor_xquat", "force")}

    def add(self, data) -> None:
        """A row of the log; to be called after mj_step, of which the forces are."""
        force, wrench = np.zeros(3), np.zeros(6)
        for k, contact in enumerate(data.contact):
            one, two = self.model.geom_bodyid[[contact.geom1, contact.geom2]]
            if {one, two} == {self.sensor, self.thing}:
                mujoco.mj_contactForce(self.model, data, k, wrench)  # on the second body, in the contact's frame
                force += (1 if two == self.sensor else -1) * contact.frame.reshape(3, 3).T @ wrench[:3]
        poses = [(data.xpos[b], data.xquat[b]) for b in (self.thing, self.sensor)]
        for values, new in zip(self.rows.values(), [data.time, *poses[0], *poses[1], force], strict=True):
            values.append(np.array(new))

    def save(self, path) -> None:
        np.savez(path, **self.rows)
