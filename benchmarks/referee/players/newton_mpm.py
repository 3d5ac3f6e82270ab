"""Newton: the pad as elastic material points by SolverImplicitMPM, set up as in its example of a twisted beam, and a
kinematic rigid shape as a collider. Forces are the impulses that the solver reports of it, at rest after a press, and
in motion after a slide or turn."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.referee.case import DENSITY_KG_M3, PAD_MM, POISSONS, YOUNGS_MPA, Case
from benchmarks.referee.player import Answer, NotPlayed
from benchmarks.referee.players.newton_parts import MADE, add_shape, clock, lead, said
from benchmarks.referee.playing import FRAME_S, Settings, Simulator, steps

DEFAULT = {"young_factor": 1.0, "voxel_mm": 1.0, "poissons": POISSONS}
LOW, HIGH = (0.3, 0.3), (2.0, 0.48)  # of the search
MOVING, RESTING = 20, 20  # steps from frame to frame, and at rest in it
POINTS, ITERATIONS, TOLERANCE, DAMPING_S = 3, 250, 1e-6, 0.001  # a voxel's side; of the solver, as in its example


def settings_at(x: Sequence[float]) -> dict[str, Any]:
    """Settings of a point of the search: a factor of E, and Poisson's ratio."""
    return DEFAULT | {"young_factor": x[0], "poissons": x[1]}


def run(case: Case, how: Settings) -> Answer:
    """Play with a factor of E, Poisson's ratio, and voxels."""
    if case.mass_kg:
        raise NotPlayed("a free body between two soft pads was not set up")
    solver, model = _solver(case, how)
    now, then, found, start, step_s = model.state(), model.state(), [], 0.0, FRAME_S / MOVING
    for before, pose, judged in steps(case, MOVING, RESTING, creeping=True):
        lead(now, before, pose, step_s)
        solver.step(now, then, None, None, step_s)
        then.body_q.assign(now.body_q)
        now, then = then, now
        if judged:
            impulses, points, ids = (part.numpy() for part in solver.collect_collider_impulses(now))
            felt = (ids >= 0) & (np.abs(impulses).sum(1) > 0)
            found.append((1000.0 * points[felt], -impulses[felt].astype(float) / step_s))
        start = start or clock(model)  # after what is compiled
    return said(model, found, start, case, how)


def _solver(case: Case, how: Settings) -> tuple[Any, Any]:
    """The solver and its model [m], on a GPU if there is one."""
    import newton
    import warp as wp

    builder, mpm = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0)), newton.solvers.SolverImplicitMPM
    mpm.register_custom_attributes(builder)
    size, voxel = np.array(PAD_MM) / 1000, how["voxel_mm"] / 1000
    count = np.round(POINTS * size / voxel).astype(int)
    cell = size / count
    builder.add_particle_grid(
        pos=wp.vec3(*(cell / 2 - size * (0.5, 0.5, 1.0))), rot=wp.quat_identity(), vel=wp.vec3(),
        dim_x=count[0], dim_y=count[1], dim_z=count[2], cell_x=cell[0], cell_y=cell[1], cell_z=cell[2],
        mass=DENSITY_KG_M3 * cell.prod(), jitter=0.0, radius_mean=cell[0] / 2,
    )  # fmt: skip
    config = newton.ModelBuilder.ShapeConfig(mu=case.friction, margin=0.0)
    add_shape(builder, case, builder.add_body(is_kinematic=True), config)
    model = builder.finalize()
    cuda, known = model.device.is_cuda, model.mpm
    for name, value in (
        ("young_modulus", how["young_factor"] * YOUNGS_MPA * 1e6), ("poisson_ratio", how["poissons"]),
        ("damping", DAMPING_S), ("tensile_yield_ratio", 1.0),
    ):  # fmt: skip
        getattr(known, name).fill_(value)
    held = np.flatnonzero(model.particle_q.numpy()[:, 2] < cell[2] - size[2])  # the lowest points do not move
    model.particle_mass[wp.array(held, dtype=int, device=model.device)].fill_(0.0)
    return mpm(model, config=mpm.Config(
        voxel_size=voxel, grid_type="sparse" if cuda else "dense", strain_basis="P1d",
        max_iterations=ITERATIONS, tolerance=TOLERANCE, warmstart_mode="particles",
        carry_residual_strain="unconverged", grid_padding=0 if cuda else 2,
    )), model  # fmt: skip


CHOSEN = {"default": DEFAULT}
PLAYERS = (Simulator("Newton MPM, implicit", *MADE, CHOSEN, run),)
