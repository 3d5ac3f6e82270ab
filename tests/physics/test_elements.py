"""The elements: patch test, order of convergence, a closed form at finite strain."""

from typing import Any

import numpy as np
import pytest
from helpers import small
from helpers.minimiser import minimise
from scipy.optimize import brentq

from tacgen.fem.assembly import Pattern, pattern
from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import elements
from tacgen.fem.materials import EXAMPLE_LAWS, Law, NeoHooke

Array = np.ndarray
LAW = NeoHooke(0.05, 0.6)


ELEMENTS = {"hex": 8, "tet": 10, "linear_tet": 4}  # nodes


def block(n: int, shake: float = 0.0, nodes: int = 8) -> tuple[Array, Array]:
    """A unit cube, n hexes a side or six tets for each; corners inside are moved by up to shake/n each way."""
    points, cells = small.block(n, shake)
    return (points, cells) if nodes == 8 else small.tetrahedral(points, cells, nodes)


def inside(points: Array) -> Array:
    """Free dofs (n, 3): none on the cube's faces."""
    free = np.all((points > 1e-9) & (points < 1 - 1e-9), axis=1)
    return np.repeat(free[:, None], 3, 1)


def solve(potential: Any, x: Array, pat: Pattern) -> Array:
    return minimise(potential, x, pat, xtol=1e-11)


@pytest.mark.parametrize("law", EXAMPLE_LAWS.values(), ids=list(EXAMPLE_LAWS))
@pytest.mark.parametrize(("kind", "shake"), [("hex", 0.3), ("tet", 0.2), ("linear_tet", 0.2)])
def test_a_linear_displacement_gives_a_uniform_stress_on_any_mesh(law: Law, kind: str, shake: float) -> None:
    points, cells = block(3 if kind == "hex" else 2, shake, ELEMENTS[kind])
    F = np.array([[1.2, 0.3, 0.0], [-0.1, 0.9, 0.2], [0.1, 0.0, 1.1]])
    free = inside(points)
    pat = pattern([cells], free)
    body = Elastic.on(pat, elements(points, cells), law)
    exact = points @ F.T
    found = solve(body, np.where(free, exact + 0.02 * np.sin(7 * points), exact), pat)
    assert found == pytest.approx(exact, abs=1e-10)
    sigma = body.cauchy(body.evaluate(found))[0].reshape(-1, 3, 3)
    assert np.abs(sigma[0]).max() > 0.01
    assert np.ptp(sigma, axis=0) == pytest.approx(np.zeros((3, 3)), abs=1e-10)


def u(X: Array) -> Array:
    """A smooth displacement, amplitude .08."""
    x, y, z = np.moveaxis(X, -1, 0)
    parts = [np.sin(2 * x + y) * np.cos(z), np.cos(x - 2 * z) * y, np.sin(x * y) + np.cos(2 * z + x)]
    return 0.08 * np.stack(parts, -1)


def displacement_error(n: int, nodes: int) -> float:
    """L2 error on an n^3 block. The load is the weak form of the exact stress, so Div P never has to be derived."""
    points, cells = block(n, 0.0, nodes)
    free = inside(points)
    pat = pattern([cells], free)
    e = elements(points, cells)
    body = Elastic.on(pat, e, LAW)
    at = np.einsum("qa,eai->eqi", e.shape, points[cells])
    h = 1e-6
    slopes = [(u(at + h * axis) - u(at - h * axis)) / (2 * h) for axis in np.eye(3)]
    F = np.eye(3) + np.stack(slopes, -1)
    J, G = np.linalg.det(F), np.linalg.inv(F).swapaxes(-1, -2)
    I1 = (F**2).sum((-1, -2))
    J_, I1_ = J[..., None, None], I1[..., None, None]
    P = LAW.mu * J_ ** (-2 / 3) * (F - I1_ / 3 * G) + LAW.kappa / 2 * (J_**2 - 1) * G
    force = np.zeros_like(points)
    np.add.at(force, cells, np.einsum("eq,eqiJ,eqaJ->eai", e.weights, P, e.gradients))
    exact = points + u(points)
    found = solve(small.Total((body, small.Load(force))), exact, pat)
    off = np.einsum("qa,eai->eqi", e.shape, (found - points)[cells]) - u(at)
    return float(np.sqrt((e.weights * (off**2).sum(-1)).sum()))


@pytest.mark.parametrize(
    ("kind", "sizes", "order"), [("hex", (4, 6, 9, 13), 2), ("tet", (2, 3, 4, 6), 3), ("linear_tet", (4, 6, 9, 13), 2)]
)
def test_displacements_converge_at_the_elements_order(kind: str, sizes: tuple[int, ...], order: int) -> None:
    errors = [displacement_error(n, ELEMENTS[kind]) for n in sizes]
    rate = -np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert rate == pytest.approx(order, abs=0.2), errors  # too fast is a bug as well


@pytest.mark.parametrize("kind", ELEMENTS)
@pytest.mark.parametrize("nu", [0.3, 0.48, 0.4999])
def test_uniaxial_tension_follows_the_closed_form(nu: float, kind: str) -> None:
    """sigma = mu J^(-5/3) (l^2 - t^2) with the transverse stretch t from vanishing transverse stress."""
    E, stretch = 0.15, 1.5
    law = NeoHooke(E / (2 * (1 + nu)), E / (3 * (1 - 2 * nu)))
    points, cells = block(2, 0.2, ELEMENTS[kind])
    free = points > 1e-9  # each lower face slides in its plane
    free[points[:, 2] > 1 - 1e-9, 2] = False
    pat = pattern([cells], free)
    body = Elastic.on(pat, elements(points, cells), law)
    x = points.copy()
    x[points[:, 2] > 1 - 1e-9, 2] = stretch
    found = solve(body, x, pat)

    def transverse(t: float) -> float:
        J, I1 = stretch * t**2, stretch**2 + 2 * t**2
        return float(law.mu * J ** (-5 / 3) * (t**2 - I1 / 3) + law.kappa / 2 * (J - 1 / J))

    t = brentq(transverse, 0.5, 1.2, xtol=1e-15)
    expected = law.mu * (stretch * t**2) ** (-5 / 3) * (stretch**2 - t**2) * t**2
    force = body.gradient(found)[points[:, 2] > 1 - 1e-9, 2].sum()
    assert force == pytest.approx(expected, rel=1e-8)
    assert np.ptp(found[:, 0]) == pytest.approx(t, abs=1e-8)
    if nu == 0.4999:  # as good as incompressible
        assert force == pytest.approx(law.mu * (stretch - stretch**-2), rel=1e-3)


@pytest.mark.parametrize(("kind", "count"), [("hex", 4), ("tet", 6), ("linear_tet", 6)])
def test_an_inverted_element_is_refused(kind: str, count: int) -> None:
    points, cells = block(2, 0.0, ELEMENTS[kind])
    assert elements(points, cells).weights.sum() == pytest.approx(1.0)
    points[13, 2] += 0.9  # the middle node, above the top
    with pytest.raises(ValueError, match=f"^{count} elements are inverted"):
        elements(points, cells)
