"""Newton: the pad as a grid of soft tetrahedra by vertex block descent (SolverVBD), and a kinematic rigid shape.

Forces are what the solver says of contact (its observable `contact_f`), at rest. The pad has its true moduli and
density; steps, iterations and contact are as in Newton's examples of soft bodies: 10 of each to 1/60 s, ke 1e5.
"""

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.referee.case import DENSITY_KG_M3, PAD_MM, POISSONS, YOUNGS_MPA, Case, Pose
from benchmarks.referee.player import Answer, NotPlayed
from benchmarks.referee.playing import answer, between, missing, versions, xyzw

DEFAULT = {"young_factor": 1.0, "ke": 1e5, "kd": 1e-4, "cell_mm": 1.0, "iterations": 10}
TUNED = DEFAULT
STEP_S, MOVING, RESTING = 1 / 600, 30, 30  # time step [s]; steps from frame to frame, and at rest in it
CLEAR_MM = 0.05  # above the face, before the first frame


class NewtonSoft:
    name = "Newton soft, VBD"
    settings = ("default", "tuned")

    def available(self) -> str | None:
        return missing("newton")

    def version(self) -> str:
        return versions("newton", "warp-lang")

    def play(self, case: Case, setting: str) -> Answer:
        return self.with_contact(case, DEFAULT if setting == "default" else TUNED)

    def with_contact(self, case: Case, how: Mapping[str, float]) -> Answer:
        """Play with these constants."""
        if case.mass_kg:
            raise NotPlayed("a free body between two soft pads was not set up")
        import newton

        model = _model(case, how)
        pipeline = newton.CollisionPipeline(model, soft_contact_gap=0.001)
        contacts = pipeline.contacts()
        solver = newton.solvers.SolverVBD(
            model,
            iterations=int(how["iterations"]),
            particle_enable_tile_solve=False,
            integrate_with_external_rigid_solver=True,
            rigid_body_particle_contact_buffer_size=2048,
        )
        seen = solver.observables(["contact_f"], contacts=contacts)
        now, then = model.state(), model.state()
        found, start, last = [], 0.0, Pose(z=max(case.clearance, CLEAR_MM))
        for frame, pose in enumerate(case.poses):
            for one in between(last, pose, MOVING) + [pose] * RESTING:
                at = np.array([[*np.array(one[:3]) / 1000, *xyzw(one)]], np.float32)
                then.body_q.assign(at)
                pipeline.collide(now, contacts)
                solver.step(now, then, None, contacts, STEP_S, observables=seen)
                now, then = then, now
                start = start or time.process_time()  # after what is compiled
            last = pose
            if frame in case.judged:
                count = int(contacts.soft_contact_count.numpy()[0])
                local = 1000 * contacts.soft_contact_body_pos.numpy()[:count]
                points = local @ pose.matrix[:3, :3].T + pose.matrix[:3, 3]
                rows = seen.contact_f.numpy()[contacts.rigid_contact_max :][:count]
                found.append((points, -rows[:, :3].astype(float)))  # the solver's are on the shape
        seconds = (time.process_time() - start) / len(case.poses)
        return answer(found, seconds, dict(how))


def _model(case: Case, how: Mapping[str, float]) -> Any:
    """The pad and the shape [m], on a core."""
    import newton
    import warp as wp

    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    young, cell, half = how["young_factor"] * YOUNGS_MPA * 1e6, how["cell_mm"] / 1000, np.array(PAD_MM) / 2000
    cells = [round(size / how["cell_mm"]) for size in PAD_MM]
    place = dict(pos=wp.vec3(-half[0], -half[1], -2 * half[2]), rot=wp.quat_identity(), vel=wp.vec3())
    size = dict(dim_x=cells[0], dim_y=cells[1], dim_z=cells[2], cell_x=cell, cell_y=cell, cell_z=cell)
    mu, lam = young / (2 * (1 + POISSONS)), young * POISSONS / ((1 + POISSONS) * (1 - 2 * POISSONS))
    builder.add_soft_grid(
        **place, **size, density=DENSITY_KG_M3, k_mu=mu, k_lambda=lam, k_damp=1.0, particle_radius=0.0
    )
    for i, at in enumerate(builder.particle_q):
        builder.particle_mass[i] *= at[2] > -2 * half[2] + 1e-6  # the base is fixed
    config = newton.ModelBuilder.ShapeConfig(ke=how["ke"], kd=how["kd"], mu=case.friction, margin=0.0)
    body = builder.add_body(is_kinematic=True)
    if case.shape == "ball":
        builder.add_shape_sphere(body, xform=wp.transform(wp.vec3(0, 0, 0.004)), radius=0.004, cfg=config)
    else:
        mesh = case.mesh()
        builder.add_shape_mesh(body, mesh=newton.Mesh(mesh.vertices / 1000, mesh.faces.ravel()), cfg=config)
    builder.color()
    model = builder.finalize(device="cpu")
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = how["ke"], how["kd"], case.friction
    return model


PLAYERS = (NewtonSoft(),)
