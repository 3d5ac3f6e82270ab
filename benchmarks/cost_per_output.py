"""Cost of each output and each feature of a scene."""

import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.results_page import Cell, Level, Result, Say, Table, columns, in_own_processes, peak_memory
from tacgen.base.errors import UserError
from tacgen.outputs import OUTPUT_NAMES

ABOUT = (
    "A ball pressed and slid on the Mini at `draft`. Each line is a separate process on one core, while others run on"
    " the other cores: processor seconds of the scene after a smaller one, which compiles, the peak memory of the"
    " process, and the large packages that it loaded."
)
MOVES = "trajectory=[{press: {depth_mm: 0.8, frames: 1}}, {slide: {x_mm: 0.4, frames: 1}}]"
SCENE = ("indenter={shape: sphere, radius_mm: 4}", MOVES, "contact.friction=0.5", "quality=draft")
FRAMES = 2
LAYER = "law: neo_hooke, poissons_ratio: 0.49, refractive_index: 1.41, source: bench"
BASE, SKIN = (
    "name: base, thickness_mm: 3.2, youngs_modulus_mpa: 0.4",
    "name: skin, thickness_mm: 0.8, youngs_modulus_mpa: 1",
)
TWO_LAYERS = f"sensor.gel.layers=[{{{BASE}, {LAYER}}}, {{{SKIN}, {LAYER}}}]"
ASKED: dict[str, tuple[str, tuple[str, ...]]] = {  # name: (outputs, changes)
    **{name: (name, ()) for name in OUTPUT_NAMES},
    "force, no friction": ("force", ("contact.friction=0",)),
    "force, two layers": ("force", (TWO_LAYERS,)),
    "force, dynamics": ("force", ("dynamics={density_kg_m3: 1000, frame_s: 0.05}",)),
    "force, tetrahedra": ("force", ("mesh=tet",)),
    "rgb by path": ("rgb", ("render={method: path}",)),
    "rgb by table": ("rgb", ("render={method: table}",)),
    "markers, analytic": ("markers", ("markers={method: analytic}",)),
    "everything": (", ".join(OUTPUT_NAMES), ()),
}
# large packages, which a scene should load only if it needs them
LARGE = ("numpy", "scipy", "warp", "h5py", "cvxopt", "pymetis", "mitsuba", "drjit", "matplotlib", "pytetwild",
         "PyfTetWildWrapper", "trimesh", "igl", "pymeshlab", "torch", "PIL", "distributed")  # fmt: skip
WARM_UP = (  # a smaller scene that compiles and fills the caches
    "quality={edge_mm: 1.5, dhat_mm: 0.1, spp: 16}",
    "trajectory=[{press: {depth_mm: 0.4, frames: 1}}]",
)
AT_SMOKE = ("force", "stress")  # lines of ASKED that a smoke test measures
AT_FULL = ("rgb by path",)  # a line for level full alone: optics measures it too


def bench(level: Level, say: Say) -> Result:
    """Every line of ASKED, and the cost of labels on every sensor."""
    rows: list[list[Cell]] = []
    normal = tuple(name for name in ASKED if name not in AT_FULL)
    names = {"smoke": AT_SMOKE, "normal": normal, "full": tuple(ASKED)}[level]
    alone = None
    for name, found in zip(
        names, in_own_processes("benchmarks.cost_per_output:run", map(ASKED.__getitem__, names)), strict=True
    ):
        if isinstance(found, RuntimeError):  # a package that is not installed
            rows.append([name, None, None, None, None, str(found).splitlines()[-1]])
            continue
        seconds = found["seconds"] / FRAMES
        alone = alone or seconds
        packages = ", ".join(found["packages"])
        rows.append([name, seconds, seconds / alone, found["memory"], len(found["modules"]), packages])
        say(f"{name}: {seconds:.2f} s a frame, {found['memory']:.0f} MB")
    heads = columns("asked for", "s a frame: .3f", "of force alone: .2f", "memory [MB]: .0f", "modules of tacgen: d")
    table = Table("What is asked for", {**heads, "large packages": ""}, rows)
    return Result(ABOUT, [table] if level == "smoke" else [table, _labels(say)])


def rows_of(outputs: str, sets: list[str]) -> Any:
    """The plan's rows of the scene with these outputs and changes."""
    from tacgen.recipe import assets, plan

    return plan.load(assets.recipe_path("quickstart"), (*SCENE, *sets, f"outputs=[{outputs}]")).rows


def run(outputs: str, sets: list[str]) -> dict[str, Any]:
    """Run the scene through the pipeline in this process, after a coarse one: seconds, memory, modules and packages.
    A UserError ends the process."""
    from tacgen.batch import pipeline

    rough, rows = rows_of(outputs, [*sets, *WARM_UP]), rows_of(outputs, sets)
    with TemporaryDirectory() as folder:
        pipeline.run(rough, Path(folder) / "rough")
        started = time.process_time()
        result = pipeline.run(rows, Path(folder) / "scene")[0]
        seconds = time.process_time() - started
    if result.status != "ok":
        raise UserError(result.reason)
    modules = sorted(name for name in sys.modules if name.partition(".")[0] == "tacgen")
    packages = [name for name in LARGE if name in sys.modules]
    return {"seconds": seconds, "memory": peak_memory(), "modules": modules, "packages": packages}


def _labels(say: Say) -> Table:
    """Time of stress and maps at `default` compared with the solve, and their consistency."""
    rows: list[list[Cell]] = []
    sensors = ("gelsight_mini", "digit", "ninedtact")
    for sensor, found in zip(
        sensors, in_own_processes("benchmarks.cost_per_output:labels", [(s,) for s in sensors]), strict=True
    ):
        if isinstance(found, RuntimeError):
            raise found
        solved, stressed, mapped = found["seconds"]
        share = (stressed + mapped) / solved
        rows.append([sensor, solved, 1e3 * stressed, 1e3 * mapped, share, *found["worst"]])
        say(f"{sensor}: labels take {share:.1%} of the solve")
    heads = columns("sensor", "solve [s]: .2f", "stress [ms]: .0f", "maps [ms]: .0f", "share: .1%")
    heads |= columns("force: .2%", "traction: .1%", "alternates: .1%", "map's sum: .0e", "Coulomb: .1e")
    note = (
        "At `default`, friction 0.6; share: time of stress and maps over that of the solve. In the worst frame:"
        " the sum of sigma n against the force; sigma n against the contact traction (L2); the alternation of"
        " pressure between cells; the error of the force map's sum; the largest excess of traction over Coulomb's"
        " law."
    )
    return Table("Labels: cost and agreement", heads, rows, note)


def labels(sensor: str) -> dict[str, list[float]]:
    """Seconds a frame of solve, stress and maps, and the inconsistencies of the worst frame."""
    import numpy as np

    from tacgen import mechanics
    from tacgen.mechanics import mesh
    from tacgen.optics.camera import PinholeCamera
    from tacgen.outputs import gel_surface
    from tacgen.outputs.cauchy_stress import Stresses
    from tacgen.outputs.contact_maps import maps
    from tacgen.recipe import assets, plan, scene_of_row

    slide, twist = "{slide: {x_mm: 1, y_mm: 0.3, frames: 2}}", "{twist: {angle_deg: 12, frames: 2}}"
    moves = f"trajectory=[{{press: {{depth_mm: 0.8, frames: 2}}}}, {slide}, {twist}]"
    outputs = f"sensor={sensor}", "outputs=[stress, traction]"
    sets = (*outputs, "indenter={shape: sphere, radius_mm: 4}", moves, "contact.friction=0.6")
    row = plan.load(assets.recipe_path("quickstart"), sets).rows[0]
    made = scene_of_row.build(row)
    problem = mechanics.Problem.of(made, mesh.of(made))
    camera, stresses = PinholeCamera.from_sensor(row.sensor), Stresses(problem)
    rest = gel_surface.GelSurface(problem.mesh.points, problem.mesh.facets["coated"])
    seconds, worst = np.zeros(3), np.zeros(5)
    states, count = mechanics.states(made, problem), 0
    while True:
        clock = [time.process_time()]
        state = next(states, None)
        clock.append(time.process_time())
        if state is None:
            break
        quality = stresses.quality(stresses.at(state.x), state)
        clock.append(time.process_time())
        found = maps(problem, rest.moved(state.x), state, camera)
        clock.append(time.process_time())
        if count:  # the first compiles
            seconds += np.diff(clock)
        count += 1
        force, _ = gel_surface.wrench(problem, state)
        lost = np.linalg.norm(found.force.sum((0, 1)) - force) / np.linalg.norm(force)
        size, limit = np.linalg.norm(found.traction, axis=-1), 0.6 * found.pressure
        worst = np.maximum(worst, [*quality.values(), lost, (size - limit).max() / limit.max()])
    return {"seconds": (seconds / (count - 1)).tolist(), "worst": worst.tolist()}
