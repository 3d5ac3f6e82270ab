"""MuJoCo: the pad as a flex of tetrahedra (flexcomp, dim 3) of its E and nu, and a rigid shape led along the path.

Each step sets place and speed of the shape, of 1 kg. Forces are mj_contactForce, at rest after a press and in motion
after a slide or turn, since friction at rest creeps to 0. Contact is convex: the ring is 32 capsules.
"""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.referee.case import DENSITY_KG_M3, PAD_MM, POISSONS, YOUNGS_MPA, Case
from benchmarks.referee.engines import add_shape, contacts_on
from benchmarks.referee.player import Answer, NotPlayed
from benchmarks.referee.playing import FRAME_S, Settings, Simulator, answer, place, speed, steps

SOFT = {"solref": (0.02, 1.0), "solimp": (0.9, 0.95, 0.001, 0.5, 2.0), "impratio": 1.0}  # MuJoCo's own
DEFAULT = SOFT | {"young_factor": 1.0, "cell_mm": 2.0}
LOW, HIGH = (6.0, 0.4, 0.0), (9.0, 1.6, 2.0)  # of the search
STEP_S, RESTING = 0.002, 25  # time step, MuJoCo's own [s]; steps at rest
RADIUS_M = 1e-4  # of the flex's points: contact begins so far above the face
PAD = """<mujoco><option timestep="{step}" integrator="discrete" solver="CG" cone="elliptic" impratio="{impratio}"
 gravity="0 0 0"/><worldbody><flexcomp name="pad" type="grid" dim="3" count="{n[0]} {n[1]} {n[2]}" spacing="{s} {s} {s}"
 pos="0 0 {middle}" radius="{radius}" mass="{mass}"><pin gridrange="0 0 0 {last[0]} {last[1]} 0"/>
<edge equality="false"/><elasticity young="{young}" poisson="{nu}" damping="0.001"/>
<contact selfcollide="none" solref="{solref}" solimp="{solimp}" friction="{mu} 0 0"/></flexcomp></worldbody></mujoco>"""


def settings_at(x: Sequence[float]) -> dict[str, Any]:
    """Settings of a point of the search: log of contact's stiffness per mass [1/s^2], which is damped critically,
    factor of E, log of impratio."""
    contact = {"solref": (-(10 ** x[0]), -2 * 10 ** (x[0] / 2)), "impratio": 10 ** x[2]}
    return SOFT | contact | {"young_factor": x[1], "cell_mm": 1.0}


def run(case: Case, how: Settings) -> Answer:
    """Play with these constants of contact, factor of E and cells."""
    if case.mass_kg:
        raise NotPlayed("a free body between two soft pads was not set up")
    import mujoco

    mujoco.set_mju_user_warning(lambda _: None)  # solves of the pad that end early, once a case; else kept in a file
    model = _model(case, how)
    data, found, start = mujoco.MjData(model), [], time.process_time()
    joint, above = data.joint("shape"), np.array([0, 0, RADIUS_M, 0, 0, 0, 0])
    for before, pose, judged in steps(case, round(FRAME_S / STEP_S), RESTING, creeping=True):
        joint.qpos[:], joint.qvel[:] = place(pose) + above, speed(before, pose, STEP_S)
        mujoco.mj_step(model, data)
        if judged:
            found.append(contacts_on(model, data))
    return answer(found, (time.process_time() - start) / len(case.poses), how)


def _model(case: Case, how: Settings) -> Any:
    """The pad and the shape [m]."""
    import mujoco

    n = [round(size / how["cell_mm"]) + 1 for size in PAD_MM]
    spec = mujoco.MjSpec.from_string(
        PAD.format(
            n=n, last=[k - 1 for k in n], s=how["cell_mm"] / 1000, middle=-PAD_MM[2] / 2000, step=STEP_S,
            radius=RADIUS_M, mass=DENSITY_KG_M3 * np.prod(PAD_MM) * 1e-9, young=how["young_factor"] * YOUNGS_MPA * 1e6,
            nu=POISSONS, mu=case.friction, impratio=how["impratio"], solref=" ".join(map(str, how["solref"])),
            solimp=" ".join(map(str, how["solimp"])),
        )
    )  # fmt: skip
    geom = spec.default.geom
    geom.solref[:], geom.solimp[:], geom.friction[0] = how["solref"], how["solimp"], case.friction
    add_shape(spec, case, 1.0)
    return spec.compile()


# The best of 18 trials of the presses of ball and edge and the slide with friction .8: their mean error 100 % to 25 %.
TUNED = settings_at((7.23, 1.17, 1.72))
PLAYERS = (Simulator("MuJoCo flex", ("mujoco",), ("mujoco",), {"default": DEFAULT, "tuned": TUNED}, run),)
