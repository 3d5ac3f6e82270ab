"""MuJoCo: a rigid pad and a rigid shape with soft contact, whose stiffness is per mass of the shape.

The shape is held at each pose (mj_inverse: what contact gives to a body that does not accelerate), at rest after a
press and with the speed of its path after a slide or turn, since friction at rest creeps to 0; forces are those of
mj_contactForce. Contact is convex: the ring is 32 capsules. The box is free for a second between two closed pads.
"""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.referee.case import DENSITY_KG_M3, PAD_MM, STANDARD_GRAVITY_M_S2, Case
from benchmarks.referee.engines import add_shape, contacts_on
from benchmarks.referee.player import Answer
from benchmarks.referee.playing import FRAME_S, Settings, Simulator, answer, place, speed, steps

DEFAULT = {"solref": (0.02, 1.0), "solimp": (0.9, 0.95, 0.001, 0.5, 2.0)}  # MuJoCo's own
LOW, HIGH = (4.0, 0.0, 0.0, 0.5, -4.0), (9.0, 3.0, 0.5, 1.0, -2.5)  # of the search
GRASP_STEPS = 500  # of 2 ms, of the free box


def settings_at(x: Sequence[float]) -> dict[str, Any]:
    """Settings of a point of the search: logs of stiffness per mass [1/s^2] and of damping as a part of critical,
    impedance at no depth and at a width, log of the width [m]."""
    solref = (-(10 ** x[0]), -(10 ** (x[0] / 2 + x[1])))
    return {"solref": solref, "solimp": (x[2], x[3], 10 ** x[4], 0.5, 2.0)}


def run(case: Case, how: Settings) -> Answer:
    """Play with these solref and solimp."""
    import mujoco

    model = _model(case, how).compile()
    data, found, start = mujoco.MjData(model), [], time.process_time()
    for before, pose, judged in steps(case, 1, 1, creeping=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = place(pose), speed(before, pose, FRAME_S), 0
        if judged and case.mass_kg:
            mujoco.mj_resetData(model, data)
            mujoco.mj_step(model, data, nstep=GRASP_STEPS)
        elif judged:
            mujoco.mj_inverse(model, data)
        found += [contacts_on(model, data)] * judged
    return answer(found, (time.process_time() - start) / len(found), how)


def _model(case: Case, how: Settings) -> Any:
    """The scene [m]; a grasp has two pads that are closed."""
    import mujoco

    spec = mujoco.MjSpec()
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.gravity = (0, STANDARD_GRAVITY_M_S2 if case.mass_kg else 0, 0)
    geom, half = spec.default.geom, np.array(PAD_MM) / 2000
    geom.solref[:], geom.solimp[:] = how["solref"], how["solimp"]
    geom.friction[0], geom.density = case.friction, DENSITY_KG_M3
    for sign, face in ((-1, 0.0), (1, 0.01 + 2 * case.poses[-1].z / 1000))[: 2 if case.mass_kg else 1]:
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=(0, 0, face + sign * half[2]))
    add_shape(spec, case, case.mass_kg).pos = (0, 0, case.poses[-1].z / 1000)
    return spec


# The best of 200 trials of all cases: their mean error, of which 10 is the most, from 86 % to 51 %.
TUNED = {"solref": (-1.92e6, -1.507e5), "solimp": (0.2125, 0.6038, 0.000979, 0.5, 2.0)}
PLAYERS = (Simulator("MuJoCo rigid", ("mujoco",), ("mujoco",), {"default": DEFAULT, "tuned": TUNED}, run),)
