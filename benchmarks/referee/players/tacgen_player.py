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
from tacgen.mechanics import Problem, mesh, presolve
from tacgen.outputs import gel_surface
from tacgen.recipe import scene_of_row


@dataclass(frozen=True)
class Tacgen:
    """tacgen with changes to the recipe, and the quality of each setting."""

    name: str
    qualities: dict[str, str]
    sets: tuple[str, ...] = ()

    @property
    def settings(self) -> tuple[str, ...]:
        return tuple(self.qualities)

    def available(self) -> None:
        """It runs here."""

    def version(self) -> str:
        return f"tacgen {tacgen.__version__}"

    def play(self, case: Case, setting: str) -> Answer:
        friction, quality = f"contact.friction={case.friction:g}", f"quality={self.qualities[setting]}"
        sets = ("outputs=[force]", friction, *self.sets, quality)
        return self._grasp(case, sets) if case.mass_kg else self._follow(case, sets)

    def _follow(self, case: Case, sets: Sequence[str]) -> Answer:
        start = time.process_time()
        made = presolve.presolved(scene_of_row.build(row_of((*case.recipe, *sets))))
        problem = Problem.of(made, mesh.of(made))
        solved, spent = solve_frames(made, problem), time.process_time() - start
        if solved.status != "ok":
            raise NotPlayed(solved.reason)
        states, faces = [solved.states[k] for k in case.judged], problem.contact.faces
        face = gel_surface.GelSurface(problem.mesh.points, problem.mesh.facets["coated"])
        moved = np.array([face.moved(state.x).at(dots())[:, :2] - dots() for state in states])
        maps = [spread(faces.at(s.x).reshape(-1, 3), s.traction_force.reshape(-1, 3)) for s in states]
        torque = np.array([gel_surface.wrench(problem, state)[1] for state in states])
        told = {"edge_mm": made.edge, "dhat_mm": made.dhat, "nodes": len(problem.mesh.points)}
        pressure, traction = (np.array(part) for part in zip(*maps, strict=True))
        return Answer(forces_of(states), torque, spent / len(case.poses), told, pressure, traction, moved)

    def _grasp(self, case: Case, sets: Sequence[str]) -> Answer:
        """A recipe's grasp, whose world is upside down in the sensor's frame."""
        turned, open_mm = case.mesh(), case.mesh().extents[2]
        turned.apply_transform(np.eye(4)[[2, 0, 1, 3]])  # closes along x
        moves = [f"{{close: {{width_mm: {open_mm + 2 * pose.z:g}, frames: 1}}}}, " for pose in case.poses[:-1]]
        with tempfile.TemporaryDirectory() as folder:
            turned.export(Path(folder, "held.stl"))
            held = (f"indenter={{shape: mesh, file: {folder}/held.stl}}", f"grasp={{mass_kg: {case.mass_kg:g}}}")
            path = f"trajectory=[{''.join(moves)}{{lift: {{height_mm: 1, frames: 1}}}}]"
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            done = tacgen.run("quickstart", Path(folder, "out"), sets=(*PAD, *held, path, *sets))
            spent = resource.getrusage(resource.RUSAGE_CHILDREN)
            if any(result.status != "ok" for result in done):
                raise NotPlayed(done[0].reason)
            left, right = (frames.force for frames in tacgen.read_all(Path(folder, "out")))
        force = (left * (-1, -1, 1) + right * (1, -1, -1))[list(case.judged)]
        seconds = (spent.ru_utime + spent.ru_stime - before.ru_utime - before.ru_stime) / len(case.poses)
        return Answer(force, np.zeros_like(force), seconds)


PLAYERS = (Tacgen("tacgen", {name: name for name in ("default", "draft", "reference")}),)
