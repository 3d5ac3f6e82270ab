"""MuJoCo: a rigid pad and a rigid shape with soft contact, whose stiffness is per mass of the shape.

The shape is held at rest at each pose (mj_inverse: what contact gives to a body that does not accelerate); where it is
slid or turned it moves with the speed of its path, since friction at rest creeps to 0 here. Forces are mj_contactForce.
Contact is convex: the ring is 32 capsules. The box of the grasp is free for a second between two closed pads.
"""

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.referee.case import DENSITY_KG_M3, PAD_MM, STANDARD_GRAVITY_M_S2, Array, Case, Pose
from benchmarks.referee.player import Answer
from benchmarks.referee.playing import FRAME_S, along, answer, missing, quaternion, speed, versions

DEFAULT = {"solref": (0.02, 1.0), "solimp": (0.9, 0.95, 0.001, 0.5, 2.0)}  # MuJoCo's own
TUNED = DEFAULT
LOW, HIGH = (4.0, 0.0, 0.0, 0.5, -4.0), (9.0, 3.0, 0.5, 1.0, -2.5)  # logs: stiffness per mass [1/s^2], damping, width


def settings_at(x: Sequence[float]) -> dict[str, Any]:
    """Settings of a point of the search: damping as a part of the critical one, impedance at no depth, and at a
    width [m]."""
    solref = (-(10 ** x[0]), -(10 ** (x[0] / 2 + x[1])))
    return {"solref": solref, "solimp": (x[2], x[3], 10 ** x[4], 0.5, 2.0)}


GRASP_STEPS = 500  # of 2 ms
CAPSULES = 32  # of the ring


class MujocoRigid:
    name = "MuJoCo rigid"
    settings = ("default", "tuned")

    def available(self) -> str | None:
        return missing("mujoco")

    def version(self) -> str:
        return versions("mujoco")

    def play(self, case: Case, setting: str) -> Answer:
        return self.with_contact(case, DEFAULT if setting == "default" else TUNED)

    def with_contact(self, case: Case, how: Mapping[str, Any]) -> Answer:
        """Play with these solref and solimp."""
        import mujoco

        model = _model(case, how).compile()
        data = mujoco.MjData(model)
        found, start = [], time.process_time()
        for before, pose in zip((Pose(), *case.poses), case.poses, strict=False):
            if case.mass_kg:
                mujoco.mj_step(model, data, nstep=GRASP_STEPS)
            else:
                data.qpos[:] = *np.array(pose[:3]) / 1000, *quaternion(pose)
                moved, turned = speed(before, pose, FRAME_S)
                data.qvel[:] = (*moved / 1000, *turned) if along(before, pose) else np.zeros(6)
                data.qacc[:] = 0
                mujoco.mj_inverse(model, data)
            found.append(contacts_on(model, data))
        seconds = (time.process_time() - start) / len(case.poses)
        return answer([found[frame] for frame in case.judged], seconds, dict(how))


def _model(case: Case, how: Mapping[str, Any]) -> Any:
    """The scene [m]; a grasp has two pads that are closed."""
    import mujoco

    spec = mujoco.MjSpec()
    spec.option.gravity = (0, STANDARD_GRAVITY_M_S2 if case.mass_kg else 0, 0)
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    geom, half = spec.default.geom, np.array(PAD_MM) / 2000
    geom.solref[:], geom.solimp[:], geom.friction[0], geom.density = *how.values(), case.friction, DENSITY_KG_M3
    for sign, face in ((-1, 0.0), (1, 0.01 + 2 * case.poses[-1].z / 1000))[: 2 if case.mass_kg else 1]:
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=(0, 0, face + sign * half[2]))
    body = spec.worldbody.add_body(pos=(0, 0, case.poses[-1].z / 1000))
    body.add_freejoint()
    add_shape(spec, body, case)
    if case.mass_kg:
        body.geoms[0].mass = case.mass_kg
    return spec


def add_shape(spec: Any, body: Any, case: Case) -> None:
    """Give a body the shape [m], a mesh unless a primitive is exact, or convex hulls would fill it."""
    import mujoco

    if case.shape == "ball":
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.004, 0, 0), pos=(0, 0, 0.004))
    elif case.shape == "ring":
        turn = np.linspace(0, 2 * np.pi, CAPSULES + 1)
        at = np.stack([3 * np.cos(turn), 3 * np.sin(turn), np.full(len(turn), 0.8)], -1) / 1000
        for ends in zip(at[:-1], at[1:], strict=True):
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=(0.0008, 0, 0), fromto=np.ravel(ends))
    else:
        mesh = case.mesh()
        spec.add_mesh(name="shape", uservert=(mesh.vertices / 1000).ravel(), userface=mesh.faces.ravel())
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="shape")


def contacts_on(model: Any, data: Any, body: int | None = None) -> tuple[Array, Array]:
    """Points (n, 3) [mm] of contact and forces (n, 3) [N] on the pads, of the geoms of the world or, if a body is
    given, against its."""
    import mujoco

    points, forces = np.zeros((data.ncon, 3)), np.zeros((data.ncon, 3))
    for i, contact in enumerate(data.contact):
        local, second = np.zeros(6), contact.geom[1]  # on which the force acts
        mujoco.mj_contactForce(model, data, i, local)
        on_pad = second < 0 or (model.geom_bodyid[second] == 0 if body is None else False)
        points[i], forces[i] = 1000 * contact.pos, (1 if on_pad else -1) * contact.frame.reshape(3, 3).T @ local[:3]
    return points, forces


PLAYERS = (MujocoRigid(),)
