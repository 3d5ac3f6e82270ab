"""No point of an element is compressed more than the bound says, and some point almost as much."""

from itertools import product

import numpy as np
import pytest
from helpers.small import hexes, tetrahedral

from tacgen.fem import jacobian
from tacgen.fem.elements import HEX_CORNERS, TET_EDGES, barycentric
from tacgen.fem.jacobian import least_jacobian
from tacgen.fem.mesh_quality import nodal_volume, scaled_jacobian

Array = np.ndarray
CUBE = (HEX_CORNERS + 1) / 2
HEX = np.arange(8)[None]
TET = np.concatenate([np.eye(4), np.eye(4)[TET_EDGES].mean(1)])[:, 1:]
QUADRATIC = np.arange(10)[None]
# found among random ones: positive at all corners, negative on an edge; and positive on all edges, negative on a face
FOLDED = [
    [[4, -4, 3], [15, 2, -1], [4, 16, -2], [2, 7, -5], [-3, -2, 9], [11, 4, 15], [14, 4, 4], [3, 13, 16]],
    [[6, 2, -1], [15, 3, -1], [4, 9, -3], [-5, 10, 2], [4, -2, 10], [9, -6, 12], [8, 5, 5], [6, 14, 16]],
]
# positive at all nodes, negative on a face
SWOLLEN = TET.copy()
SWOLLEN[4:] = np.array([[7, -1, -3], [2, 7, -2], [0, 5, 1], [2, 2, 4], [6, -3, 2], [2, 4, 7]]) / 10


def mesh(nodes: int, n: int = 2) -> tuple[Array, ...]:
    """A unit cube of n^3 boxes, none like another, or of six times as many tets around their diagonals (Kuhn)."""
    points, cells = hexes(*[np.linspace(0, 1, n + 1) ** 1.5] * 3)
    return (points, cells) if nodes == 8 else tetrahedral(points, cells, nodes)


def gradients(nodes: int, at: Array) -> Array:
    """dN/dxi (q, a, 3) at points (q, 3) of the unit cube, or of the unit tet."""
    if nodes != 8:
        _, dL = barycentric(np.concatenate([1 - at.sum(1, keepdims=True), at], 1), nodes)
        return np.asarray(dL[..., 1:] - dL[..., :1])
    parts = np.where(CUBE > 0, at[:, None], 1 - at[:, None])
    slopes = 2 * CUBE - 1
    return np.stack([slopes[:, k] * np.delete(parts, k, 2).prod(2) for k in range(3)], -1)


def scanned(rest: Array, points: Array, cells: Array, n: int = 15) -> float:
    """The least J at n^3 points of each element, and at as many again about the least of those."""
    nodes = cells.shape[1]

    def inside(at: Array) -> Array:
        at = np.clip(at, 0, 1)
        return at if nodes == 8 else at / np.maximum(at.sum(1, keepdims=True), 1)

    def values(x: Array, at: Array) -> Array:
        return np.asarray(np.linalg.det(np.einsum("qaj,eai->eqij", gradients(nodes, at), x)))

    # both rules are exact for these polynomials: degree 2 in each direction, and 3 in all
    if nodes == 8:
        gauss = np.array(list(product((0.5 - 0.75**0.5 / 3, 0.5 + 0.75**0.5 / 3), repeat=3)))
        weights = np.full(8, 1 / 8)
    else:
        gauss = np.array([[1, 1, 1], [3, 1, 1], [1, 3, 1], [1, 1, 3]]) / 6
        gauss, weights = np.concatenate([gauss, [[0.25] * 3]]), np.array([0.45] * 4 + [-0.8])
    volume = values(rest[cells], gauss) @ weights
    ticks = np.array(list(product(np.linspace(0, 1, n), repeat=3)))
    found = np.inf
    for x, whole in zip(points[cells], volume, strict=True):
        at = inside(ticks)
        at = inside(at[values(x[None], at)[0].argmin()] + (2 * ticks - 1) / (n - 1))
        found = min(found, values(x[None], at).min() / whole)
    return found


@pytest.mark.parametrize("nodes", [8, 10, 4])
def test_an_affine_map_has_its_determinant(nodes: int):
    points, cells = mesh(nodes)
    rest = points * [0.5, 2.0, 0.3]
    assert least_jacobian(rest, rest, cells) == pytest.approx(1, abs=1e-12)
    A = np.array([[0.9, 0.3, -0.1], [0.2, 0.7, 0.4], [0.0, -0.3, 1.2]])
    assert least_jacobian(rest, rest @ A.T + 5, cells) == pytest.approx(np.linalg.det(A), abs=1e-12)
    A[0] *= -1
    assert least_jacobian(rest, rest @ A.T, cells) == pytest.approx(np.linalg.det(A), abs=1e-12)


@pytest.mark.parametrize("nodes", [8, 10])
@pytest.mark.parametrize("tol", [0.05, 0.001])
def test_it_bounds_what_a_scan_finds(nodes: int, tol: float, monkeypatch: pytest.MonkeyPatch):
    rng = np.random.default_rng(1)
    unit, cells = (CUBE, HEX) if nodes == 8 else (TET, QUADRATIC)
    divided = 0
    for _ in range(60):
        rest = unit + rng.uniform(-0.05, 0.05, unit.shape)  # curved: its mean counts
        points = rest + rng.uniform(-1, 1, unit.shape) * rng.uniform(0, 0.25)
        turn = points[:, 2] * rng.uniform(-2, 2)  # twisted, the middle is narrower than the ends
        x, y = points[:, 0] - 0.5, points[:, 1] - 0.5
        points[:, :2] = np.stack([np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y], -1)
        found, bound = scanned(rest, points, cells), least_jacobian(rest, points, cells, tol)
        assert found - tol - 1e-4 <= bound <= found + 1e-9
        with monkeypatch.context() as short:
            short.setattr(jacobian, "MAX_SUBDIVISIONS", 0)
            divided += least_jacobian(rest, points, cells, tol) < bound
    assert divided >= 10  # else the corners alone would do


@pytest.mark.parametrize("nodes", [8, 10])
def test_the_pieces_of_an_element_make_up_the_whole(nodes: int):
    pieces = jacobian.JACOBIAN_TABLES[nodes].pieces
    whole = np.random.default_rng(2).uniform(-1, 1, pieces.shape[-1])
    assert len(pieces) == 8  # of the same volume
    assert (pieces @ whole).mean() == pytest.approx(whole.mean())  # the integral is the mean of the coefficients
    assert pieces.min() >= 0
    assert pieces.sum(2) == pytest.approx(1)  # so no coefficient leaves the hull


@pytest.mark.parametrize("nodes", [8, 10])
def test_the_worst_of_many_counts(nodes: int):
    rest, cells = mesh(nodes)
    points = rest + np.random.default_rng(3).normal(0, 0.05, rest.shape)
    each = [least_jacobian(rest, points, cell[None], 1e-4) for cell in cells]
    assert least_jacobian(rest, points, cells, 1e-4) == pytest.approx(min(each), abs=1e-4)
    assert least_jacobian(rest, points, cells, 1e-4) < np.median(each) - 0.1


@pytest.mark.parametrize("corners", FOLDED)
def test_a_hex_that_folds_between_its_corners_is_reported(corners: list[list[int]]):
    points = np.array(corners) / 10
    assert scaled_jacobian(points, HEX).min() > 0.03
    assert scanned(CUBE, points, HEX) - 0.01 <= least_jacobian(CUBE, points, HEX) < -0.02


def test_a_hex_with_a_corner_pushed_through_is_reported():
    points = CUBE.copy()
    points[6] = [0.4, 0.4, 0.1]  # past the plane of the corners beside it
    value = np.linalg.det(points[[5, 7, 2]] - points[6])
    assert value < 0
    assert least_jacobian(CUBE, points, HEX) <= -abs(value)
    points[6] = [0.8, 0.8, 0.8]
    assert least_jacobian(CUBE, points, HEX) > 0


@pytest.mark.parametrize(("moved", "folds"), [(0.2, False), (0.3, True)])
def test_a_tet_folds_where_an_edge_s_node_passes_its_quarter(moved: float, folds: bool):
    points = TET.copy()
    points[4] -= [moved, 0, 0]  # the edge is x = t + 4 moved t (t - 1) long, of slope 1 - 4 moved at its start
    least = least_jacobian(TET, points, QUADRATIC, 1e-4)
    assert least == pytest.approx(1 - 4 * moved, abs=1e-4)
    assert (least < 0) is folds


def test_a_tet_that_folds_between_its_nodes_is_reported():
    assert nodal_volume(SWOLLEN, QUADRATIC).min() > 0.05
    assert scanned(TET, SWOLLEN, QUADRATIC) - 0.01 <= least_jacobian(TET, SWOLLEN, QUADRATIC) < -0.02


@pytest.mark.parametrize(("limit", "value"), [("MAX_SUBDIVISIONS", 0), ("MAX_SUBDIVISIONS", 1), ("MAX_PIECES", 0)])
def test_it_is_still_a_bound_when_the_subdivision_is_cut_short(limit: str, value: int, monkeypatch: pytest.MonkeyPatch):
    for rest, points, cells in [(CUBE, np.array(FOLDED[1]) / 10, HEX), (TET, SWOLLEN, QUADRATIC)]:
        full = least_jacobian(rest, points, cells, 1e-4)
        with monkeypatch.context() as short:
            short.setattr(jacobian, limit, value)
            assert least_jacobian(rest, points, cells, 1e-4) < full - 1e-3


def test_meshes_without_volume_or_finite_points_are_refused():
    rest, cells = mesh(8)
    points = rest.copy()
    points[4, 1] = np.nan
    assert least_jacobian(rest, points, cells) == -np.inf
    with pytest.raises(ValueError, match="8 elements have no volume at rest"):
        least_jacobian(rest * [1, 1, 0], rest, cells)
