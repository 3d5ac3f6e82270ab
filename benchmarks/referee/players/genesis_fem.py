"""Genesis: the pad by its implicit FEM, a rigid shape led along the path, contact by its SAP coupler (hydroelastic):
all as in its examples, with the pad's E, nu and density. Forces are the impulses of the coupler's contact. Lengths are
100 times as long, forces 10 000 times as large, since the coupler leaves out contact of smaller areas; the shape moves
by at most 7 mm a step of 1/60 s, and rests. On a core, in double precision."""

import tempfile
import time
from typing import Any

import numpy as np

from benchmarks.referee.case import DENSITY_KG_M3, PAD_MM, POISSONS, YOUNGS_MPA, Array, Case, mesh_of
from benchmarks.referee.engines import LEAST_FRICTION, begin_genesis
from benchmarks.referee.player import Answer, NotPlayed
from benchmarks.referee.playing import Settings, Simulator, answer, place, steps

# Tuned: the factor of its moduli with the least error in the presses, where forces are proportional to it: 91 -> 13 %.
CHOSEN = {"default": {"young_factor": 1.0, "cell_mm": 2.0}, "tuned": {"young_factor": 0.51, "cell_mm": 2.0}}
M_PER_MM, STEP_S, SUBSTEPS = 0.1, 1 / 60, 2
MOVING, RESTING = 6, 10  # steps from frame to frame, and at rest in it
CHORD_MM, HEAVY_KG = 0.02, 1e8  # between the shape and its facets; mass of the shape, which contact does not move
HYDROELASTIC_PA, EXACT = 1e7, 1e-10  # modulus of contact, Genesis's own; tolerances, of its example of a grasp
TOLERANCES = ("sap_convergence_atol", "sap_convergence_rtol", "linesearch_ftol")


def run(case: Case, how: Settings) -> Answer:
    """Play with a factor of both moduli, and with tetrahedra of this size."""
    if case.mass_kg:
        raise NotPlayed("a free body between two soft pads was not set up")
    scene, shape = _scene(case, how["young_factor"], how["cell_mm"])
    found, start = [], 0.0
    for _, pose, judged in steps(case, MOVING, RESTING):
        shape.set_qpos(place(pose, M_PER_MM))
        shape.set_dofs_velocity(np.zeros(6))
        scene.step()
        start = start or time.process_time()  # after what is compiled
        if judged:
            found.append(_contacts(scene.sim.coupler.rigid_fem_contact))
    return answer(found, (time.process_time() - start) / len(case.poses), how)


def _contacts(handler: Any) -> tuple[Array, Array]:
    """Points (n, 3) [mm] of contact and forces (n, 3) [N] on the pad."""
    count, pairs = handler.n_contact_pairs[None], handler.contact_pairs
    axes = np.stack([getattr(pairs, name).to_numpy()[:count] for name in ("tangent0", "tangent1", "normal")], 1)
    total = np.einsum("ni,nij->nj", pairs.sap_info.gamma.to_numpy()[:count], axes)
    return pairs.contact_pos.to_numpy()[:count] / M_PER_MM, total * SUBSTEPS / STEP_S / (1000 * M_PER_MM) ** 2


def _scene(case: Case, young_factor: float, cell_mm: float) -> tuple[Any, Any]:
    """The scene, built, and the shape in it."""
    gs, size = begin_genesis(), np.array(PAD_MM) * M_PER_MM
    others = ("fem_floor_contact_type", "rigid_floor_contact_type", "rigid_rigid_contact_type")
    contact, exact = dict.fromkeys(others, "none") | dict.fromkeys(TOLERANCES, EXACT), {"pcg_threshold": EXACT}
    scene = gs.Scene(
        sim_options=gs.options.SimOptions(dt=STEP_S, substeps=SUBSTEPS, gravity=(0, 0, 0)),
        fem_options=gs.options.FEMOptions(use_implicit_solver=True, enable_vertex_constraints=True, **exact),
        coupler_options=gs.options.SAPCouplerOptions(enable_fem_self_tet_contact=False, **exact, **contact),
        show_viewer=False,
    )
    mesher = {"nobisect": False, "minratio": 1.4, "maxvolume": (cell_mm * M_PER_MM) ** 3 / 6}
    box = gs.morphs.Box(pos=(0, 0, -size[2] / 2), size=tuple(size), **mesher)
    gel = gs.materials.FEM.Elastic(
        model="linear_corotated", E=young_factor * YOUNGS_MPA * 1e6, nu=POISSONS, rho=DENSITY_KG_M3,
        friction_mu=case.friction, hydroelastic_modulus=young_factor * HYDROELASTIC_PA,
    )  # fmt: skip
    pad = scene.add_entity(morph=box, material=gel)
    with tempfile.TemporaryDirectory() as folder:
        mesh, file = mesh_of(case.shape, CHORD_MM), f"{folder}/shape.obj"
        mesh.export(file)
        morph = gs.morphs.Mesh(file=file, scale=M_PER_MM, decimate=False, convexify=False, align=False)
        known = {"friction": max(case.friction, LEAST_FRICTION), "rho": HEAVY_KG / mesh.volume / M_PER_MM**3}
        shape = scene.add_entity(morph=morph, material=gs.materials.Rigid(coup_friction=case.friction, **known))
        scene.build()
    base = (pad.init_positions[:, 2] < -size[2] + 1e-6).nonzero()[:, 0]
    pad.set_vertex_constraints(base, pad.init_positions[base])
    return scene, shape


PLAYERS = (Simulator("Genesis FEM", ("genesis", "torch"), ("genesis-world",), CHOSEN, run),)
