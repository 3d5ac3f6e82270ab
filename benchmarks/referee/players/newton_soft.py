"""Newton: the pad as a grid of soft tetrahedra by vertex block descent (SolverVBD), and a kinematic rigid shape. Forces
are contact_f, at rest after a press, and in motion after a slide or turn, since friction at rest creeps to 0."""

from typing import Any

from benchmarks.referee.case import DENSITY_KG_M3, PAD_MM, POISSONS, YOUNGS_MPA, Array, Case
from benchmarks.referee.player import Answer, NotPlayed
from benchmarks.referee.players.newton_parts import MADE, add_shape, clock, lead, said
from benchmarks.referee.playing import Settings, Simulator, steps

DEFAULT = {"young_factor": 1.0, "ke": 1e5, "kd": 1e-4, "cell_mm": 1.0, "iterations": 10}
STEP_S, MOVING, RESTING = 1 / 600, 30, 30  # time step [s]; steps from frame to frame, and at rest in it


def run(case: Case, how: Settings) -> Answer:
    """Play with a factor of E, contact's stiffness and damping, cells, and iterations a step."""
    if case.mass_kg:
        raise NotPlayed("a free body between two soft pads was not set up")
    import newton

    model = model_of(case, how, "cpu")
    pipeline = newton.CollisionPipeline(model, soft_contact_gap=0.001)
    contacts = pipeline.contacts()
    solver = newton.solvers.SolverVBD(
        model, iterations=how["iterations"], particle_enable_tile_solve=False,
        integrate_with_external_rigid_solver=True, rigid_body_particle_contact_buffer_size=2048,
    )  # fmt: skip
    seen = solver.observables(["contact_f"], contacts=contacts)
    now, then, found, start = model.state(), model.state(), [], 0.0
    for _, pose, judged in steps(case, MOVING, RESTING, creeping=True):
        lead(then, pose, pose, STEP_S)
        pipeline.collide(now, contacts)
        solver.step(now, then, None, contacts, STEP_S, observables=seen)
        now, then = then, now
        start = start or clock(model)  # after what is compiled
        if judged:
            found.append(_on_pad(contacts, seen, pose.matrix))
    return said(model, found, start, case, how)


def _on_pad(contacts: Any, seen: Any, matrix: Array) -> tuple[Array, Array]:
    """Points (n, 3) [mm] of contact and forces (n, 3) [N] on the pad; those of the solver are on the shape."""
    count = int(contacts.soft_contact_count.numpy()[0])
    points = 1000 * contacts.soft_contact_body_pos.numpy()[:count] @ matrix[:3, :3].T + matrix[:3, 3]
    return points, -seen.contact_f.numpy()[contacts.rigid_contact_max :][:count, :3].astype(float)


def model_of(case: Case, how: Settings, device: str | None, density: float = DENSITY_KG_M3) -> Any:
    """The pad and the shape [m]."""
    import newton
    import warp as wp

    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    young, cell, base = how["young_factor"] * YOUNGS_MPA * 1e6, how["cell_mm"] / 1000, -PAD_MM[2] / 1000
    x, y, z = (round(size / how["cell_mm"]) for size in PAD_MM)
    lame = {"k_mu": young / (2 * (1 + POISSONS)), "k_lambda": young * POISSONS / ((1 + POISSONS) * (1 - 2 * POISSONS))}
    builder.add_soft_grid(
        pos=wp.vec3(-PAD_MM[0] / 2000, -PAD_MM[1] / 2000, base), rot=wp.quat_identity(), vel=wp.vec3(), dim_x=x,
        dim_y=y, dim_z=z, cell_x=cell, cell_y=cell, cell_z=cell, density=density, k_damp=how.get("damp", 1.0),
        particle_radius=0.0, **lame,
    )  # fmt: skip
    for i, at in enumerate(builder.particle_q):
        builder.particle_mass[i] *= at[2] > base + 1e-6  # the base does not move
    config = newton.ModelBuilder.ShapeConfig(ke=how["ke"], kd=how["kd"], mu=case.friction, margin=0.0)
    add_shape(builder, case, builder.add_body(is_kinematic=True), config)
    builder.color()
    model = builder.finalize(device=device)
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = how["ke"], how["kd"], case.friction
    return model


TUNED = DEFAULT | {"young_factor": 0.84, "ke": 4.71e4}  # the best of a search on three presses: error 32 % to 16 %
CHOSEN = {"default": DEFAULT, "tuned": TUNED}
PLAYERS = (Simulator("Newton soft, VBD", *MADE, CHOSEN, run),)
