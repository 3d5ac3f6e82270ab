"""Newton: the pad of `newton_soft` by its solvers XPBD and semi-implicit (explicit finite elements), and a
kinematic rigid shape. Neither reports contact with points: forces are those that the tetrahedra exert on the points
of the face (`State.particle_f` after a step of SolverSemiImplicit), at rest after a press, and in motion after a slide
or turn. Time steps of the explicit solver are stable with a density a hundred times as large, which is none of statics.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.referee.case import DENSITY_KG_M3, Case
from benchmarks.referee.player import Answer, NotPlayed
from benchmarks.referee.players import newton_soft
from benchmarks.referee.players.newton_parts import MADE, clock, lead, said
from benchmarks.referee.playing import FRAME_S, Settings, Simulator, steps

XPBD = {
    "solver": "XPBD",
    "young_factor": 1.0,
    "ke": 1e5,
    "kd": 1e-4,
    "cell_mm": 1.0,
    "iterations": 2,
    "relaxation": 0.9,
}
EXPLICIT = {"solver": "SemiImplicit", "young_factor": 1.0, "ke": 1e3, "kd": 0.0, "cell_mm": 1.0, "damp": 50.0}
LOW, HIGH = (0.2, 2.0), (2.0, 4.0)  # of the search of the explicit solver
FAR_M = 0.1  # no point of the pad is so far away
STEPS, DENSER = {"XPBD": 60, "SemiImplicit": 4000}, {"XPBD": 1.0, "SemiImplicit": 100.0}  # steps a frame; of density


def run(case: Case, how: Settings) -> Answer:
    """Play with a solver, a factor of E, contact's stiffness and damping, and cells."""
    if case.mass_kg:
        raise NotPlayed("a free body between two soft pads was not set up")
    import newton

    name = how["solver"]
    model = newton_soft.model_of(case, how, None, DENSITY_KG_M3 * DENSER[name])  # on a GPU if there is one
    model.particle_grid = None  # points do not touch one another
    pipeline = newton.CollisionPipeline(model, soft_contact_gap=0.001)
    elastic = newton.solvers.SolverSemiImplicit(model, enable_tri_contact=False)
    solver = elastic
    if name == "XPBD":
        solver = newton.solvers.SolverXPBD(model, iterations=how["iterations"], soft_body_relaxation=how["relaxation"])
    contacts, step_s = pipeline.contacts(), FRAME_S / STEPS[name]
    now, then, found, start = model.state(), model.state(), [], 0.0
    face = np.flatnonzero(model.particle_q.numpy()[:, 2] > -1e-6)
    for before, pose, judged in steps(case, STEPS[name], STEPS[name], creeping=True):
        lead(now, before, pose, step_s)
        pipeline.collide(now, contacts)
        now.clear_forces()
        solver.step(now, then, None, contacts, step_s)
        now, then = then, now
        if judged:
            if not np.isfinite(now.particle_q.numpy()).all() or abs(now.particle_q.numpy()).max() > FAR_M:
                raise NotPlayed("the pad's points flew away")
            now.clear_forces()
            elastic.step(now, then, None, None, step_s)  # for its forces alone
            points, forces = (1000.0 * now.particle_q.numpy()[face], -now.particle_f.numpy()[face].astype(float))
            found.append((points, forces))
        start = start or clock(model)  # after what is compiled
    return said(model, found, start, case, how)


def settings_at(x: Sequence[float]) -> dict[str, Any]:
    """Settings of the explicit solver: a factor of E, and the log of contact's stiffness [N/m]."""
    return EXPLICIT | {"young_factor": x[0], "ke": 10 ** x[1]}


PLAYERS = (
    Simulator("Newton soft, XPBD", *MADE, {"default": XPBD}, run),
    Simulator("Newton soft, semi-implicit", *MADE, {"default": EXPLICIT}, run),
)
