"""tacgen itself, at its three qualities."""

import resource
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import tacgen
from benchmarks.referee.case import PAD, Case, dots, spread
from benchmarks.referee.player import Answer, NotPlayed
from benchmarks.reference_runs import forces_of, row_of, solve_frames
from tacgen.base.version import __version__
from tacgen.mechanics import Problem, mesh, presolve
from tacgen.outputs import gel_surface
from tacgen.recipe import scene_of_row

Array = np.ndarray


@dataclass(frozen=True)
class Tacgen:
    """tacgen with changes to the recipe, and the quality of each setting."""

    name: str
    qualities: dict[str, str]
    sets: tuple[str, ...] = ()

    @property
    def settings(self) -> tuple[str, ...]:
        return tuple(self.qualities)

    def available(self) -> str | None:
        return None

    def version(self) -> str:
        return f"tacgen {__version__}"

    def play(self, case: Case, setting: str) -> Answer:
        sets = ("outputs=[force]", *self.sets, f"quality={self.qualities[setting]}")
        return self._grasp(case, sets) if case.mass_kg else self._follow(case, sets)

    def _follow(self, case: Case, sets: Sequence[str]) -> Answer:
        start = time.process_time()
        made = presolve.presolved(scene_of_row.build(row_of((*case.recipe, *sets))))
        problem = Problem.of(made, mesh.of(made))
        solved = solve_frames(made, problem)
        seconds = (time.process_time() - start) / len(case.poses)
        if solved.status != "ok":
            raise NotPlayed(solved.reason)
        states = [solved.states[k] for k in case.judged]
        face = gel_surface.GelSurface(problem.mesh.points, problem.mesh.facets["coated"])
        moved = np.array([face.moved(state.x).at(dots())[:, :2] - dots() for state in states])
        points = [problem.contact.faces.at(state.x).reshape(-1, 3) for state in states]
        maps = [spread(at, s.traction_force.reshape(-1, 3)) for at, s in zip(points, states, strict=True)]
        torque = np.array([gel_surface.wrench(problem, state)[1] for state in states])
        told = {"quality": sets[-1].partition("=")[2], "edge_mm": made.edge, "nodes": len(problem.mesh.points)}
        pressure, traction = (np.array(part) for part in zip(*maps, strict=True))
        return Answer(forces_of(states), torque, seconds, told, pressure, traction, moved)

    def _grasp(self, case: Case, sets: Sequence[str]) -> Answer:
        """A recipe's grasp, whose world is upside down in the sensor's frame."""
        width = case.mesh().extents[2]
        closed = [f"{{close: {{width_mm: {width + 2 * pose.z:g}, frames: 1}}}}" for pose in case.poses[:-1]]
        path = [*closed, "{lift: {height_mm: 1, frames: 1}}"]
        with tempfile.TemporaryDirectory() as folder:
            turned = case.mesh()
            turned.apply_transform([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # closes along x
            turned.export(Path(folder, "held.stl"))
            held = f"indenter={{shape: mesh, file: {folder}/held.stl}}"
            grasp = f"grasp={{mass_kg: {case.mass_kg:g}}}"
            moves = (f"trajectory=[{', '.join(path)}]", f"contact.friction={case.friction:g}")
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            done = tacgen.run("quickstart", Path(folder, "out"), sets=(*PAD, held, grasp, *moves, *sets))
            if any(result.status != "ok" for result in done):
                raise NotPlayed(done[0].reason)
            left, right = (frames.force for frames in tacgen.read_all(Path(folder, "out")))
            seconds = resource.getrusage(resource.RUSAGE_CHILDREN)
        force = (left * (-1, -1, 1) + right * (1, -1, -1))[list(case.judged)]
        spent = seconds.ru_utime + seconds.ru_stime - before.ru_utime - before.ru_stime
        return Answer(force, np.zeros_like(force), spent / len(case.poses), {"quality": sets[-1].partition("=")[2]})


PLAYERS = (Tacgen("tacgen", {name: name for name in ("default", "draft", "reference")}),)
