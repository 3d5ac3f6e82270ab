"""Patch recovery: linear fields exactly, nothing that alternates, nothing across an interface."""

import numpy as np
import pytest
from helpers.small import block, tetrahedral

from tacgen.fem.stress_recovery import Recovery

Array = np.ndarray


def linear(X: Array) -> Array:
    """Two linear fields (n, 2)."""
    return np.stack([1.0 + 2 * X[:, 0] - X[:, 1] + 3 * X[:, 2], 0.5 - X[:, 0] + 4 * X[:, 1]], 1)


def graded(n: int) -> tuple[Array, Array, Array]:
    """Points, hexes and their centres: a block with sides of other lengths in each direction."""
    points, cells = block(n)
    points = points * [1.0, 2.0, 0.7] + 0.2 * points * (1 - points)
    return points, cells, points[cells].mean(1)


def test_linear_fields_are_recovered_up_to_the_corners() -> None:
    points, cells, centres = graded(4)
    found = Recovery.on(points, cells, np.zeros(len(cells), int))
    assert (np.sort(found.node) == np.arange(len(points))).all()
    assert found.matrix @ linear(centres) == pytest.approx(linear(points[found.node]), abs=1e-12)
    assert found.mean @ linear(points[found.node]) == pytest.approx(linear(centres), abs=1e-12)


@pytest.mark.parametrize("shake", [0.0, 0.2])
def test_constants_are_kept_on_any_mesh(shake: float) -> None:
    points, cells = block(3, shake)
    found = Recovery.on(points, cells, np.zeros(len(cells), int))
    assert found.matrix.sum(1) == pytest.approx(np.ones(len(found.node)))


@pytest.mark.parametrize("way", [(1, 1, 1), (1, 1, 0), (0, 1, 1)])
def test_no_checkerboard_reaches_a_node(way: tuple[int, int, int]) -> None:
    """Those of Q1P0 alternate in two directions at least, with any profile along the third."""
    n = 5
    points, cells, _ = graded(n)
    i = np.indices((n, n, n)).reshape(3, -1)
    board = (-1.0) ** (np.array(way) @ i) * (1 + np.array([1 - w for w in way]) @ i)
    found = Recovery.on(points, cells, np.zeros(len(cells), int))
    assert np.abs(board).min() == 1
    assert found.matrix @ board == pytest.approx(np.zeros(len(found.node)), abs=1e-12)


def test_an_interface_has_both_values_and_the_outermost_is_the_last() -> None:
    points, cells, centres = graded(4)
    upper = centres[:, 2] > np.median(centres[:, 2])
    found = Recovery.on(points, cells, upper.astype(int))
    value = linear(centres) + np.where(upper, 10.0, -10.0)[:, None]
    rows = found.matrix @ value
    side = np.where(found.material == 1, 10.0, -10.0)
    assert rows == pytest.approx(linear(points[found.node]) + side[:, None], abs=1e-12)
    assert len(rows) == len(points) + 25  # the interface twice
    shared = np.flatnonzero(np.bincount(found.node) == 2)
    assert len(shared) == 25
    assert found.outermost(rows, len(points))[shared] == pytest.approx(linear(points[shared]) + 10.0, abs=1e-12)


def test_a_layer_of_one_cell_is_even_through_its_thickness() -> None:
    """One row of centres says nothing of the slope across it: in the plane it is linear, through it constant."""
    points, cells, centres = graded(3)
    thin = centres[:, 2] > np.sort(np.unique(centres[:, 2].round(9)))[1] + 1e-9
    found = Recovery.on(points, cells, thin.astype(int))
    skin = found.material == 1
    X = points[found.node[skin]] * [1, 1, 0] + [0, 0, centres[thin, 2].mean()]
    assert (found.matrix @ linear(centres))[skin] == pytest.approx(linear(X), abs=1e-12)


@pytest.mark.parametrize("nodes", [10, 4])
def test_tetrahedra(nodes: int) -> None:
    points, cells = tetrahedral(*block(3, 0.2), nodes)
    found = Recovery.on(points, cells, np.zeros(len(cells), int))
    assert (np.sort(found.node) == np.arange(len(points))).all()
    centres = points[cells[:, :4]].mean(1)
    assert found.matrix @ linear(centres) == pytest.approx(linear(points[found.node]), abs=1e-10)
