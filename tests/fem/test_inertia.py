"""Inertia and damping: derivatives, mass, and implicit Euler's own answer for the modes of a column, exactly."""

import numpy as np
import pytest
from helpers.minimiser import minimise
from helpers.small import Total, block, dense, distorted, hexes, slope, standing, tetrahedral, turn, whole

from tacgen.fem.assembly import Pattern, pattern
from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import Elements, elements
from tacgen.fem.inertia import Body
from tacgen.fem.materials import NeoHooke

Array = np.ndarray
LAW = NeoHooke(0.05, 0.4)
DENSITY = 1e-9  # t/mm^3
HEIGHT, LAYERS = 4.0, 10


def column(axis: int) -> tuple[Elastic, Pattern, Array]:
    """A column on a bonded base that can move along one axis only, which leaves its shear or its pressure wave."""
    points, cells = hexes([0.0, 1.0], [0.0, 1.0], np.linspace(0, HEIGHT, LAYERS + 1))
    pat = pattern([cells], standing(points) & (np.arange(3) == axis))
    return Elastic.on(pat, elements(points, cells), LAW), pat, points


def swing(axis: int, h: float, steps: int, alpha: float = 0.0, beta: float = 0.0) -> tuple[Array, Array]:
    """Displacement of the top and energy after each step of a column let go in its first mode."""
    elastic, pat, points = column(axis)
    body = Body.of(pat, (elastic,), DENSITY, alpha, beta)
    x, v = points.copy(), np.zeros_like(points)
    x[:, axis] += 1e-4 * np.sin(np.pi * points[:, 2] / (2 * HEIGHT))
    top, energy = [1e-4], [elastic.value(x)]
    for _ in range(steps):
        step = body.step(x, v, h)
        found = minimise(Total((elastic, step)), step.coasting, pat, xtol=1e-9)
        v, x = (found - x) / h, found
        top.append(float((x - points)[-1, axis]))
        energy.append(elastic.value(x) + float((body.mass[:, None] * v**2).sum()) / 2)
    return np.array(top), np.array(energy)


def omega(axis: int) -> float:
    """First circular frequency of a column of height H on its base, pi c / 2 H [1/s]."""
    modulus = LAW.mu if axis == 0 else LAW.kappa + 4 / 3 * LAW.mu
    return float(np.pi / (2 * HEIGHT) * np.sqrt(modulus / DENSITY))


@pytest.mark.parametrize(
    ("axis", "alpha", "beta"), [(0, 0.0, 0.0), (0, 300.0, 0.0), (0, 0.0, 2e-4), (2, 0.0, 0.0), (2, 300.0, 2e-4)]
)
def test_a_column_swings_as_implicit_euler_makes_it(axis: int, alpha: float, beta: float) -> None:
    """A mode with c = alpha + beta w^2 goes by x_n+1 (1 + h c + h^2 w^2) = (2 + h c) x_n - x_n-1."""
    w, h = omega(axis), 0.15 / omega(axis)
    top, _ = swing(axis, h, 20, alpha, beta)
    (a, b), *_ = np.linalg.lstsq(np.stack([top[1:-1], -top[:-2]], 1), top[2:], rcond=None)
    c = alpha + beta * w**2
    whole_step = 1 + h * c + (h * w) ** 2
    assert 1 / b - 1 == pytest.approx(whole_step - 1, rel=0.01)  # what is lost in a step, numerical and real
    assert a == pytest.approx((2 + h * c) / whole_step, rel=1e-3)
    if not c:
        period = 2 * np.pi * h / np.arccos(a / (2 * np.sqrt(b)))
        assert period == pytest.approx(2 * np.pi * h / np.arctan(w * h), rel=0.005)
        assert period == pytest.approx(2 * np.pi / w, rel=0.02)


def test_the_error_falls_with_the_step_at_first_order() -> None:
    w, end = omega(0), 0.4 * np.pi / omega(0)
    steps = np.array([16, 32, 64])
    errors = [abs(swing(0, end / n, n)[0][-1] / 1e-4 - np.cos(w * end)) for n in steps]
    assert -np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(1.0, abs=0.15), errors


@pytest.mark.parametrize("h", [1e-5, 3e-4, 1e-2])
def test_energy_never_grows(h: float) -> None:
    _, energy = swing(0, h, 12)
    rounding = 1e-16  # [N mm] the energy at rest comes out as up to 2e-17, a millionth of what is let go
    assert (np.diff(energy) <= rounding).all()
    assert energy[1] < (1 - 1e-5) * energy[0]
    assert energy[-1] < energy[1]


def kinds() -> dict[str, tuple[Array, Elements]]:
    points, cells = distorted()
    ten, tet10 = tetrahedral(points, cells)
    four, tet4 = tetrahedral(points, cells, 4)
    return {
        "hex": (points, elements(points, cells)),
        "quadratic tet": (ten, elements(ten, tet10)),
        "linear tet": (four, elements(four, tet4)),
    }


@pytest.mark.parametrize("kind", kinds())
def test_mass_is_positive_and_the_density_times_the_volume(kind: str) -> None:
    points, elements = kinds()[kind]
    pat = whole(elements.conn, len(points))
    body = Body.of(pat, (Elastic.on(pat, elements, LAW),), DENSITY, 0.0, 0.0)
    assert body.mass.min() > 0
    assert body.mass.sum() == pytest.approx(DENSITY * elements.weights.sum())


@pytest.mark.parametrize(("alpha", "beta"), [(0.0, 0.0), (50.0, 1e-3)])
def test_derivatives_are_those_of_the_energy(alpha: float, beta: float) -> None:
    points, cells = distorted()
    pat, rng = whole(cells, 8), np.random.default_rng(0)
    elastic = Elastic.on(pat, elements(points, cells), LAW)
    start = points @ turn(1).T + rng.normal(size=points.shape) * 0.1
    step = Body.of(pat, (elastic,), 1e-6, alpha, beta).step(start, rng.normal(size=points.shape) * 10, 1e-3)
    x = start + rng.normal(size=points.shape) * 0.1
    g, H = step.gradient(x), dense(step, x, pat)
    assert np.abs(g).max() > 0.01
    assert g.ravel() == pytest.approx(slope(step.value, x, 1e-4), abs=1e-6 * np.abs(g).max())
    assert pytest.approx(slope(lambda y: step.gradient(y).ravel(), x, 1e-4), abs=1e-7 * np.abs(H).max()) == H
    assert np.linalg.eigvalsh(H).min() > 0


def test_damping_stays_convex_and_forgets_no_rigid_motion() -> None:
    """From a block squeezed far beyond buckling, where the exact stiffness is not definite."""
    points, cells = block(2)
    pat = whole(cells, len(points))
    elastic = Elastic.on(pat, elements(points, cells), LAW)
    squeezed = points * [1.0, 1.0, 0.35]
    assert np.linalg.eigvalsh(dense(elastic, squeezed, pat)).min() < -1e-3
    step = Body.of(pat, (elastic,), 1e-15, 0.0, 1.0).step(squeezed, np.zeros_like(points), 1.0)
    H = dense(step, squeezed, pat)
    assert np.linalg.eigvalsh(H).min() > -1e-12 * np.abs(H).max()
    shifted = squeezed + np.array([0.3, -0.2, 0.1])
    assert np.abs(step.gradient(shifted)).max() < 1e-12 * np.abs(H).max()
