"""Growth of time and memory of the solve with the size of the mesh; `pipeline` measures the total cost of a frame."""

import math
import time
from itertools import pairwise
from typing import Any

from benchmarks.results_page import Cell, Level, Plot, Result, Say, Series, Table, columns, in_own_process, peak_memory

ABOUT = (
    "A ball of 4 mm with friction 0.6 on the Mini, without labels and images. Each line is a separate process on one"
    " core; processor seconds without compiling."
)
PRESS = "trajectory=[{press: {depth_mm: 1.0, frames: 1}}]"
BALL = ("outputs=[force]", "indenter={shape: sphere, radius_mm: 4}", "contact.friction=0.6")
NODES = {
    "smoke": (600, 1200),
    "normal": (2500, 5000, 10000, 20000),
    "full": (2500, 5000, 10000, 20000, 40000, 60000),
}


def bench(level: Level, say: Say) -> Result:
    """Increasingly fine meshes."""
    growth, curve = _growth(level, say)
    return Result(ABOUT, [growth], [curve])


def solved(sets: list[str]) -> dict[str, Any]:
    """Solve the quickstart with these changes in one frame: seconds, iterations, nodes, and memory [MB]."""
    from tacgen import mechanics
    from tacgen.mechanics import mesh, presolve
    from tacgen.recipe import assets, plan, scene_of_row

    rough = scene_of_row.build(
        plan.load(assets.recipe_path("quickstart"), (*BALL, PRESS, "quality={edge_mm: 1.5}")).rows[0]
    )
    next(mechanics.states(rough, mechanics.Problem.of(rough, mesh.of(rough))))  # compile
    made = presolve.presolved(scene_of_row.build(plan.load(assets.recipe_path("quickstart"), (*BALL, *sets)).rows[0]))
    problem = mechanics.Problem.of(made, mesh.of(made))
    start = time.process_time()
    (state,) = mechanics.states(made, problem)
    seconds, nodes = time.process_time() - start, len(problem.mesh.points)
    return {"nodes": nodes, "seconds": seconds, "iterations": state.iterations, "memory": peak_memory()}


def _growth(level: Level, say: Say) -> tuple[Table, Plot]:
    """Seconds of a frame against nodes; the exponent is the slope of the logarithms."""
    rows: list[list[Cell]] = []
    nodes, each = list[float](), list[float]()
    for wanted in NODES[level]:
        edge = round(0.245 * (13320 / wanted) ** (1 / 2.2), 3)
        found = in_own_process("benchmarks.cost:solved", (PRESS, f"quality={{edge_mm: {edge}, dhat_mm: 0.03}}"))
        seconds, iterations = found["seconds"], found["iterations"]
        nodes.append(found["nodes"])
        each.append(seconds)
        rows.append([edge, found["nodes"], iterations, seconds, seconds / iterations, found["memory"]])
        say(f"{found['nodes']} nodes: {seconds:.1f} s")
    whole, *local = (_slope(*ends) for ends in ((nodes[0], each[0], nodes[-1], each[-1]), *_steps(nodes, each)))
    heads = ("edge [mm]: .3f", "nodes: d", "iterations: d", "s a frame: .2f", "s an iteration: .3f", "memory [MB]: .0f")
    note = f"A press of 1 mm in one frame. The cost grows as nodes^{whole:.2f} over the whole range, and between sizes"
    note += " as nodes^" + ", ".join(f"{slope:.2f}" for slope in local)
    note += ". An iteration is a Newton step of the whole gel, in which contact is solved to equilibrium."
    line = Series(f"nodes^{whole:.2f}", [nodes[0], nodes[-1]], [each[0], each[-1]], line=True)
    plot = Plot("Cost of a frame", "nodes", "s a frame", [Series("measured", nodes, each), line])
    return Table("How cost grows with the mesh", columns(*heads), rows, note), plot


def _steps(nodes: list[float], each: list[float]) -> list[tuple[float, float, float, float]]:
    return [(n, a, m, b) for (n, a), (m, b) in pairwise(zip(nodes, each, strict=True))]


def _slope(n: float, a: float, m: float, b: float) -> float:
    return math.log(b / a) / math.log(m / n)
