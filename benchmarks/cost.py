"""What a frame costs on every sensor, its memory, and how both grow with the mesh."""

import math
import time
from itertools import pairwise
from statistics import median
from typing import Any

from benchmarks.results_page import Cell, Level, Plot, Result, Say, Series, Table, columns, in_own_process, peak_memory

ABOUT = (
    "A ball of 4 mm with friction 0.6, labels and images left out: each line is a process of its own on one core, in"
    " processor seconds, what is compiled being compiled before."
)
DEPTHS = {"gelsight_mini": 1.0, "digit": 0.6, "ninedtact": 1.0}  # [mm]
MOVES = (
    "trajectory=[{{press: {{depth_mm: {depth}, frames: {n}}}}}, {{slide: {{x_mm: 1, frames: {n}}}}},"
    " {{twist: {{angle_deg: 10, frames: {n}}}}}]"
)
PRESS = "trajectory=[{press: {depth_mm: 1.0, frames: 1}}]"
BALL = ("outputs=[force]", "indenter={shape: sphere, radius_mm: 4}", "contact.friction=0.6")
NODES = {
    "smoke": (600, 1200),
    "normal": (2500, 5000, 10000, 20000),
    "full": (2500, 5000, 10000, 20000, 40000, 60000),
}


def bench(level: Level, say: Say) -> Result:
    """Frames on every sensor, and finer and finer meshes."""
    growth, curve = _growth(level, say)
    return Result(ABOUT, [growth] if level == "smoke" else [_frames(level, say), growth], [curve])


def solved(sets: list[str], repeats: int = 1) -> dict[str, Any]:
    """Of the quickstart with these changes: seconds of each frame in each of the runs, one after the other; of the
    last, iterations of each frame; nodes, and memory [MB]."""
    from tacgen import solve
    from tacgen.recipe import assets, plan
    from tacgen.scene import mesh, scene
    from tacgen.solve import foresee

    rough = scene.build(plan.load(assets.recipe_path("quickstart"), (*BALL, PRESS, "quality={edge_mm: 1.5}")).rows[0])
    next(solve.states(rough, solve.Problem.of(rough, mesh.of(rough))))  # compile
    made = foresee.foreseen(scene.build(plan.load(assets.recipe_path("quickstart"), (*BALL, *sets)).rows[0]))
    seconds = list[list[float]]()
    for _ in range(repeats):
        problem = solve.Problem.of(made, mesh.of(made))
        clock, iterations = [time.process_time()], list[int]()
        for state in solve.states(made, problem):
            iterations.append(state.iterations)
            clock.append(time.process_time())
        seconds.append([end - start for start, end in pairwise(clock)])
    nodes = len(problem.mesh.points)
    return {"nodes": nodes, "seconds": seconds, "iterations": iterations, "memory": peak_memory()}


def _frames(level: Level, say: Say) -> Table:
    n, repeats = 5, 5 if level == "full" else 2
    rows: list[list[Cell]] = []
    kinds: list[tuple[str, str, tuple[str, ...]]]
    kinds = [(sensor, quality, ()) for sensor in DEPTHS for quality in ("draft", "default")]
    if level == "full":
        kinds.append(("gelsight_mini", "default, P2", ("mesh=tet",)))
    for sensor, name, more in kinds:
        quality = name.partition(",")[0]
        sets = (f"sensor={sensor}", MOVES.format(depth=DEPTHS[sensor], n=n), f"quality={quality}", *more)
        found = in_own_process("benchmarks.cost:solved", sets, repeats)
        parts = [median(sum(run[k : k + n]) / n for run in found["seconds"]) for k in (0, n, 2 * n)]
        each = [sum(run) / (3 * n) for run in found["seconds"]]
        iterations = sum(found["iterations"]) / (3 * n)
        spread = (max(each) - min(each)) / median(each)
        rows.append([sensor, name, found["nodes"], iterations, *parts, median(each), spread, found["memory"]])
        say(f"{sensor} {name}: {median(each):.2f} s a frame")
    heads = columns(
        "sensor", "quality", "nodes: d", "iterations a frame: .1f",
        "press [s]: .2f", "slide [s]: .2f", "twist [s]: .2f",
        "s a frame: .2f", "spread: .0%", "memory [MB]: .0f",
    )  # fmt: skip
    note = (
        f"Pressed in {n} frames, slid 1 mm in {n}, twisted 10 deg in {n}; median of {repeats} runs, and their spread."
    )
    return Table("What a frame costs", heads, rows, note)


def _growth(level: Level, say: Say) -> tuple[Table, Plot]:
    """Seconds of a frame against nodes; the exponent is the slope of the logarithms."""
    rows: list[list[Cell]] = []
    nodes, each = list[float](), list[float]()
    for wanted in NODES[level]:
        edge = round(0.245 * (13320 / wanted) ** (1 / 2.2), 3)
        found = in_own_process("benchmarks.cost:solved", (PRESS, f"quality={{edge_mm: {edge}, dhat_mm: 0.03}}"))
        seconds, iterations = sum(found["seconds"][0]), sum(found["iterations"])
        nodes.append(found["nodes"])
        each.append(seconds)
        rows.append([edge, found["nodes"], iterations, seconds, seconds / iterations, found["memory"]])
        say(f"{found['nodes']} nodes: {seconds:.1f} s")
    whole, *local = (_slope(*ends) for ends in ((nodes[0], each[0], nodes[-1], each[-1]), *_steps(nodes, each)))
    heads = ("edge [mm]: .3f", "nodes: d", "iterations: d", "s a frame: .2f", "s an iteration: .3f", "memory [MB]: .0f")
    note = f"A press of 1 mm in one frame. It costs as nodes^{whole:.2f} over the whole range, and from size to size as"
    note += " nodes^" + ", ".join(f"{slope:.2f}" for slope in local)
    note += ". An iteration is a step of the whole gel; contact comes to equilibrium within it."
    line = Series(f"nodes^{whole:.2f}", [nodes[0], nodes[-1]], [each[0], each[-1]], line=True)
    plot = Plot("Cost of a frame", "nodes", "s a frame", [Series("measured", nodes, each), line])
    return Table("How cost grows with the mesh", columns(*heads), rows, note), plot


def _steps(nodes: list[float], each: list[float]) -> list[tuple[float, float, float, float]]:
    return [(n, a, m, b) for (n, a), (m, b) in pairwise(zip(nodes, each, strict=True))]


def _slope(n: float, a: float, m: float, b: float) -> float:
    return math.log(b / a) / math.log(m / n)
