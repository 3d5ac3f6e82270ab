"""Turned scenes and twisted bars: nature knows no direction, and large turns bring no element inside out."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.blocks import block
from helpers.minimiser import minimise
from helpers.presses import Run, poses, run, scene

from benchmarks import step_size_error
from benchmarks.cases import CASES, PLAIN
from benchmarks.reference_runs import row_of
from tacgen import mechanics
from tacgen.fem.assembly import pattern
from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import elements
from tacgen.fem.materials import NeoHooke
from tacgen.geometry.analytic_sdf import BoxSdf, Shape, SphereSdf
from tacgen.mechanics import DEFAULT_OPTIONS, SolverOptions, mesh
from tacgen.mechanics.scene import Scene
from tacgen.recipe import scene_of_row

Array = np.ndarray
SQUARE = (-3.0, 3.0, -3.0, 3.0)
EDGE = 0.8
WHOLE = replace(DEFAULT_OPTIONS, slide=np.inf, slide_sharp=np.inf, fold_halvings=0, fold_tol=2e-4, fold_max=2e-4)
PATH = [(0.4 + 0.1 * k, -0.3, -0.3 - 0.025 * k) for k in range(5)]


def slid(path: list[tuple[float, float, float]], shape: Shape, options: SolverOptions = DEFAULT_OPTIONS) -> Run:
    made = scene(shape, poses(path), friction=0.5, edge=EDGE)
    problem = mechanics.Problem.of(made, mesh.build(made.gel, SQUARE, made.edge), options)
    return Run(made, problem, list(mechanics.states(made, problem)))


def about_z(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


@pytest.mark.parametrize(
    ("shape", "longest", "tol"),
    [
        (BoxSdf(3.0, 1.6, 0.3), "slide_sharp", 1e-2),
        pytest.param(SphereSdf(4.0), "slide", 2e-3, marks=pytest.mark.slow),
    ],
)
def test_a_long_frame_goes_in_load_steps_that_friction_can_follow(shape: Shape, longest: str, tol: float) -> None:
    """Slid by more than a cell at once, against frames of .06 of a cell. A box in steps of at most half a cell is .6 %
    of its force off, in steps a quarter as long .2 %, and 2 % at once: its edge comes round a fifth of what friction
    bears. A ball is .1 % off, in steps as long as one likes."""
    start, end = PATH[0], (PATH[0][0] + 0.9, *PATH[-1][1:])
    frames = [tuple(start + t * np.subtract(end, start)) for t in np.linspace(0, 1, 19)]
    true = slid(frames, shape).forces[-1]

    def off(found: Run) -> float:
        return float(np.linalg.norm(found.forces[-1] - true) / np.linalg.norm(true))

    long, short = (
        slid([start, end], shape, options) for options in (DEFAULT_OPTIONS, mechanics.short_steps(DEFAULT_OPTIONS, 4))
    )
    assert [state.substeps for state in long.states] == [1, np.ceil(0.9 / (getattr(DEFAULT_OPTIONS, longest) * EDGE))]
    assert off(long) < tol
    assert off(short) < tol / 2
    whole = slid([start, end], shape, WHOLE)
    assert whole.states[-1].substeps == 1
    assert off(whole) < 3 * tol
    assert (whole.states[-1].rounded > 0.1) == (longest == "slide_sharp")


@pytest.mark.slow
def test_a_sharp_edge_in_long_frames_is_right() -> None:
    """A wedge of .1 mm on cells of .8 mm: .1 % of its force off frames a quarter as long, whether frames are load steps
    or several; 46 % with lagged friction."""
    made = scene_of_row.build(row_of((*PLAIN, *CASES["sharp wedge"])))

    def forces(made: Scene, options: SolverOptions = DEFAULT_OPTIONS) -> Array:
        found = mechanics.states(made, mechanics.Problem.of(made, mesh.of(made), options))
        return np.array([state.traction_force.sum((0, 1)) for state in found])

    true = forces(step_size_error.finer(made, 4))[3::4]
    size = np.linalg.norm(true, axis=1).max()
    for options in (DEFAULT_OPTIONS, WHOLE):
        assert np.linalg.norm(forces(made, options) - true, axis=1).max() < 5e-3 * size


@pytest.mark.parametrize(("angle", "tol"), [(30, 1e-4), pytest.param(90, 1e-5, marks=pytest.mark.slow)])
def test_a_scene_turned_as_a_whole_gives_the_turned_force(angle: float, tol: float) -> None:
    """Gel, mesh and path: nothing in the solver prefers an axis. By 90 deg the numbers are the same but for the order
    of sums, which a frame stopped at its tolerance carries on to 3e-6 of the force; by 30 deg rounding leads to
    another last iteration, which shows by 4e-5."""
    R = about_z(np.radians(angle))
    one = slid(PATH, BoxSdf(3.0, 1.6, 0.3))
    H = np.eye(4)
    H[:3, :3] = R
    made = replace(one.scene, poses=H @ one.scene.poses, start=H @ one.scene.start)
    grid = replace(one.problem.mesh, points=one.problem.mesh.points @ R.T)
    problem = mechanics.Problem.of(made, grid)
    two = Run(made, problem, list(mechanics.states(made, problem)))
    assert one.forces[-1, 0] > 0.1 * np.abs(one.forces).max()  # the slide is seen
    assert two.forces == pytest.approx(one.forces @ R.T, abs=tol * np.abs(one.forces).max())


@pytest.mark.slow
def test_an_indenter_turned_over_its_grid_feels_little_of_it() -> None:
    def force(yaw: float) -> float:
        path = poses([(0, 0, -0.125 * k) for k in range(1, 5)], yaw=np.radians(yaw))
        made = scene(BoxSdf(3.0, 3.0, 0.6), path, edge=0.3)
        return float(-run(made, SQUARE).forces[-1, 2])

    assert force(30) == pytest.approx(force(0), rel=0.01)
    assert force(90) == pytest.approx(force(0), rel=1e-6)


@pytest.mark.slow
def test_a_bar_twisted_once_around() -> None:
    """1 x 1 x 6, ends held and turned against each other: no inversion, energy rising, Saint-Venant to begin with."""
    side, length, law, turns = np.linspace(-0.5, 0.5, 7), 6.0, NeoHooke(0.05, 2.5), 24
    grid = block(side, side, np.linspace(-length, 0, 25))
    X = grid.points
    ends = np.isclose(X[:, 2], 0) | np.isclose(X[:, 2], -length)
    pat = pattern([grid.cells], np.repeat(~ends[:, None], 3, 1))
    body = Elastic.on(pat, elements(X, grid.cells), law)
    x, energies, torques = X, [0.0], []
    for _ in range(turns):
        step = 2 * np.pi / turns * (X[:, 2] + length) / length  # each section on by its share
        c, s = np.cos(step), np.sin(step)
        start = np.column_stack([c * x[:, 0] - s * x[:, 1], s * x[:, 0] + c * x[:, 1], x[:, 2]])
        x = minimise(body, start, pat, xtol=1e-6)
        assert body.evaluate(x).J.min() > 0.5
        energies.append(body.value(x))
        top = np.isclose(X[:, 2], 0)
        torques.append(float(np.cross(x[top], body.gradient(x)[top])[:, 2].sum()))
    assert (np.diff(energies) > 0).all()
    linear = 0.1406 * law.mu * (2 * np.pi / turns) / length
    assert torques[0] == pytest.approx(linear, rel=0.12)  # the held ends cannot warp: a bar as long as 6 is 8 % stiffer
    work = np.trapezoid([0, *torques], dx=2 * np.pi / turns)
    assert energies[-1] == pytest.approx(work, rel=0.01)  # energy is the work of the torque
