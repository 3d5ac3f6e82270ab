"""Measure how errors of force and pressure fall with the element edge, and what choosing the edge by the contact saves.

    python scripts/edge_law.py measure FILE [--scenes 60] [--first 1000] [--seconds 500]
    python scripts/edge_law.py fit FILE [FILE ...]

`measure` draws ordinary scenes (benchmarks/draws.py, from number --first on), presses each in four frames, slides it in
one, and solves it with several edges, coarse to fine, one scene a core. Each solve becomes one line of JSON in FILE,
with the errors against the finest one. `fit` prints the mean errors and seconds by shape and edge, the exponents of a
power law in the edge and in the width of the contact (2 area / perimeter of the overlap), and the seconds a frame of
edges that grow with a power of that width, beside one edge for all with the same mean error.
"""

import argparse
import json
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.draws import THICKNESS, drawn
from benchmarks.reference_runs import row_of, solve_frames
from tacgen import mechanics
from tacgen.errors import UserError
from tacgen.mechanics import mesh, presolve
from tacgen.mechanics.expected_error import FaceGrid
from tacgen.mechanics.scene import Scene
from tacgen.optics.camera import PinholeCamera
from tacgen.outputs import contact_maps, gel_surface
from tacgen.recipe import scene_of_row

Array = np.ndarray
PRESS = 4  # frames of the press
STEP = 0.05  # between the points of the face at which the overlap is counted [mm]
LADDER = (1.2, 0.85, 0.6, 0.42, 0.3, 0.21)  # edges [mm]; the last is the reference
DHAT = 1 / 8  # range of contact over the edge [-]
MORE = ((0.6, 0.05), (0.3, 0.02))  # edges with another range of contact [mm]
FINEST_DHAT = 0.02  # of the reference [mm]
LEAST, BASE = 2e-3, 0.6  # added to errors, whose sign changes [-]; the edge that is compared with [mm]
LIMIT_S = 150.0  # longest solve [s]


@dataclass(frozen=True)
class Solved:
    """A scene on one mesh: force (frames, 3) [N], pressure (frames, h, w) [MPa], processor seconds a frame."""

    force: Array
    pressure: Array
    seconds: float
    damped: int
    nodes: int
    status: str


def overlap(scene: Scene) -> list[tuple[float, float]]:
    """Of each frame of the press, area [mm^2] and perimeter [mm] of the untouched face that the indenter overlaps."""
    face = FaceGrid.of(scene.gel, STEP)
    return [face.overlap(scene.shape, matrix) for matrix in scene.poses[:PRESS]]


def solved(sets: tuple[str, ...], edge: float, dhat: float, limit: float) -> tuple[Scene, Solved]:
    """The scene with this edge and range of contact [mm], solved for at most `limit` processor seconds."""
    row = row_of(("outputs=[force]", *sets, f"quality={{edge_mm: {edge}, dhat_mm: {dhat}}}"))
    made = presolve.presolved(scene_of_row.build(row))
    problem = mechanics.Problem.of(made, mesh.of(made))
    found = solve_frames(made, problem, limit)
    coated = gel_surface.GelSurface(problem.mesh.points, problem.mesh.facets["coated"])
    camera = PinholeCamera.from_sensor(row.sensor)
    maps = [contact_maps.maps(problem, coated.moved(s.x), s, camera).pressure[::2, ::2] for s in found.states]
    n, damped = max(1, len(found.states)), sum(state.damped > 0 for state in found.states)
    answer = Solved(
        found.forces, np.nan_to_num(maps), found.seconds / n, damped, len(problem.mesh.points), found.status
    )
    return made, answer


def measured(file: Path, until: float, number: int) -> None:
    """Append the lines of one scene to `file`."""
    draw = drawn(number)
    sets = [f"sensor={draw.sensor}", *(one for one in draw.sets if not one.startswith("trajectory"))]
    depth = next(one for one in draw.sets if one.startswith("trajectory")).partition("depth_mm: ")[2].partition(",")[0]
    moves = f"trajectory=[{{press: {{depth_mm: {depth}, frames: {PRESS}}}}}, {{slide: {{x_mm: 0.2, frames: 1}}}}]"
    runs: dict[tuple[float, float], Solved] = {}
    sizes: list[tuple[float, float]] = []
    radius = 0.0
    ladder = [(edge, edge * DHAT) for edge in LADDER[:-1]]
    for edge, dhat in [*ladder[:3], MORE[0], *ladder[3:], MORE[1], (LADDER[-1], FINEST_DHAT)]:
        left = until - time.time()
        if left < 1:
            break
        try:
            made, runs[edge, dhat] = solved((*sets, moves), edge, dhat, min(left, LIMIT_S))
        except UserError as error:
            print(number, draw.shape, edge, error.lines[0][:90], flush=True)
            continue
        if len(runs[edge, dhat].force) < PRESS + 1:
            del runs[edge, dhat]
            continue
        sizes = overlap(made)
        radius = float(getattr(made.shape, "smallest_radius", 0.0))
    if len(runs) < 3:
        return
    finest = runs[min(runs)]
    reference = np.linalg.norm(finest.force, axis=1)
    lines = []
    for (edge, dhat), run in runs.items():
        pressure = [
            float(np.linalg.norm(a - b) / np.linalg.norm(b)) for a, b in zip(run.pressure, finest.pressure, strict=True)
        ]
        lines.append(
            {
                "scene": number,
                "sensor": draw.sensor,
                "shape": draw.shape,
                "sets": draw.sets,
                "thickness": THICKNESS[draw.sensor],
                "depth": float(depth),
                "radius": radius,
                "sizes": sizes,
                "edge": edge,
                "dhat": dhat,
                "finest": min(runs)[0],
                "force": run.force.tolist(),
                "error": (np.linalg.norm(run.force, axis=1) / reference - 1).tolist(),
                "apart": (np.linalg.norm(run.force - finest.force, axis=1) / reference).tolist(),
                "pressure": pressure,
                "seconds": run.seconds,
                "damped": run.damped,
                "nodes": run.nodes,
                "status": run.status,
            }
        )
    with file.open("a") as out:
        out.write("".join(json.dumps(line) + "\n" for line in lines))
    print(
        number,
        draw.sensor,
        draw.shape,
        *(f"{one['edge']:g}: {one['error'][PRESS - 1]:+.2%}" for one in lines),
        flush=True,
    )


def measure(file: Path, numbers: range, seconds: float) -> None:
    """Every scene, one a core, until the time is over."""
    from tacgen.batch import worker_process

    until = time.time() + seconds
    with ProcessPoolExecutor(worker_process.cores(), mp_context=get_context("spawn")) as workers:
        for _ in workers.map(partial(measured, file, until), numbers):
            pass


def fit(files: list[Path]) -> None:
    """Print what the lines of `measure` say."""
    lines = [json.loads(line) for file in files for line in file.read_text().splitlines()]
    plain = [one for one in lines if abs(one["dhat"] - DHAT * one["edge"]) < 1e-6 and one["edge"] > one["finest"]]
    print("shape: edge [mm], scenes, mean error of force, of pressure (L2), seconds a frame")
    for shape in sorted({one["shape"] for one in plain}):
        for edge in LADDER:
            if some := [one for one in plain if (one["shape"], one["edge"]) == (shape, edge)]:
                force = np.mean([abs(one["error"][PRESS - 1]) for one in some])
                pressure, seconds = (
                    np.mean(values)
                    for values in zip(*((one["pressure"][PRESS - 1], one["seconds"]) for one in some), strict=True)
                )
                print(f"{shape:12} {edge:4g} {len(some):3} {force:7.2%} {pressure:7.1%} {seconds:7.2f}")
    fitted = [
        Powers.of(group)
        for n in sorted({one["scene"] for one in plain})
        if len(group := [one for one in plain if one["scene"] == n]) > 2
    ]
    known = np.array([(1, np.log(one["edge"]), np.log(_width(one))) for one in plain])
    size = np.log([abs(one["error"][PRESS - 1]) + LEAST for one in plain])
    law, *_ = np.linalg.lstsq(known, size, rcond=None)
    scatter = float((size - known @ law).std())
    powers = f"{np.exp(law[0]):.3f} edge^{law[1]:.2f} width^{law[2]:.2f}"
    print(f"error = {powers} [mm], within a factor of {np.exp(scatter):.1f}")
    width = np.array([one.width for one in fitted])
    target = np.mean([one.error(BASE) for one in fitted])
    print(f"{len(fitted)} scenes with edges of {BASE:g} mm: mean error {target:.2%}")
    for power in (0.0, 0.18, 0.3, 0.5, 1.0):
        low, high = 0.01, 10.0
        for _ in range(50):
            scale = np.sqrt(low * high)
            edges = np.clip(scale * width**power, LADDER[-1], LADDER[0])
            found = np.mean([one.error(edge) for one, edge in zip(fitted, edges, strict=True)])
            low, high = (low, scale) if found > target else (scale, high)
        cost = np.mean([one.seconds(edge) for one, edge in zip(fitted, edges, strict=True)])
        worst = max(one.error(edge) for one, edge in zip(fitted, edges, strict=True))
        told = f"{edges.min():.2f} to {edges.max():.2f} mm, {cost:.3f} s a frame, worst {worst:.1%}"
        print(f"edge ~ width^{power:g}, the same mean error: {told}")


def _width(line: dict[str, Any]) -> float:
    area, perimeter = line["sizes"][PRESS - 1]
    return float(2 * area / perimeter)


@dataclass(frozen=True)
class Powers:
    """Power laws in the edge, fitted to one scene: slope and value at 1 mm, logarithmic."""

    width: float
    of_error: tuple[float, float]
    of_seconds: tuple[float, float]

    @classmethod
    def of(cls, group: list[dict[str, Any]]) -> "Powers":
        edge = np.log([one["edge"] for one in group])
        error = np.log([abs(one["error"][PRESS - 1]) + LEAST for one in group])
        both = (tuple(np.polyfit(edge, values, 1)) for values in (error, np.log([one["seconds"] for one in group])))
        return cls(_width(group[0]), *both)

    def error(self, edge: float) -> float:
        return float(np.exp(np.polyval(self.of_error, np.log(edge))))

    def seconds(self, edge: float) -> float:
        return float(np.exp(np.polyval(self.of_seconds, np.log(edge))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("measure", "fit"))
    parser.add_argument("file", nargs="+", type=Path)
    parser.add_argument("--scenes", type=int, default=60)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=500)
    asked = parser.parse_args()
    if asked.what == "measure":
        measure(asked.file[0], range(asked.first, asked.first + asked.scenes), asked.seconds)
    else:
        fit(asked.file)


if __name__ == "__main__":
    main()
