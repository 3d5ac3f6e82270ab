"""A signed distance on a grid: slopes, error on a ball, rounding of edges, and what holds outside the grid."""

import numpy as np
import pytest
from helpers.meshes import differences

from tacgen.geometry.sdf_grid import Field

Array = np.ndarray
R = 4.0


def field_of(distance, low: list[float], high: list[float], cell: float) -> Field:
    low_, n = np.array(low), (np.ceil((np.array(high) - low) / cell)).astype(int) + 1
    grid = np.stack(np.meshgrid(*(low_[a] + cell * np.arange(n[a]) for a in range(3)), indexing="ij"), -1)
    return Field.through(distance(grid), low_, cell, smallest_radius=1.0, corners=np.eye(3))


def ball(p: Array) -> Array:
    return np.linalg.norm(p - [0, 0, R], axis=-1) - R


def block(p: Array, half: float = 3) -> Array:
    """Box of 6 mm by twice `half` by 4 mm standing on z = 0."""
    q = np.abs(p - [0, 0, 2]) - [3, half, 2]
    return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0)


BALL = field_of(ball, [-4.6, -4.6, -0.6], [4.6, 4.6, 5.0], 0.156)
BLOCK = field_of(block, [-4, -4, -1], [4, 4, 3], 0.1)


@pytest.mark.parametrize("field", [BALL, BLOCK], ids=["ball", "block"])
def test_gradient_and_hessian_are_slopes(field: Field):
    p = np.random.default_rng(1).uniform([-3.8, -3.8, -0.4], [3.8, 3.8, 2.5], (400, 3))
    _, g, H = field.distance(p)
    slopes, bends = differences(field, p, 1e-5)
    assert g == pytest.approx(slopes, abs=1e-8)
    assert pytest.approx(bends, abs=2e-3) == H  # third derivatives jump between cells
    assert np.abs(H).max() > 0.2


def test_error_falls_with_the_fourth_power_of_the_cell():
    errors, rng = [], np.random.default_rng(0)
    u = rng.normal(size=(2000, 3))
    p = u / np.linalg.norm(u, axis=1)[:, None] * (R + rng.uniform(-0.05, 0.05, (2000, 1))) + [0, 0, R]
    p = p[p[:, 2] < 3.5]
    for cell in (0.4, 0.2, 0.1):
        errors.append(np.sqrt(np.mean((field_of(ball, [-5, -5, -1], [5, 5, 5], cell).distance(p)[0] - ball(p)) ** 2)))
    rate = np.log2(errors[-2] / errors[-1])
    assert 3.5 < rate < 4.5, errors


@pytest.mark.parametrize(("cells", "error"), [(2.5, 1e-4), (4, 1e-12)])
def test_a_flat_face_is_flat_up_to_some_cells_from_its_edge(cells: float, error: float):
    rng, half = np.random.default_rng(2), 3 - cells * BLOCK.cell
    p = np.column_stack([rng.uniform(-half, half, (2000, 2)), rng.uniform(-0.1, 0.05, 2000)])
    d, g, _ = BLOCK.distance(p)
    assert d == pytest.approx(-p[:, 2], abs=error)
    assert g == pytest.approx(np.tile([0.0, 0.0, -1.0], (2000, 1)), abs=100 * error)


def test_an_edge_is_rounded_by_less_than_half_a_cell():
    d = BLOCK.value(np.column_stack([np.full(41, 3.0), np.linspace(-2, 2, 41), np.zeros(41)]))
    assert d.min() > 0.0  # rounded off, not sharpened
    assert d.max() < 0.5 * BLOCK.cell


def test_outside_the_grid_the_distance_is_continuous_and_never_too_large():
    p = np.random.default_rng(4).uniform(-12, 12, (3000, 3))
    p = p[p[:, 2] < 2.0]
    d, g, _ = BALL.distance(p)
    assert (d <= ball(p) + 2e-3).all()
    out = np.abs(p).max(1) > 4.7
    assert (d[out] > 0.3).all()
    assert g == pytest.approx(differences(BALL, p, 1e-6)[0], abs=1e-6)


def test_reach_is_half_the_thinnest_wall():
    plate = field_of(lambda p: block(p, 0.5), [-4, -1, -1], [4, 1, 3], 0.1)
    assert plate.reach == pytest.approx(0.5, abs=0.06)
    assert BLOCK.reach == pytest.approx(2.0, abs=0.1)


def test_an_invalid_number_stays_none():
    d, _, _ = BALL.distance(np.array([[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 0]]))
    assert np.isnan(d[0])
    assert d[1] == np.inf or np.isnan(d[1])
    assert abs(d[2]) < 1e-3
