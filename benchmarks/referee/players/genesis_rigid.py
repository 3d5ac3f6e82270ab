"""Genesis: a rigid pad and a rigid shape on six joints, with Genesis's own soft contact, whose stiffness is per mass.

The joints are held by position control that yields less than 1 um, on a core in double precision; forces are those of
`get_contacts`, at rest after a press and in motion after a slide or turn, since friction at rest creeps to 0. The box
of the grasp is free for a second between two closed pads.
"""

import tempfile
import time
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.referee.case import DENSITY_KG_M3, PAD_MM, STANDARD_GRAVITY_M_S2, Array, Case, Pose
from benchmarks.referee.player import Answer
from benchmarks.referee.playing import FRAME_S, along, answer, between, missing, versions

DEFAULT: dict[str, Any] = {}  # Genesis's own
TUNED = DEFAULT
STEP_S, RESTING, FREE = 0.01, 20, 100  # time step, Genesis's own [s]; steps at rest; of the free box
STIFF = {"slide": 1e7, "hinge": 1e3}  # of the control [N/m, N m/rad]; damped by a step's worth
JOINTS = (("slide", "1 0 0"), ("slide", "0 1 0"), ("slide", "0 0 1"), ("hinge", "0 1 0"), ("hinge", "1 0 0"), ("hinge", "0 0 1"))  # fmt: skip
LEAST_FRICTION = 0.01  # that Genesis takes
MODEL = """<mujoco><compiler angle="radian"/><asset><mesh name="shape" file="shape.stl"/></asset><worldbody><body>
{joints}<geom type="mesh" mesh="shape" {mass}/></body></worldbody></mujoco>"""


def begin() -> Any:
    """The package, on a core; it begins once a process."""
    import genesis as gs

    if not getattr(gs, "_initialized", False):
        gs.init(backend=gs.cpu, precision="64", logging_level="error", seed=0)
    return gs


class GenesisRigid:
    name = "Genesis rigid"
    settings = ("default", "tuned")

    def available(self) -> str | None:
        return missing("genesis", "torch")

    def version(self) -> str:
        return versions("genesis-world", "quadrants")

    def play(self, case: Case, setting: str) -> Answer:
        return self.with_contact(case, DEFAULT if setting == "default" else TUNED)

    def with_contact(self, case: Case, how: Mapping[str, Any]) -> Answer:
        """Play with `sol_params` of contact, if given."""
        scene, shape = _scene(case)
        scene.reset()
        if how:
            for geom in scene.rigid_solver.geoms:
                geom.set_sol_params(np.array(how["sol_params"]))
        if not case.mass_kg:
            shape.set_qpos(_joints(Pose(z=max(case.clearance, 0.05))))
        found, last, start = [], Pose(z=max(case.clearance, 0.05)), time.process_time()
        for frame, pose in enumerate(case.poses):
            path = between(last, pose, round(FRAME_S / STEP_S)) + ([] if along(last, pose) else [pose] * RESTING)
            for one in path if not case.mass_kg else range(FREE):
                if not case.mass_kg:
                    shape.control_dofs_position(_joints(one))
                scene.step()
            last = pose
            if frame in case.judged:
                at = {key: np.asarray(value, float) for key, value in shape.get_contacts().items()}
                on_pad = np.where((at["link_a"] == shape.links[-1].idx)[:, None], at["force_b"], at["force_a"])
                found.append((1000 * at["position"], on_pad))
        return answer(found, (time.process_time() - start) / len(case.poses), dict(how))


def _joints(pose: Pose) -> Array:
    """Places of the joints [m, rad]."""
    return np.array([*np.array(pose[:3]) / 1000, *np.radians([pose.tilt_y, pose.tilt_x, pose.yaw])])


@cache
def _scene(case: Case) -> tuple[Any, Any]:
    """The scene, built, and the shape in it [m]; a grasp has two pads that are closed."""
    gs = begin()
    gravity = (0, STANDARD_GRAVITY_M_S2 if case.mass_kg else 0, 0)
    scene = gs.Scene(sim_options=gs.options.SimOptions(dt=STEP_S, gravity=gravity), show_viewer=False)
    bodies = []
    for sign, face in ((-1, 0.0), (1, 0.01 + 2 * case.poses[-1].z / 1000))[: 2 if case.mass_kg else 1]:
        size, place = np.array(PAD_MM) / 1000, (0, 0, face + sign * PAD_MM[2] / 2000)
        bodies.append(scene.add_entity(gs.morphs.Box(size=tuple(size), pos=place, fixed=True)))
    with tempfile.TemporaryDirectory() as folder:
        mesh = case.mesh()
        mesh.apply_scale(0.001).export(Path(folder, "shape.stl"))
        joints = '<freejoint name="free"/>' if case.mass_kg else "".join(
            f'<joint name="{i}" type="{kind}" axis="{axis}"/>' for i, (kind, axis) in enumerate(JOINTS)
        )  # fmt: skip
        mass = f'mass="{case.mass_kg}"' if case.mass_kg else f'density="{DENSITY_KG_M3}"'
        Path(folder, "shape.xml").write_text(MODEL.format(joints=joints, mass=mass))
        start = case.poses[-1].z / 1000 if case.mass_kg else 0.0
        shape = scene.add_entity(gs.morphs.MJCF(file=str(Path(folder, "shape.xml")), pos=(0, 0, start)))
        scene.build()
    for body in (*bodies, shape):
        for geom in body.geoms:
            geom.set_friction(max(case.friction, LEAST_FRICTION))
    if not case.mass_kg:
        stiff = np.array([STIFF[kind] for kind, _ in JOINTS])
        shape.set_dofs_kp(stiff)
        shape.set_dofs_kv(STEP_S * stiff)
    return scene, shape


PLAYERS = (GenesisRigid(),)
