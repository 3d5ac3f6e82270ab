"""Factors of many matrices of one pattern: solves, Schur complements and refinement, on tangents of pressed gels."""

import numpy as np
import pytest
from helpers.needs import needs

torch = needs("torch")

from helpers import presses

from tacgen.geometry.analytic_sdf import SphereSdf
from tacgen.mechanics.bulk import Bulk
from tacgen.mechanics.linear_solvers import best
from tacgen.tensor_engine import dense
from tacgen.tensor_engine.dissection import dissected
from tacgen.tensor_engine.grids import GridPattern
from tacgen.tensor_engine.multifrontal import Multifrontal
from tensor_engine.batches import embedded

torch.set_num_threads(1)


def matrices(pattern, batch=2, void=()):
    """Element tangents of random symmetric positive definite matrices, and the whole matrices; void: cells without."""
    generator = torch.Generator().manual_seed(3)
    hexes = torch.as_tensor(pattern.hexes)
    half = torch.randn((batch, len(hexes), 24, 24), generator=generator, dtype=torch.float64)
    whole = half @ half.mT + 24 * torch.eye(24, dtype=torch.float64)
    exists = torch.ones(len(hexes), dtype=torch.bool)
    exists[list(void)] = False
    whole = whole * exists[:, None, None]
    used = torch.zeros(pattern.size, dtype=torch.bool)
    used[hexes[exists].ravel()] = True
    dofs = (3 * hexes[:, :, None] + torch.arange(3)).reshape(len(hexes), 24)
    dense = torch.zeros((batch, 3 * pattern.size, 3 * pattern.size), dtype=torch.float64)
    for e, at in enumerate(dofs):
        dense[:, at[:, None], at] += whole[:, e]
    dense[:, *torch.where(torch.diag((~used).repeat_interleave(3)))] = 1.0
    return whole, dense


def factors(solver, data):
    """How to solve with the factors of matrices, kept in slots in another order; S, and which are indefinite."""
    slots = torch.arange(len(data)).flip(0)
    panels = solver.empty(len(data))
    S, bad = solver.factor(data, panels, slots)
    L = torch.linalg.cholesky(S)

    def solve(b):
        y = solver.forward(panels, slots, b)
        load = y[:, solver.patch].flatten(1)
        return solver.backward(panels, slots, y, torch.cholesky_solve(load[:, :, None], L).squeeze(-1))

    return solve, S, bad


def elements_of(whole, nodes, pattern, data):
    """Element tangents (e, 24, 24) of a whole pattern whose sum is the matrix of `data`, the entries of the mesh's
    pattern, whose nodes have other numbers there: each block of two nodes is given wholly to the first element that has
    both."""
    n = pattern.nodes
    i, j, slots = pattern.pairs // n, pattern.pairs % n, pattern.blocks
    upper = np.where(slots >= 0, data[slots], 0.0)
    turned = upper[np.searchsorted(pattern.pairs, j * n + i)].transpose(0, 2, 1)
    both = np.where((slots >= 0) & (i == j)[:, None, None], 0.0, turned) + upper
    hexes = whole.hexes
    row, column = np.repeat(hexes, 8, axis=1).ravel(), np.tile(hexes, 8).ravel()
    keys, first = np.unique(row * whole.size + column, return_index=True)
    out = np.zeros((row.size, 3, 3))
    out[first[np.searchsorted(keys, nodes[i] * whole.size + nodes[j])]] = both
    return out.reshape(len(hexes), 8, 8, 3, 3).transpose(0, 1, 3, 2, 4).reshape(len(hexes), 24, 24)


def product(elements, hexes, x):
    """The sums of element tangents (B, e, 24, 24) of hexes (e, 8) times x (B, n, 3)."""
    parts = elements @ x[:, hexes].flatten(2)[..., None]
    return torch.zeros_like(x).index_add_(1, hexes.flatten(), parts.reshape(len(x), -1, 3))


def refined(solve, times, b, rounds):
    """x with K x = b by iterative refinement (Wilkinson 1963): `solve` is approximate, `times` gives K x in the
    precision of b (B, n, 3), in which x is returned."""
    x = solve(b).to(b.dtype)
    for _ in range(rounds):
        x = x + solve(b - times(x)).to(b.dtype)
    return x


@pytest.mark.parametrize(
    ("cells", "how"),
    [((10, 9, 3), {}), ((10, 9, 3), {"quartered": 0, "most_groups": 1}), ((7, 13, 2), {"quartered": 99, "leaf": 2})],
)
def test_solves_and_schur_complements_are_those_of_the_whole_matrix(cells, how, monkeypatch):
    for name in ("MAX_DIRECT_ROWS", "UPDATE_STRIP_COLUMNS"):  # small fronts take every path
        monkeypatch.setattr(dense, name, 36)
    pattern = GridPattern(cells)
    elements, K = matrices(pattern, void=(0, 1, 2, 30, 31))
    solver = Multifrontal(dissected(pattern, **how), dtype=torch.float64)
    data = solver.assembled(elements)
    solve, S, bad = factors(solver, data)
    free = torch.as_tensor(pattern.free).repeat_interleave(3)
    patch = (3 * torch.as_tensor(pattern.patch)[:, None] + torch.arange(3)).ravel()
    inner = free.clone()
    inner[patch] = False
    assert not bad.any()
    A, B, C = K[:, inner][:, :, inner], K[:, inner][:, :, patch], K[:, patch][:, :, patch]
    assert torch.allclose(S, C - B.mT @ torch.linalg.solve(A, B), rtol=1e-9, atol=1e-9)
    b = torch.randn((2, pattern.size, 3), dtype=torch.float64)
    x = solve(b)
    assert torch.allclose((K @ x.reshape(2, -1, 1))[:, free, 0], b.reshape(2, -1)[:, free], rtol=1e-9, atol=1e-9)
    assert (x[:, ~torch.as_tensor(pattern.free)] == 0).all()


@pytest.fixture(scope="module")
def pressed():
    """The tangent of a nearly incompressible gel under a ball, from the engine on a core: entries and whole matrix."""
    made = presses.scene(
        SphereSdf(2.0), presses.poses([(0.3, 0.1, -0.6)]), pad=presses.gel(7.0, 6.0, 2.0, nu=0.499), edge=0.7
    )
    whole, place = embedded(made)
    found = presses.run(made)
    problem, x = found.problem, found.states[-1].x
    bulk = Bulk(problem.elastic, problem.folding)
    data = bulk.at(x).stiffness(problem.pattern)
    return whole, place.nodes, problem.pattern, data


def test_single_precision_is_refined_to_double_on_the_tangent_of_a_pressed_gel(pressed):
    whole, nodes, pattern, data = pressed
    solver = Multifrontal(dissected(whole))
    elements = torch.as_tensor(elements_of(whole, nodes, pattern, data))[None]
    solve, S, bad = factors(solver, solver.assembled(elements))
    assert S.dtype == torch.float32
    assert not bad.any()
    b = np.random.default_rng(0).normal(size=len(pattern.free))
    right = torch.zeros(3 * whole.size, dtype=torch.float64)
    dofs = 3 * nodes[pattern.free // 3] + pattern.free % 3
    right[dofs] = torch.as_tensor(b)
    right = right.view(1, -1, 3)

    used = whole.free & np.isin(np.arange(whole.size), nodes)
    hexes, free = torch.as_tensor(whole.hexes), torch.as_tensor(used)[:, None]

    direct = best(pattern)
    direct.factor(data)
    answer = direct.solve(b)
    errors = []
    for rounds in range(5):
        x = refined(solve, lambda x: product(elements, hexes, x) * free, right, rounds).ravel()[dofs].numpy()
        errors.append(np.abs(x - answer).max() / np.abs(answer).max())
    assert errors[0] > 1e-7
    assert errors[-1] < 1e-12
