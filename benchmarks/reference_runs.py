"""A scene's frames and labels and what they cost, and how far two such answers to the same scene are apart."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import fields as names_of
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tacgen import mechanics
from tacgen.base import array_cache
from tacgen.geometry.gel import GelBody
from tacgen.mechanics import mesh, presolve
from tacgen.mechanics.scene import Scene
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.coating import centers
from tacgen.outputs import contact_maps, gel_surface
from tacgen.outputs.cauchy_stress import Stresses
from tacgen.recipe import assets, plan, scene_of_row
from tacgen.recipe.row import Row
from tacgen.sensor.markers import GridMarkers

Array = np.ndarray
PACKAGE = Path(mechanics.__file__).parents[1]
USED = ("fem", "optics", "geometry", "mechanics", "recipe", "outputs")  # packages that an answer depends on
BALL = ("outputs=[force]", "indenter={shape: sphere, radius_mm: 4}")
DEPTHS = {"gelsight_mini": 1.0, "digit": 0.8, "ninedtact": 0.8}  # of the ball [mm]
MOVES = "trajectory=[{{press: {{depth_mm: {depth}, frames: 1}}}}, {{slide: {{x_mm: 0.6, frames: 2}}}}]"
DOTS = GridMarkers(columns=5, rows=5, pitch_mm=(1.8, 1.8), diameter_mm=1, albedo=0.1, source="made up, for all sensors")
BELOW = np.array([0.15, 0.3, 0.45, 0.6])  # where stress is compared: parts of the thickness below the face,
AROUND = np.arange(-3.0, 3.1, 0.6)  # and along x and y [mm]


def sliding(sensor: str) -> tuple[str, ...]:
    """A ball of 4 mm pressed in one frame and slid by 0.6 mm in two, with friction 0.5."""
    return (*BALL, f"sensor={sensor}", MOVES.format(depth=DEPTHS[sensor]), "contact.friction=0.5")


@dataclass(frozen=True)
class Answer:
    """force (frames, 3) on the gel [N]; of the last frame pressure (h, w) [MPa], stress (p, 6) [MPa] in the gel,
    markers (m, 2) [px] and the area in contact [mm^2]; and the work: processor seconds from the mesh to the first
    frame, all frames' seconds, Newton iterations.
    """

    force: Array
    pressure: Array
    stress: Array
    markers: Array
    area: float
    nodes: int
    setup: float
    seconds: float
    iterations: float

    def error(self, reference: "Answer") -> "Error":
        """Error of the labels against a reference."""
        size = np.linalg.norm(reference.force, axis=1)
        n = min(len(self.force), len(reference.force))
        return Error(
            float((np.linalg.norm(self.force[-n:] - reference.force[-n:], axis=1) / size[-n:]).max()),
            _norm(self.pressure - reference.pressure) / _norm(reference.pressure),
            _norm(self.stress - reference.stress) / _norm(reference.stress),
            float(np.sqrt(np.nanmean(((self.markers - reference.markers) ** 2).sum(1)))),
        )


@dataclass(frozen=True)
class Error:
    """force: of the vector, the worst frame; pressure, stress: L2 norms; all three as parts of the reference; markers:
    rms [px]."""

    force: float
    pressure: float
    stress: float
    markers: float


def _norm(values: Array) -> float:
    return float(np.linalg.norm(np.nan_to_num(values)))


def row_of(sets: tuple[str, ...]) -> Row:
    """The quickstart's scene with these changes."""
    return plan.load(assets.recipe_path("quickstart"), sets).rows[0]


class Frames(NamedTuple):
    """Frames solved one after the other, the processor seconds at the end of each and of the last try, and how that
    ended: `status` is ok, rejected or out of time, `reason` says why."""

    states: list[mechanics.State]
    ends: list[float]
    seconds: float
    status: str
    reason: str

    @property
    def forces(self) -> Array:
        """The forces of all frames (n, 3) [N]."""
        return forces_of(self.states)


def forces_of(states: Sequence[mechanics.State]) -> Array:
    """Force of the indenter on the gel in each frame (n, 3) [N]."""
    return np.reshape([state.traction_force.sum((0, 1)) for state in states], (-1, 3))


def solve_frames(made: Scene, problem: mechanics.Problem, limit: float = math.inf) -> Frames:
    """The frames of a scene, as many as are solved in about `limit` processor seconds."""
    states, ends, count, start = list[mechanics.State](), list[float](), len(made.poses), time.process_time()
    status, reason = "ok", ""
    try:
        for state in mechanics.states(made, problem):
            states.append(state)
            ends.append(time.process_time() - start)
            if ends[-1] > limit and len(states) < count:
                status, reason = "out of time", f"after frame {len(states)} of {count}"
                break
    except mechanics.NotConverged as error:
        status, reason = "rejected", f"frame {len(states) + 1} of {count}: {error}"
    return Frames(states, ends, time.process_time() - start, status, reason)


def answer(sets: tuple[str, ...], options: mechanics.SolverOptions = mechanics.DEFAULT_OPTIONS) -> Answer:
    """Solve the quickstart with changes and take its labels."""
    row = row_of(sets)
    made = presolve.presolved(scene_of_row.build(row))
    built = mesh.of(made)
    started = time.process_time()
    problem = mechanics.Problem.of(made, built, options)
    ready = time.process_time()
    states = list(mechanics.states(made, problem))
    seconds = time.process_time() - ready
    last, camera = states[-1], PinholeCamera.from_sensor(row.sensor)
    coated = gel_surface.GelSurface(problem.mesh.points, problem.mesh.facets["coated"])
    seen = gel_surface.seen(problem.mesh, len(row.sensor.gel.clear_layers))
    found = contact_maps.maps(problem, coated.moved(last.x), last, camera)
    dots = camera.project(seen.moved(last.x).at(centers(DOTS)))
    return Answer(
        forces_of(states),
        np.nan_to_num(found.pressure),
        _probed(made.gel, problem, last),
        dots,
        float(found.area[found.contact].sum()),
        len(problem.mesh.points),
        ready - started,
        seconds,
        float(sum(state.iterations for state in states)),
    )


def _probed(gel: GelBody, problem: mechanics.Problem, state: mechanics.State) -> Array:
    """Nodal stress (p, 6) [MPa], interpolated at points of the gel under the contact."""
    from scipy.interpolate import LinearNDInterpolator

    xy = np.stack(np.meshgrid(AROUND, AROUND), -1).reshape(-1, 2)
    xy = xy[gel.contains(*xy.T)]
    probes = np.concatenate([gel.at_height(1 - part, xy) for part in BELOW])
    points = problem.mesh.points
    near = (np.abs(points[:, :2]) < AROUND.max() + 3).all(1)
    return np.asarray(LinearNDInterpolator(points[near], Stresses(problem).at(state.x).node[near])(probes))


def source_files() -> list[Path]:
    """The files of code that decide an answer."""
    return [Path(__file__), *(path for name in USED for path in sorted((PACKAGE / name).glob("*.py")))]


def kept(sets: tuple[str, ...]) -> Answer:
    """`answer`, computed once and kept in the cache as long as the scene and `source_files` are the same."""
    key = array_cache.digest([row_of(sets).key, *(path.read_bytes() for path in source_files())])

    def make() -> tuple[Array, ...]:
        found = answer(sets)
        return tuple(np.asarray(getattr(found, part.name)) for part in names_of(Answer))

    values: list[Any] = [v if v.ndim else v.item() for v in array_cache.kept("bench", key, make)]
    return Answer(*values)
