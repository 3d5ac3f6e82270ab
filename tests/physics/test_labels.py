"""The labels against closed forms and against themselves: what a mechanician would ask of them."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import small_recipe
from helpers.presses import Run, gel, poses, run, scene
from scipy.spatial import cKDTree

from tacgen import mechanics
from tacgen.fem.materials import NeoHooke
from tacgen.geometry.analytic_sdf import SphereSdf
from tacgen.geometry.gel import GelBody, GelLayer
from tacgen.mechanics import mesh
from tacgen.mechanics.scene import Scene
from tacgen.optics.camera import PinholeCamera, Stack
from tacgen.outputs.cauchy_stress import Stresses
from tacgen.outputs.contact_maps import maps
from tacgen.recipe import scene_of_row

Array = np.ndarray
pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

FRICTION = 0.6


@pytest.mark.parametrize(("sensor", "depth"), [("gelsight_mini", 1.0), ("digit", 0.8), ("ninedtact", 0.8)])
def test_forces_stress_and_maps_agree_on_every_sensor(sensor: str, depth: float) -> None:
    """At default quality: the map sums to the force, sigma n is within 3 % of it, and Coulomb's law holds per pixel."""
    moves = f"press: {{depth_mm: {depth}, frames: 1}}, slide: {{x_mm: 1.2, y_mm: 0.3, frames: 3}}"
    moves += ", twist: {angle_deg: 12, frames: 1}"
    row = small_recipe.row(moves, f"sensor={sensor}", f"contact.friction={FRICTION}", "quality=default")
    solved = run(scene_of_row.build(row))
    camera, stresses = PinholeCamera.from_sensor(row.sensor), Stresses(solved.problem)
    slid = []
    for state, force in zip(solved.states, solved.forces, strict=True):
        found = maps(solved.problem, solved.face.moved(state.x), state, camera)
        assert np.linalg.norm(found.force.sum((0, 1)) - force) < 1e-6 * np.linalg.norm(force)
        quality = stresses.quality(stresses.at(state.x), state)
        assert quality["force_error"] < 0.03
        assert quality["traction_error"] < 0.25
        assert quality["pressure_oscillation"] < 0.2
        size, limit = np.linalg.norm(found.traction, axis=-1), FRICTION * found.pressure
        slack = 1e-3 * limit.max()
        assert (size <= limit + slack).all()
        full = (found.sliding > 1 - 1e-9) & (found.pressure > 0)
        assert np.abs(size - limit)[full].max(initial=0.0) <= slack
        short = (limit - size)[found.slip] / limit.max()  # as docs/BUNDLE.md says of slip
        assert short.max(initial=0.0) < 0.35
        assert not short.size or np.quantile(short, 0.95) < 0.25
        slid.append(found.slip.sum() / found.contact.sum())
    assert slid[0] < 0.4 < 0.6 < slid[3]


def quarter_solved(made: Scene, half: float) -> tuple[mechanics.Problem, Array, float]:
    """A press that is even about x = 0 and y = 0, solved on a quarter: the whole mesh, positions on it, and Fz."""
    whole = mesh.build(made.gel, (-half, half, -half, half), made.edge)
    points = whole.points
    inside = (points[whole.cells].mean(1)[:, :2] > 0).all(1)
    used, cells = np.unique(whole.cells[inside], return_inverse=True)
    number = np.full(len(points), -1)
    number[used] = np.arange(len(used))
    facets = {name: number[f][(number[f] >= 0).all(1)] for name, f in whole.facets.items()}
    part = mesh.GelMesh(points[used], cells.reshape(-1, 8), whole.layer[inside], facets)
    held = np.abs(part.points) <= 1e-9
    held[:, 2] = False
    held[np.unique(facets["bonded"])] = True
    state = list(mechanics.states(made, mechanics.Problem.of(made, part, held=held)))[-1]
    _, near = cKDTree(part.points).query(np.abs(points) * [1, 1, -1])
    x = points + (state.x - part.points)[near] * np.where(points < 0, -1, 1) * [1, 1, 0]
    x[:, 2] = state.x[near, 2]
    return mechanics.Problem.of(made, whole), x, 4 * float(state.traction_force[..., 2].sum())


@pytest.mark.parametrize("nu", [0.3, 0.48])
def test_stress_under_a_ball_is_that_of_hertz(nu: float) -> None:
    """On the axis of a half-space; Johnson (1985), "Contact Mechanics", Eq. 3.45.

    Radius and pressure follow from the force, by Hertz as well: a block this deep is some percent stiffer than a
    half-space, which hardly changes how a force spreads below it.
    """
    radius, depth, E = 64.0, 0.16, 0.15  # a/R = .05: strains, and what is not linear in them, go with it
    pad = gel(64.0, 64.0, 32.0, E=E, nu=nu)
    made = replace(scene(SphereSdf(radius), poses([(0.0, 0.0, -depth)]), pad=pad, edge=0.26), dhat=0.01)
    problem, x, force = quarter_solved(made, 3.84)
    plane = E / (1 - nu**2)
    a = (3 * -force * radius / (4 * plane)) ** (1 / 3)
    peak = 3 * -force / (2 * np.pi * a**2)
    assert a == pytest.approx(np.sqrt(radius * depth), rel=0.05)
    below = np.flatnonzero(np.hypot(*problem.mesh.points[:, :2].T) < 1e-6)
    below = below[problem.mesh.points[below, 2].argsort()[::-1]]
    stress, z = Stresses(problem).at(x).node[below], (x[below[0], 2] - x[below, 2]) / a
    zz = -peak / (1 + z**2)
    rr = -peak * ((1 + nu) * (1 - z * np.arctan2(1, z)) - 0.5 / (1 + z**2))
    near = z <= 1.0
    assert near.sum() >= 8
    assert np.abs(stress[near, 2] - zz[near]).max() < 0.03 * peak
    assert np.abs(stress[near, 0] - rr[near]).max() < 0.06 * peak
    assert stress[near, 1] == pytest.approx(stress[near, 0], abs=1e-3 * peak)
    fine = np.linspace(0.05, 1.5, 300)
    shear = np.abs(np.interp(fine, z, stress[:, 2]) - np.interp(fine, z, stress[:, 0])) / 2
    exact = np.abs(-1 / (1 + fine**2) + (1 + nu) * (1 - fine * np.arctan(1 / fine)) - 0.5 / (1 + fine**2)) / 2
    where = [_top(fine, value) for value in (shear, exact)]
    assert where[0] == pytest.approx(where[1], rel=0.1)
    assert shear.max() == pytest.approx(exact.max() * peak, rel=0.05)


def _top(x: Array, y: Array) -> float:
    """Where a curve known at few points is highest: the middle of what lies above 97 % of it."""
    high = x[y > 0.97 * y.max()]
    return float((high[0] + high[-1]) / 2)


def layered(thicknesses: tuple[float, ...], moduli: tuple[float, ...], nu: float = 0.48) -> GelBody:
    laws = [NeoHooke(E / (2 * (1 + nu)), E / (3 * (1 - 2 * nu))) for E in moduli]
    layers = tuple(GelLayer(t, law, E) for t, law, E in zip(thicknesses, laws, moduli, strict=True))
    return GelBody(9.0, 9.0, layers=layers)


@pytest.mark.parametrize("pad", [layered((1.0,), (0.15,)), layered((1.0, 0.4), (0.1, 0.3))], ids=["thin", "two layers"])
def test_stress_in_layers_is_that_of_a_finer_mesh(pad: GelBody) -> None:
    """Below the contact, at half the edge: all components along columns of nodes that both meshes have."""
    found = []
    for edge, dhat in ((0.2, 0.015), (0.1, 0.01)):
        made = replace(scene(SphereSdf(4.0), poses([(0.0, 0.0, -0.25)]), pad=pad, edge=edge), dhat=dhat)
        found.append(run(made, (-1.6, 1.6, -1.6, 1.6)))
    coarse, fine = found
    assert coarse.forces[-1, 2] == pytest.approx(fine.forces[-1, 2], rel=0.02)
    peak, worst, total = -Stresses(fine.problem).at(fine.states[-1].x).node[:, 2].min(), [], []
    for layer in range(len(pad.layers)):
        for x in (0.0, 0.4, 0.8):
            (z, mine), (other, theirs) = (_column(run_, x, layer) for run_ in found)
            expected = np.stack([np.interp(z, other, theirs[:, c]) for c in range(6)], 1)
            worst.append(np.abs(mine - expected).max() / peak)
            total.append(np.sqrt(np.mean((mine - expected) ** 2)) / peak)
    assert max(worst) < 0.15, worst
    assert max(total) < 0.06, total


def _column(found: Run, x: float, layer: int) -> tuple[Array, Array]:
    """Rest heights of the nodes at (x, 0) of a layer, rising, and their stress there."""
    made = Stresses(found.problem)
    rows = made.at(found.states[-1].x).rows
    points = found.problem.mesh.points[made.recovery.node]
    here = np.flatnonzero((np.hypot(points[:, 0] - x, points[:, 1]) < 1e-6) & (made.recovery.material == layer))
    here = here[points[here, 2].argsort()]
    return points[here, 2], rows[here]


def test_the_stick_disc_shrinks_as_cattaneo_and_mindlin_say(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pulled sideways, a ball sticks within c = a (1 - Q/(friction P))^(1/3) until all slides; Johnson (1985), 7.2.

    A point slides when it is 10 um from its anchor (options.slip of dhat): little beside a pull of .3 mm and more.
    """
    made = scene(
        SphereSdf(64.0), poses([(x, 0.0, -1.0) for x in (0.0, 0.32, 0.56, 1.2)]),
        pad=gel(128.0, 128.0, 64.0, nu=0.49), friction=0.5, edge=1.2,
    )  # fmt: skip
    made = replace(made, dhat=0.08)
    monkeypatch.setattr(mesh, "MAX_HEX_EDGE_RATIO", 16.0 / made.edge)
    grid = mesh.build(made.gel, (-9.6, 10.8, -9.6, 9.6), made.edge)
    found = run(made, grid=grid)
    stack = Stack((800.0, 64.0), (1.0, 1.41))
    camera = PinholeCamera(stack, (0.0, 0.0), stack.effective_depth / 0.2, (120, 120))
    discs = []
    for state, force in zip(found.states[1:], found.forces[1:], strict=True):
        seen = maps(found.problem, found.face.moved(state.x), state, camera)
        a = np.sqrt((seen.area * seen.contact).sum() / np.pi)
        stuck = np.sqrt((seen.area * (seen.contact & ~seen.slip)).sum() / np.pi)
        discs.append((stuck / a, max(0.0, 1 + force[0] / (0.5 * force[2])) ** (1 / 3)))
    stick, theory = np.array(discs).T
    assert theory[0] > 0.75
    assert theory[1] < 0.7
    assert stick[:2] == pytest.approx(theory[:2], abs=0.04)
    assert (np.diff(stick) < 0).all()
    assert stick[-1] == 0.0
