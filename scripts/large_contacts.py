"""Large contacts: the condensed solver against Newton's method on all unknowns, at equal tolerances.

    python -m scripts.large_contacts [LIMIT_S] [NAME ...]

Boxes of growing size are pressed and slid on a GelSight Mini, and two objects of benchmarks/draws.py that fold the gel
are pressed. Both methods run in turn; prints processor seconds a frame.
"""

import sys
from dataclasses import replace

import numpy as np

from benchmarks.draws import drawn
from benchmarks.reference_runs import row_of, solve_frames
from tacgen import mechanics
from tacgen.mechanics import DEFAULT, mesh, presolve
from tacgen.recipe import scene_of_row

LIMIT_S = 120.0  # of processor time of a run, after which no further frame is begun [s]
METHODS = {"condensed": DEFAULT, "all unknowns": replace(DEFAULT, condense=False)}
EDGE = "quality={edge_mm: 0.45, dhat_mm: 0.03}"
PRESS = "{press: {depth_mm: 0.4, frames: 2}}"
SLIDE = "{slide: {x_mm: 0.6, frames: 2}}"


def box(size: float, *moves: str) -> tuple[str, ...]:
    """A box with a square face of this side [mm]."""
    face = f"indenter={{shape: box, size_x_mm: {size}, size_y_mm: {size}, fillet_mm: 0.6}}"
    return ("outputs=[force]", face, f"trajectory=[{', '.join(moves)}]", "contact.friction=0.5", EDGE)


def ordinary(index: int) -> tuple[str, ...]:
    draw = drawn(index)
    return (f"sensor={draw.sensor}", *draw.sets, "quality=default")


SIZES = (4.0, 6.5, 9.5, 13.5)  # [mm]
SCENES = {f"pressed {size:g} mm": box(size, PRESS) for size in SIZES}
SCENES |= {f"slid {size:g} mm": box(size, PRESS, SLIDE) for size in SIZES}
SCENES |= {f"{drawn(index).shape} {index}": ordinary(index) for index in (307, 305)}


def main(limit: float, names: list[str]) -> None:
    row = "{:14} {:13} {:>8} {:>7} {:>10} {:>14} {:>7}  {}"
    print(row.format("scene", "method", "unknowns", "frames", "s a frame", "Newton steps", "damped", "status"))
    for name in names or SCENES:
        made = presolve.presolved(scene_of_row.build(row_of(SCENES[name])))
        forces = []
        for method, options in METHODS.items():
            problem = mechanics.Problem.of(made, mesh.of(made), options)
            found = solve_frames(made, problem, limit)
            size = problem.tangent.condensation.size if options.condense else 3 * len(problem.mesh.points)
            count = len(found.states)
            work = sum(state.iterations for state in found.states)
            damped = sum(state.damped > 0 for state in found.states)
            status = found.status if found.status == "ok" else f"{found.status}: {found.reason}"
            print(row.format(name, method, size, count, f"{found.seconds / max(count, 1):.2f}", work, damped, status))
            sys.stdout.flush()
            forces.append(found.forces)
        both = min(map(len, forces))
        off = np.linalg.norm(forces[0][:both] - forces[1][:both], axis=1) / np.linalg.norm(forces[0][:both], axis=1)
        print(f"    force differs by {off.max(initial=0):.1e} of it in {both} frames")


if __name__ == "__main__":
    given = sys.argv[1:]
    main(float(given[0]) if given else LIMIT_S, given[1:])
