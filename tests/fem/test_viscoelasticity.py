"""A Prony series on the isochoric stress: closed forms, limits, convergence in time, passivity and derivatives."""

import numpy as np
import pytest
from helpers.minimiser import minimise
from helpers.small import block, dense, slope, tetrahedral, turn, whole

from tacgen.fem.assembly import pattern
from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import elements
from tacgen.fem.materials import EXAMPLE_LAWS, Law, NeoHooke, Stiffened
from tacgen.fem.projection import Projection
from tacgen.fem.viscoelasticity import Viscoelastic

Array = np.ndarray
PRONY = ((0.3, 0.1), (0.2, 2.0))
BETA, TAU = np.array([0.6, 0.4]), np.array([0.1, 2.0])  # of half that is left at rest
NODES = pytest.mark.parametrize("nodes", [8, 10, 4])
ISOCHORIC = pytest.mark.parametrize("name", ["neo_hooke", "mooney_rivlin", "yeoh"])
AT_ONCE, FOR_EVER = 1e-9, 1e9  # [s]


def of(nodes: int, law: Law, n: int = 1) -> tuple[Viscoelastic, Array]:
    """A block of n x n x n hexes, or as many times six tets, of a gel that relaxes by half; its points."""
    points, cells = block(n, 0.1)
    if nodes != 8:
        points, cells = tetrahedral(points, cells, nodes)
    part = elements(points, cells)
    return Viscoelastic.of(Elastic.on(whole(cells, len(points)), part, law), PRONY), points


def away(points: Array, seed: int) -> Array:
    """Stretched, shaken and turned."""
    rng = np.random.default_rng(seed)
    stretched = points @ np.diag(rng.uniform(0.7, 1.4, 3)) + rng.uniform(-0.08, 0.08, points.shape)
    return np.asarray(stretched @ turn(seed).T)


@ISOCHORIC
@NODES
def test_derivatives_are_those_of_the_energy_far_from_rest(nodes: int, name: str) -> None:
    """And the forces at its end are those of the internal variables there."""
    viscous, points = of(nodes, EXAMPLE_LAWS[name])
    start, x = away(points, 1), away(points, 2)
    H = viscous.after(viscous.rest(), points, start, 0.05)
    step = viscous.step(H, start, 0.1)
    g = step.gradient(x)
    law = viscous.elastic.gradient(x)
    assert np.abs(g - law).max() > 0.2 * np.abs(law).max()
    assert g.ravel() == pytest.approx(slope(step.value, x, 1e-5), abs=1e-8 * np.abs(g).max())
    K = dense(step, x, whole(step.elements.conn, len(points)))
    assert pytest.approx(slope(lambda y: step.gradient(y).ravel(), x, 1e-5), abs=1e-7 * np.abs(K).max()) == K
    there = viscous.relaxing(viscous.after(H, start, x, 0.1))
    assert there.gradient(x) == pytest.approx(g, abs=1e-12 * np.abs(g).max())


@NODES
def test_the_tangent_is_projected_with_all_that_it_holds(nodes: int) -> None:
    """On tetrahedra of one point that is exact: the eigenvalues of dP/dF are clamped."""
    viscous, points = of(nodes, NeoHooke(0.05, 0.4))
    start = points @ np.diag([1.0, 1.0, 0.4])
    step = viscous.step(viscous.after(viscous.rest(), points, start, 1.0), start, 0.1)
    x = points @ np.diag([0.8, 0.9, 0.4])
    pat = whole(step.elements.conn, len(points))
    exact, clamped = dense(step, x, pat), dense(step, x, pat, Projection.FULL)
    size = np.abs(exact).max()
    assert np.linalg.eigvalsh(exact).min() < -1e-3 * size
    assert np.linalg.eigvalsh(clamped).min() > -1e-12 * size
    assert np.linalg.eigvalsh(clamped - exact).min() > -1e-12 * size  # only ever stiffer
    mild = points @ np.diag([1.01, 1.0, 0.99])
    assert (dense(step, mild, pat, Projection.STRAINED) == dense(step, mild, pat)).all()


@NODES
def test_a_block_held_in_shear_relaxes_as_in_closed_form(nodes: int) -> None:
    """P12 = mu k (1 + sum of beta exp(-t/tau)), whatever k."""
    viscous, points = of(nodes, NeoHooke(0.05, 250.0), 2)
    x, t = points + 0.5 * points[:, 2:] * [1.0, 0.0, 0.0], 0.0
    H = viscous.after(viscous.rest(), points, x, AT_ONCE)
    for h in (0.01, 0.1, 0.5, 3.0):
        force = viscous.step(H, x, h).gradient(x)[points[:, 2] == 1, 0].sum()
        H, t = viscous.after(H, x, x, h), t + h
        assert force == pytest.approx(0.05 * 0.5 * (1 + BETA @ np.exp(-t / TAU)), rel=1e-3)


@NODES
def test_a_block_held_squeezed_relaxes_as_in_closed_form(nodes: int) -> None:
    """Its sides free and its volume kept: P = mu (l - l^-2) (1 + sum of beta exp(-t/tau))."""
    viscous, points = of(nodes, NeoHooke(0.05, 250.0), 2)
    free = points > 0
    free[points[:, 2] == 1, 2] = False
    pat = pattern([viscous.elastic.elements.conn], free)
    viscous = Viscoelastic.of(Elastic.on(pat, viscous.elastic.elements, viscous.elastic.law), PRONY)
    H, x, t, squeezed = viscous.rest(), points, 0.0, 0.8
    for h in (AT_ONCE, 0.01, 0.1, 0.5, 3.0):
        step = viscous.step(H, x, h)
        found = minimise(step, points * [squeezed**-0.5, squeezed**-0.5, squeezed], pat, xtol=1e-8)
        force = step.gradient(found)[points[:, 2] == 1, 2].sum()
        H, x, t = viscous.after(H, x, found, h), found, t + h
        assert force == pytest.approx(0.05 * (squeezed - squeezed**-2) * (1 + BETA @ np.exp(-t / TAU)), rel=1e-3)


@ISOCHORIC
@NODES
def test_it_is_elastic_in_the_limits_of_fast_and_slow(nodes: int, name: str) -> None:
    """At once by a law with twice the shear modulus, after a long time by its own, whatever came between."""
    law = EXAMPLE_LAWS[name]
    viscous, points = of(nodes, law)
    H, x = viscous.rest(), points
    for seed in range(3):
        there = away(points, seed)
        fast = Elastic(viscous.elastic.elements, Stiffened(law, 2.0)).gradient(there)
        assert viscous.step(H, x, AT_ONCE).gradient(there) == pytest.approx(fast, abs=1e-6 * np.abs(fast).max())
        H, x = viscous.after(H, x, there, AT_ONCE), there
    slow = viscous.elastic.gradient(points)
    assert viscous.step(H, x, FOR_EVER).gradient(points) == pytest.approx(slow, abs=1e-8)
    H = viscous.after(H, x, away(points, 5), 1.0)
    assert np.abs(H).max() > 1e-3
    H = viscous.after(H, away(points, 5), away(points, 6), np.inf)
    assert np.abs(H).max() == 0


def path(t: Array) -> Array:
    """F (t, 3, 3) that stretches, shears and turns, none of them at an even pace."""
    F = np.tile(np.eye(3), (len(t), 1, 1))
    F[:, 0, 0], F[:, 0, 1], F[:, 2, 1], F[:, 2, 2] = 1 + 0.3 * t, 0.6 * t**2, -0.4 * np.sin(3 * t), 1 - 0.2 * t
    return F


def test_the_error_falls_with_the_square_of_the_step() -> None:
    """Against the convolution integral of a neo-Hookean gel, by many points."""
    mu, kappa = 0.05, 0.4
    viscous, points = of(4, NeoHooke(mu, kappa))
    t = np.linspace(0, 1, 20001)
    F = path(t)
    C = F.swapaxes(1, 2) @ F
    s = mu * (np.eye(3) - np.trace(C, axis1=1, axis2=2)[:, None, None] / 3 * np.linalg.inv(C))
    kernel = np.exp(-(1 - (t[1:] + t[:-1]) / 2)[:, None] / TAU) @ BETA
    T = s[-1] + (kernel[:, None, None] * np.diff(s, axis=0)).sum(0)
    J, inverse = np.linalg.det(F[-1]), np.linalg.inv(C[-1])
    S = J ** (-2 / 3) * (T - (T * C[-1]).sum() / 3 * inverse) + kappa / 2 * (J**2 - 1) * inverse
    exact = F[-1] @ S @ F[-1].T / J
    steps, errors = np.array([4, 8, 16]), []
    for n in steps:
        H, x = viscous.rest(), points
        for gradient in path(np.linspace(0, 1, n + 1))[1:]:
            H, x = viscous.after(H, x, points @ gradient.T, 1 / n), points @ gradient.T
        now = viscous.relaxing(H)
        errors.append(np.abs(now.cauchy(now.evaluate(x))[0] - exact).max() / np.abs(exact).max())
    assert -np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(2.0, abs=0.15), errors
    assert errors[-1] < 1e-3


@pytest.mark.parametrize("pace", [1e-3, 0.1, 1.0, 30.0])
@ISOCHORIC
def test_no_closed_cycle_gives_energy(name: str, pace: float) -> None:
    """From rest through states far apart, in steps of unequal length, and back."""
    viscous, points = of(8, EXAMPLE_LAWS[name])
    for seed in range(6):
        rng = np.random.default_rng(seed)
        H, x, work, most = viscous.rest(), points, 0.0, 0.0
        for k in (1, 2, 3, 4, None):
            there, h = points if k is None else away(points, 10 * seed + k), pace * rng.exponential()
            step = viscous.step(H, x, h)
            spent = step.value(there) - step.value(x)
            H, x, work, most = viscous.after(H, x, there, h), there, work + spent, max(most, abs(spent))
        assert work > 1e-4 * most


def test_rotating_the_gel_rotates_the_forces() -> None:
    viscous, points = of(8, EXAMPLE_LAWS["mooney_rivlin"])
    R, forces = turn(7), []
    for turned in (np.eye(3), R):
        H, x = viscous.rest(), points
        for seed, h in ((1, 0.05), (2, 0.3)):
            there = away(points, seed) @ turned.T
            step = viscous.step(H, x, h)
            H, x = viscous.after(H, x, there, h), there
        forces.append(step.gradient(x))
    assert forces[1] == pytest.approx(forces[0] @ R.T, abs=1e-12 * np.abs(forces[0]).max())
