"""Turned scenes and twisted bars: nature knows no direction, and large turns bring no element inside out."""

from dataclasses import replace

import numpy as np
import pytest

from tacgen import solve
from tacgen.bench import shorter
from tacgen.bench.cases import CASES
from tacgen.fem.assembly import pattern
from tacgen.fem.elements import hexes
from tacgen.fem.linear import best
from tacgen.fem.materials import NeoHooke
from tacgen.fem.newton import Status, minimise
from tacgen.fem.potentials import Elastic
from tacgen.fem.shapes import Box, Shape, Sphere
from tacgen.step import travel

from .blocks import block
from .presses import Run, poses, run, scene

Array = np.ndarray
SQUARE = (-3.0, 3.0, -3.0, 3.0)
PATH = [(0.4 + 0.1 * k, -0.3, -0.3 - 0.025 * k) for k in range(5)]


def slid(path: list[tuple[float, float, float]], shape: Shape) -> Run:
    return run(scene(shape, poses(path), friction=0.5, edge=0.8), SQUARE)


def about_z(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def test_a_frame_that_takes_edges_too_fast_is_split(monkeypatch: pytest.MonkeyPatch) -> None:
    """A box slid by nearly half a cell at once, split until little comes round an edge at once, is .2 to .4 % of its
    force off frames of .022 mm (five such slides), and .2 to .9 % unsplit: 11 to 20 % before steps began from the gel
    gone along with the indenter. A ball pays for one step."""
    ends, box = [PATH[0], (PATH[0][0] + 0.36, *PATH[-1][1:])], Box(3.0, 1.6, 0.3)
    steps = [tuple(ends[0] + t * np.subtract(ends[1], ends[0])) for t in np.linspace(0, 1, 17)]
    split, true = slid(ends, box), slid(steps, box).forces[-1]
    first, second = (state.substeps for state in split.states)
    assert first == 1
    assert second >= 3
    ball = slid(ends, Sphere(4.0))
    assert {state.substeps for state in ball.states} == {1}
    monkeypatch.setattr(travel, "FINER", 0)
    whole = slid(ends, box)
    assert whole.states[-1].substeps == 1
    assert whole.states[-1].rounded > travel.ROUNDED
    off = [np.linalg.norm(run.forces[-1] - true) / np.linalg.norm(true) for run in (split, whole)]
    assert off[0] < 0.01
    assert off[1] < 0.02


def test_a_sharp_edge_is_wrong_where_it_is_not_split(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wedge of .1 mm on cells of .8 mm: .3 % of its force off frames a quarter as long, and 46 % unsplit."""
    split, true, *_ = shorter.error(CASES["sharp wedge"])
    monkeypatch.setattr(travel, "FINER", 0)
    whole = shorter.error(CASES["sharp wedge"])[0]
    size = np.linalg.norm(true, axis=1).max()
    assert np.linalg.norm(split - true, axis=1).max() < 0.01 * size
    assert np.linalg.norm(whole - true, axis=1).min() > 0.2 * size


@pytest.mark.parametrize(("angle", "tol"), [(30, 1e-4), pytest.param(90, 1e-5, marks=pytest.mark.slow)])
def test_a_scene_turned_as_a_whole_gives_the_turned_force(angle: float, tol: float) -> None:
    """Gel, mesh and path: nothing in the solver prefers an axis. By 90 deg the numbers are the same but for the order
    of sums, which a frame stopped at its tolerance carries on to 3e-6 of the force; by 30 deg rounding leads to
    another last iteration, which shows by 4e-5."""
    R = about_z(np.radians(angle))
    one = slid(PATH, Box(3.0, 1.6, 0.3))
    H = np.eye(4)
    H[:3, :3] = R
    made = replace(one.scene, poses=H @ one.scene.poses, start=H @ one.scene.start)
    grid = replace(one.problem.mesh, points=one.problem.mesh.points @ R.T)
    problem = solve.Problem.of(made, grid)
    two = Run(made, problem, list(solve.states(made, problem)))
    assert one.forces[-1, 0] > 0.1 * np.abs(one.forces).max()  # the slide is seen
    assert two.forces == pytest.approx(one.forces @ R.T, abs=tol * np.abs(one.forces).max())


def test_an_indenter_turned_over_its_grid_feels_little_of_it() -> None:
    def force(yaw: float) -> float:
        made = scene(Box(3.0, 3.0, 0.6), poses([(0, 0, -0.5)], yaw=np.radians(yaw)), edge=0.3)
        return float(-run(made, SQUARE).forces[-1, 2])

    assert force(30) == pytest.approx(force(0), rel=0.01)
    assert force(90) == pytest.approx(force(0), rel=1e-6)


def test_a_bar_twisted_once_around() -> None:
    """1 x 1 x 6, ends held and turned against each other: no inversion, energy rising, Saint-Venant to begin with."""
    side, length, law, turns = np.linspace(-0.5, 0.5, 7), 6.0, NeoHooke(0.05, 2.5), 24
    grid = block(side, side, np.linspace(-length, 0, 25))
    X = grid.points
    ends = np.isclose(X[:, 2], 0) | np.isclose(X[:, 2], -length)
    pat = pattern([grid.cells], np.repeat(~ends[:, None], 3, 1))
    body, solver = Elastic.on(pat, hexes(X, grid.cells), law), best(pat)
    x, energies, torques = X, [0.0], []
    for _ in range(turns):
        step = 2 * np.pi / turns * (X[:, 2] + length) / length  # each section on by its share
        c, s = np.cos(step), np.sin(step)
        start = np.column_stack([c * x[:, 0] - s * x[:, 1], s * x[:, 0] + c * x[:, 1], x[:, 2]])
        found = minimise(body, start, pat, solver, xtol=1e-6)
        assert found.status is Status.converged
        x = found.x
        assert body.at(x).J.min() > 0.5
        energies.append(body.value(x))
        top = np.isclose(X[:, 2], 0)
        torques.append(float(np.cross(x[top], body.gradient(x)[top])[:, 2].sum()))
    assert (np.diff(energies) > 0).all()
    linear = 0.1406 * law.mu * (2 * np.pi / turns) / length
    assert torques[0] == pytest.approx(linear, rel=0.12)  # the held ends cannot warp: a bar as long as 6 is 8 % stiffer
    work = np.trapezoid([0, *torques], dx=2 * np.pi / turns)
    assert energies[-1] == pytest.approx(work, rel=0.01)  # energy is the work of the torque
