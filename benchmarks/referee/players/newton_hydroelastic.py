"""Newton: a rigid pad and a rigid shape with hydroelastic contact, whose pressure is a stiffness times the depth, by
SolverSemiImplicit, which takes it as it is. The shape rests after a press and has the speed of its path after a slide
or turn; the box is let go for so short a time that it does not move but friction, which grows with speed, bears it."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.referee.case import PAD_MM, STANDARD_GRAVITY_M_S2, Array, Case
from benchmarks.referee.player import Answer
from benchmarks.referee.players.newton_parts import CUDA, MADE, add_shape, clock, lead, said
from benchmarks.referee.playing import FRAME_S, OnCuda, Settings, steps

DEFAULT = {"kh": 1e10, "ratio": 1.0, "kd": 100.0, "voxels": 128}  # stiffness and damping are Newton's own
LOW, HIGH = (7.0, 0.0), (10.0, 2.0)  # of the search
MOST, BAND_M, INERTIA = 1 << 17, 0.003, 7e-7  # contacts; reach of the distance fields; of the box [kg m^2]
STEP_S, FREE = 1e-8, 2000  # time step of the free box, and how many


def settings_at(x: Sequence[float]) -> dict[str, Any]:
    """Settings of a point of the search: logs of the pad's stiffness [Pa/m] and of how much stiffer the shape is."""
    return DEFAULT | {"kh": 10 ** x[0], "ratio": 10 ** x[1]}


def run(case: Case, how: Settings) -> Answer:
    """Play with the pad's stiffness, how much stiffer the shape is, damping, and voxels along the longest side."""
    import newton

    model, free = _model(case, how), case.mass_kg > 0
    pipeline, solver = newton.CollisionPipeline(model, rigid_contact_max=MOST), newton.solvers.SolverSemiImplicit(model)
    contacts, now, then, found, wrenches, start = pipeline.contacts(), model.state(), model.state(), [], [], 0.0
    for before, pose, judged in steps(case, 1, 1, creeping=True):
        lead(now, pose if free else before, pose, FRAME_S)
        pipeline.collide(now, contacts)
        for _ in range(FREE if free and judged else 1):
            now.clear_forces()
            solver.step(now, then, None, contacts, STEP_S)
            now, then = then, now
        wrench = -then.body_f.numpy()[0].astype(float)  # of the pad
        start = start or clock(model)  # after what is compiled
        if judged:
            found.append(_normal(contacts, pose.matrix))
            wrenches.append((wrench[:3], 1000 * wrench[3:] + np.cross(pose[:3], wrench[:3])))
    force, torque = (np.array(part) for part in zip(*wrenches, strict=True))
    return replace(said(model, found, start, case, how), force=force, torque=torque, traction=None)


def _normal(contacts: Any, matrix: Array) -> tuple[Array, Array]:
    """Points (n, 3) [mm] of contact and forces (n, 3) [N] on the pad, without friction."""
    count, names = int(contacts.rigid_contact_count.numpy()[0]), ("shape0", "point0", "point1", "normal", "stiffness")
    first, *ends, n, k = (getattr(contacts, f"rigid_contact_{name}").numpy()[:count].astype(float) for name in names)
    led = (first == 0)[:, None]  # the pads come after the shape
    on, off = np.where(led, ends[::-1], ends)
    on, off, n = 1000 * on, 1000 * off @ matrix[:3, :3].T + matrix[:3, 3], np.where(led, n, -n)
    return (on + off) / 2, n * (k * np.maximum((n * (off - on)).sum(1), 0) / 1000)[:, None]


def _model(case: Case, how: Settings) -> Any:
    """The shape and the pad [m]; a grasp has two pads that are closed."""
    import newton

    free, above, half = case.mass_kg > 0, 0.01 + 2 * case.poses[-1].z / 1000, np.array(PAD_MM) / 2000
    builder, band = newton.ModelBuilder(gravity=(0.0, STANDARD_GRAVITY_M_S2 * free, 0.0)), (-BAND_M, BAND_M)
    sampled = {"sdf_max_resolution": how["voxels"], "sdf_narrow_band_range": band, "sdf_padding": BAND_M}
    material = {"kh": how["kh"], "kd": how["kd"], "mu": case.friction}
    soft = newton.ModelBuilder.ShapeConfig(gap=0.0, is_hydroelastic=True, **material, **sampled)
    known = {"mass": case.mass_kg or 1.0, "inertia": np.diag([INERTIA] * 3), "lock_inertia": True}
    body = builder.add_link(com=(0, 0, 0.005 * free), is_kinematic=not free, **known)
    add_shape(builder, case, body, replace(soft, kh=how["kh"] * how["ratio"]))
    for side, face in ((-1, 0.0), (1, above))[: 1 + free]:
        middle = ((0, 0, face + side * half[2]), (0, 0, 0, 1))
        builder.add_shape_box(-1, xform=middle, hx=half[0], hy=half[1], hz=half[2], cfg=soft)
    return builder.finalize(device=CUDA)


# The best of 40 trials of the presses: mean error from 1000 % to 15 %. Damping, Newton's own, resists slides and tilt.
TUNED = settings_at((np.log10(1.470e8), np.log10(10.80))) | {"kd": 0.0}
PLAYERS = (OnCuda("Newton hydroelastic", *MADE, {"default": DEFAULT, "tuned": TUNED}, run),)
