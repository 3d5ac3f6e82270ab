"""A pressure that is carried from step to step leads to the same answer where the true one leads astray."""

import numpy as np
import pytest
from helpers.small import block, dense, full, standing, tetrahedral

from tacgen.fem.assembly import Pattern, pattern
from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import elements
from tacgen.fem.materials import NeoHooke
from tacgen.fem.projection import Projection
from tacgen.physics.elements import MAX_PREDICTED_RATIO

Array = np.ndarray
MU = 0.05
NU = 0.4998
NODES = pytest.mark.parametrize("nodes", [8, 10, 4])


def bulk_modulus(nu: float) -> float:
    return 2 * MU * (1 + nu) / (3 * (1 - 2 * nu))


def held_block(nu: float, nodes: int = 8, n: int = 3) -> tuple[Elastic, Array, Pattern]:
    """A block between two plates; its points."""
    points, cells = block(n, 0.1)
    if nodes != 8:
        points, cells = tetrahedral(points, cells, nodes)
    pat = pattern([cells], standing(points) & (points[:, 2:] != 1))
    return Elastic.on(pat, elements(points, cells), NeoHooke(MU, bulk_modulus(nu))), points, pat


class Indefinite(ArithmeticError):
    pass


def newton(body: Elastic, x: Array, J: Array | None, pat: Pattern, keep: int = 1) -> tuple[Array, list[float]]:
    """Whole steps without a line search until they are short: positions and the steps' lengths.

    J (e, q) at the start: the pressure is carried on from there; None: it is the true one. A tangent serves `keep`
    steps. Raises Indefinite: a tangent is not positive definite.
    """
    lengths: list[float] = []
    at, free = body.evaluate(x), pat.free
    while not lengths or (1e-10 < lengths[-1] < 10 and len(lengths) < 40):
        if len(lengths) % keep == 0:
            data, taken = np.zeros(len(pat.indices)), at.F
            body.add_tangent(at, data, Projection.NONE, J)
            try:
                np.linalg.cholesky(K := full(pat, data))
            except np.linalg.LinAlgError:
                raise Indefinite(len(lengths)) from None
        g = body.forces(at, len(x)) if J is None else body.mixed_forces(at, J, taken, len(x))
        p = np.zeros(x.size)
        p[free] = np.linalg.solve(K, -g.ravel()[free])
        x = x + p.reshape(x.shape)
        there = body.evaluate(x)
        J = None if J is None else body.predicted(at, there, taken)
        at = there
        lengths.append(float(np.abs(p).max()))
    return x, lengths


def sheared(points: Array, by: float, squeezed: float = 0.0) -> Array:
    """The upper plate moved aside and down, everything between guessed along with it."""
    return points + points[:, 2:] * [by, 0.0, -squeezed]


@pytest.mark.parametrize("nodes", [8, 10])
def test_where_volume_is_kept_it_needs_fewer_steps_to_the_same_answer(nodes: int) -> None:
    body, points, pat = held_block(NU, nodes, 3 if nodes == 8 else 2)
    rest = body.evaluate(points).J
    plain, lengths = newton(body, sheared(points, 0.1), None, pat)
    mixed, fewer = newton(body, sheared(points, 0.1), rest, pat)
    assert lengths[-1] < 1e-10 > fewer[-1]
    assert len(fewer) < len(lengths)
    assert mixed == pytest.approx(plain, abs=1e-9)
    assert np.abs(body.gradient(mixed).ravel()[pat.free]).max() < 1e-9 * MU


@NODES
@pytest.mark.parametrize(("nu", "by", "squeezed"), [(NU, 0.2, 0.0), (0.49, 0.3, 0.1)])
def test_it_converges_where_the_true_pressure_makes_the_tangent_indefinite(
    nodes: int, nu: float, by: float, squeezed: float
) -> None:
    body, points, pat = held_block(nu, nodes, 3 if nodes == 8 else 2)
    x = sheared(points, by, squeezed)
    if nodes != 4 or squeezed:  # linear tets lock, which leaves this one definite
        with pytest.raises(Indefinite):
            newton(body, x, None, pat)
    found, lengths = newton(body, x, body.evaluate(points).J, pat)
    assert len(lengths) <= 5
    assert lengths[-1] < 1e-10
    assert np.abs(body.gradient(found).ravel()[pat.free]).max() < 1e-9 * MU  # balanced by the true pressure


@pytest.mark.parametrize("nodes", [8, 10])
def test_one_tangent_leads_to_the_answer_where_volume_is_kept(nodes: int) -> None:
    """Its steps shorten; by the true pressure alone they grow."""
    body, points, pat = held_block(NU, nodes, 3 if nodes == 8 else 2)
    x = sheared(points, 0.1)
    with np.errstate(all="ignore"):
        _, astray = newton(body, x, None, pat, keep=99)
    assert astray[-1] > 1
    found, lengths = newton(body, x, body.evaluate(points).J, pat, keep=99)
    assert lengths[-1] < 1e-10
    assert len(lengths) < 12
    assert np.abs(body.gradient(found).ravel()[pat.free]).max() < 1e-8 * MU


def strained(points: Array, seed: int = 0) -> Array:
    return sheared(points, 0.3) + 0.01 * np.random.default_rng(seed).normal(size=points.shape)


@NODES
@pytest.mark.parametrize("nu", [0.3, 0.49, NU])
def test_with_a_tangent_taken_there_it_is_the_true_forces_whatever_pressure_is_carried(nodes: int, nu: float) -> None:
    body, points, _ = held_block(nu, nodes, 2)
    x = strained(points)
    at = body.evaluate(x)
    true = body.forces(at, len(x))
    carried = at.J * np.random.default_rng(1).uniform(0.8, 1.2, at.J.shape)
    assert body.mixed_forces(at, carried, at.F, len(x)) == pytest.approx(true, abs=1e-12 * np.abs(true).max())
    elsewhere = body.evaluate(points).F
    assert body.mixed_forces(at, at.J, elsewhere, len(x)) == pytest.approx(true, abs=1e-12 * np.abs(true).max())
    mixed = body.mixed_forces(at, carried, elsewhere, len(x))
    assert np.abs(mixed - true).max() > 1e-2 * np.abs(true).max()
    assert mixed.sum(0) == pytest.approx(np.zeros(3), abs=1e-9 * np.abs(true).max())


@NODES
def test_the_tangent_takes_the_pressure_that_is_carried(nodes: int) -> None:
    """That of J = 1 is none: what is left where the material is strained is the stiffness without it."""
    body, points, pat = held_block(0.49, nodes, 2)
    x = strained(points)
    at = body.evaluate(x)

    def tangent(J: Array | None) -> Array:
        data = np.zeros(len(pat.indices))
        body.add_tangent(at, data, Projection.NONE, J)
        return full(pat, data)

    true = tangent(None)
    size = np.abs(true).max()
    assert (true == dense(body, x, pat)).all()
    assert tangent(at.J) == pytest.approx(true, abs=1e-12 * size)
    other = tangent(np.ones_like(at.J))
    assert np.abs(other - true).max() > 0.01 * size
    one = tangent(np.full_like(at.J, 1.1)) - other
    two = tangent(np.full_like(at.J, 1.2)) - other
    assert np.abs(one).max() > 0.01 * size
    slope = np.array([J - 1 / J for J in (1.1, 1.2)])  # of U, times half the bulk modulus
    assert two == pytest.approx(one * slope[1] / slope[0], abs=1e-9 * size)  # linear in the pressure


@NODES
def test_what_is_carried_stays_within_a_factor_of_the_truth(nodes: int) -> None:
    body, points, _ = held_block(0.4, nodes, 2)
    x = strained(points)
    at, elsewhere = body.evaluate(x), body.evaluate(points).F
    most = MAX_PREDICTED_RATIO
    for far, end in ((9.0, most), (-1.0, 1 / most)):
        found = body.mixed_forces(at, far * at.J, elsewhere, len(x))
        assert found == pytest.approx(body.mixed_forces(at, end * at.J, elsewhere, len(x)), rel=1e-12, abs=1e-15)


def test_j_is_carried_on_by_its_first_derivative_where_the_tangent_was_taken() -> None:
    body, points, _ = held_block(0.4, n=2)
    here, to = strained(points), strained(strained(points))
    at, elsewhere, h = body.evaluate(here), body.evaluate(points), 1e-6
    slope = (body.evaluate(here + h * (to - here)).J - body.evaluate(here - h * (to - here)).J) / (2 * h)
    there = body.evaluate(to)
    assert body.predicted(at, there, at.F) == pytest.approx(at.J + slope, abs=1e-8)
    assert body.predicted(at, at, elsewhere.F) == pytest.approx(at.J)
    C = np.linalg.det(elsewhere.F)[..., None, None] * np.linalg.inv(elsewhere.F).swapaxes(-1, -2)
    assert body.predicted(at, there, elsewhere.F) == pytest.approx(at.J + (C * (there.F - at.F)).sum((-1, -2)))
    moved = np.einsum("eai,eqaj->eqij", here[body.elements.conn], body.elements.gradients)
    assert pytest.approx(moved) == at.F
