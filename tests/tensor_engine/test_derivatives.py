"""Derivatives of labels on a core from the batch engine's solution, through the file in which workers get it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.needs import needs

torch = needs("torch")

from helpers.presses import poses, scene

from tacgen.batch import solution_file
from tacgen.geometry.analytic_sdf import CylinderSdf, SphereSdf
from tacgen.mechanics import Problem, mesh, states
from tacgen.mechanics.scene import Scene
from tacgen.mechanics.sensitivity import Parameter, Sensitivity, Slopes
from tacgen.mechanics.solved_scene import SolvedScene
from tacgen.mechanics.state import State
from tacgen.tensor_engine import pool

torch.set_num_threads(1)
MOVES = poses([(0, 0, 0.1), (0, 0, -0.3), (0.3, 0.1, -0.3), (1.6, 0.1, -0.35), (0, 0, 0.2)])
SCENES = [
    replace(scene(shape, MOVES, friction=friction, edge=1.0), differentiable=True)
    for shape, friction in ((SphereSdf(2.5), 0.5), (CylinderSdf(1.6, 0.2), 0.8), (SphereSdf(2.0), 0.0))
]


def derivatives(made: Scene, found: list[State] | None) -> tuple[list[State], list[Slopes]]:
    """By friction, depth and the bulk modulus, of the frames of another engine, or of those of this one."""
    problem = Problem.of(made, mesh.of(made))
    laws = [part.law for part in problem.elastic]
    stiffer = Parameter(1.0, lambda by: tuple(replace(law, kappa=law.kappa * (1 + by)) for law in laws))
    inputs = [Parameter(problem.contact.dhat, depth=1.0), stiffer, Parameter(1.0, friction=1.0)]
    path = Sensitivity(problem, inputs if made.friction else inputs[:2])
    frames, slopes = [], []
    for state in states(made, problem) if found is None else found:
        frames.append(state)
        slopes.append(path.frame(state))
    return frames, slopes


@pytest.mark.parametrize("number", range(len(SCENES)))
def test_derivatives_are_those_of_the_cpu_engines_frames(number: int, tmp_path: Path) -> None:
    made = SCENES[number]
    ((_, solved),) = pool.solved([made], dtype=torch.float64, share=False)
    assert solved.why is None
    solution_file.write(tmp_path / "one.npz", SolvedScene("one", solved.states), histories=True)
    known = solution_file.read(tmp_path / "one.npz")
    assert known is not None
    (frames, wanted), (_, found) = derivatives(made, None), derivatives(made, list(known.states))
    assert max(state.substeps for state in frames) > 1
    scale = max(np.abs(each.force.sum((1, 2))).max() for each in wanted)
    for one, each in zip(wanted, found, strict=True):
        assert each.force.sum((1, 2)) == pytest.approx(one.force.sum((1, 2)), abs=1e-6 * scale)
        assert each.x == pytest.approx(one.x, abs=1e-6 * max(np.abs(one.x).max(), 1.0))


def test_single_precision_of_factors_changes_them_little() -> None:
    made = SCENES[0]
    ((_, solved),) = pool.solved([made], share=False)
    (_, wanted), (_, found) = derivatives(made, None), derivatives(made, solved.states)
    forces = [np.array([each.force.sum((1, 2)) for each in some]) for some in (wanted, found)]
    assert forces[1] == pytest.approx(forces[0], abs=1e-3 * np.abs(forces[0]).max())
