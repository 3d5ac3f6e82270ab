"""What keeps elements from folding at corners and edges: slopes of its energy, 0 above J0, infinite where folded."""

import numpy as np
import pytest
from helpers.small import block, dense, distorted, slope, standing, tetrahedral, turn, whole

from fem.test_jacobian import CUBE, FOLDED, HEX
from tacgen.fem.assembly import Pattern, pattern
from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import elements, grid_points, jacobians
from tacgen.fem.folding_barrier import FoldingBarrier
from tacgen.fem.materials import NeoHooke
from tacgen.fem.mesh_quality import scaled_jacobian
from tacgen.fem.projection import Projection
from tacgen.physics.laws import INVERSION_BARRIER_J0

Array = np.ndarray
MU = 0.05
NODES = pytest.mark.parametrize("nodes", [8, 10])


def one(nodes: int) -> tuple[Array, Array]:
    """Points and the table of one distorted hex, or of the six quadratic tets in it."""
    points, cells = distorted(0.05)
    return (points, cells) if nodes == 8 else tetrahedral(points, cells, nodes)


def barrier(points: Array, cells: Array) -> tuple[FoldingBarrier, Pattern]:
    pat = whole(cells, len(points))
    return FoldingBarrier.on(pat, points, elements(points, cells), MU), pat


def volumes(points: Array, cells: Array, x: Array) -> Array:
    """J (e, q) where the barrier looks at the elements, moved from `points` to x."""
    dN = grid_points(cells.shape[1])[1]
    return np.asarray(np.linalg.det(jacobians(x, cells, dN)) / np.linalg.det(jacobians(points, cells, dN)))


def squeezed(nodes: int, least: float) -> tuple[Array, Array, Array]:
    """Points, cells, and positions with one corner pushed in until the least J at a node is `least`; turned."""
    points, cells = one(nodes)
    x, low, high = points.copy(), 0.0, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        x[6] = points[6] + middle * (points[0] - points[6])
        x[8:] = points[8:] + 0.05 * np.sin(9 * points[8:]) * middle  # edges of tets are bent
        low, high = (middle, high) if volumes(points, cells, x).min() > least else (low, middle)
    return points, cells, x @ turn(3).T


@NODES
def test_it_begins_below_j0_and_not_before(nodes: int) -> None:
    points, cells, x = squeezed(nodes, INVERSION_BARRIER_J0 + 1e-9)
    energy, pat = barrier(points, cells)
    assert (energy.value(x), np.abs(energy.gradient(x)).max(), np.abs(dense(energy, x, pat)).max()) == (0, 0, 0)
    assert energy.value(points) == 0
    points, cells, x = squeezed(nodes, INVERSION_BARRIER_J0 - 1e-3)
    assert 0 < energy.value(x) < 1e-6 * MU


@NODES
@pytest.mark.parametrize("least", [0.1, 0.5, 0.9])
def test_gradient_and_hessian_are_slopes(nodes: int, least: float) -> None:
    points, cells, x = squeezed(nodes, least * INVERSION_BARRIER_J0)
    energy, pat = barrier(points, cells)
    assert volumes(points, cells, x).min() == pytest.approx(least * INVERSION_BARRIER_J0)
    g, H = energy.gradient(x), dense(energy, x, pat)
    assert energy.value(x) > 1e-7 * MU
    assert np.abs(g).max() > 1e-4 * MU
    assert np.abs(H).max() > 1e-2 * MU
    assert g.ravel() == pytest.approx(slope(energy.value, x, 1e-6), abs=1e-6 * np.abs(g).max())
    by_differences = slope(lambda y: energy.gradient(y).ravel(), x, 1e-7)
    assert pytest.approx(by_differences, abs=1e-5 * np.abs(H).max()) == H


@NODES
def test_a_rotation_does_not_activate_it_and_forces_balance(nodes: int) -> None:
    points, cells, x = squeezed(nodes, 0.05)
    energy, _ = barrier(points, cells)
    g = energy.gradient(x)
    assert energy.value(x @ turn(9).T + 3.0) == pytest.approx(energy.value(x))
    assert np.abs(g.sum(0)).max() < 1e-12 * np.abs(g).max()
    assert np.abs(np.cross(x, g).sum(0)).max() < 1e-12 * np.abs(g).max()


@NODES
def test_it_grows_to_infinity_where_a_corner_inverts(nodes: int) -> None:
    """Though the strain energy, which knows only the integration points, is finite there."""
    values = []
    for least in (0.15, 1e-2, 1e-4, 1e-6):
        points, cells, x = squeezed(nodes, least)
        values.append(barrier(points, cells)[0].value(x))
    assert np.isfinite(values).all()
    assert np.diff(values).min() > 0.3 * np.diff(values).max() > 0.01 * MU  # for each two digits about as much
    points, cells, x = squeezed(nodes, -1e-3)
    energy, pat = barrier(points, cells)
    assert volumes(points, cells, x).min() == pytest.approx(-1e-3)
    assert Elastic.on(pat, elements(points, cells), NeoHooke(MU, 0.4)).value(x) < np.inf
    assert energy.value(x) == np.inf
    assert energy.value(points * [1, 1, -1]) == np.inf


@pytest.mark.parametrize("folded", FOLDED)
def test_a_hex_that_folds_between_its_corners_has_infinite_energy(folded: list[list[int]]) -> None:
    x = np.array(folded) / 10
    assert scaled_jacobian(x, HEX).min() > 0.03  # sound at its corners
    energy, _ = barrier(CUBE, HEX)
    assert energy.value(x) == np.inf
    assert energy.value(0.2 * x + 0.8 * CUBE) < np.inf


@NODES
def test_projected_it_is_positive(nodes: int) -> None:
    points, cells, x = squeezed(nodes, 0.03)
    energy, pat = barrier(points, cells)
    assert np.linalg.eigvalsh(dense(energy, x, pat)).min() < -1e-3 * MU
    values = np.linalg.eigvalsh(dense(energy, x, pat, Projection.FULL))
    assert values.max() > MU
    assert values.min() > -1e-12 * values.max()


@NODES
def test_of_many_elements_only_those_that_are_squeezed_count(nodes: int) -> None:
    """In a block some of whose nodes are held: the entries stand where the pattern has them."""
    points, cells = block(2, 0.1)
    if nodes == 10:
        points, cells = tetrahedral(points, cells, nodes)
    pat = pattern([cells], standing(points))
    energy = FoldingBarrier.on(pat, points, elements(points, cells), MU)
    x = points.copy()
    assert np.abs(points[13] - 0.5).max() <= 0.05
    x[13] += 0.15  # the node in the middle, toward a corner
    J = volumes(points, cells, x)
    below = np.flatnonzero((J < INVERSION_BARRIER_J0).any(1))
    assert 0 < len(below) < len(cells)
    assert J.min() > 0.005
    assert energy.value(x) > 1e-5 * MU
    assert energy.value(x) == pytest.approx(sum(barrier(points, cells[[e]])[0].value(x) for e in below))
    H = dense(energy, x, pat)

    def gradient(y: Array) -> Array:
        return energy.gradient(y).ravel()[pat.free]

    by_differences = slope(gradient, x, 1e-7)[pat.free]
    assert pytest.approx(by_differences, abs=1e-5 * np.abs(H).max()) == H
    assert energy.gradient(x).ravel() == pytest.approx(slope(energy.value, x, 1e-6), abs=1e-6 * np.abs(H).max())
    touched = np.unique(cells[below])
    assert not np.delete(energy.gradient(x), touched, 0).any()


@NODES
def test_it_scales_with_the_modulus(nodes: int) -> None:
    points, cells, x = squeezed(nodes, 0.3)
    energy, _ = barrier(points, cells)
    assert energy.stiffened(3.0).value(x) == pytest.approx(3 * energy.value(x))


def test_no_squeezed_hex_is_missed_by_the_bound_that_spares_most_cells() -> None:
    """Among hexes from mild to folded, in boxes and in wedges."""
    rng, count = np.random.default_rng(4), 0
    for k in range(300):
        points, cells = distorted(0.0 if k % 2 else 0.1)
        x = (points + 10 ** rng.uniform(-3, -0.4) * rng.normal(size=points.shape)) @ turn(k).T
        low = barrier(points, cells)[0].folds.lowest(x[None])[0, 0]
        exact = volumes(points, cells, x).min()
        assert (low < INVERSION_BARRIER_J0) == (exact < INVERSION_BARRIER_J0)
        assert low <= exact + 1e-12
        count += low < exact - 1e-12
    assert 30 < count < 270  # both ways of the kernel
