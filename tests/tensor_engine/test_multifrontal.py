"""Factors of many matrices of one pattern: solves, Schur complements and refinement, on tangents of pressed gels."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from tacgen.tensor_engine.dissection import dissected
from tacgen.tensor_engine.grids import GridPattern
from tacgen.tensor_engine.multifrontal import Multifrontal, refined

PATTERN = GridPattern((10, 9, 3))
torch.set_num_threads(1)


def matrices(pattern, batch=2, void=()):
    """Element blocks of random symmetric positive definite matrices, nodes without an element, and the whole matrices."""
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
    blocks = whole.reshape(batch, -1, 8, 3, 8, 3).transpose(3, 4)
    return blocks, (~used).expand(batch, -1), dense


@pytest.mark.parametrize(("cells", "quarters"), [((10, 9, 3), True), ((10, 9, 3), False), ((7, 13, 2), True)])
def test_solves_and_schur_complements_are_those_of_the_whole_matrix(cells, quarters):
    pattern = GridPattern(cells)
    blocks, void, K = matrices(pattern, void=(0, 1, 2, 30, 31))
    solver = Multifrontal(dissected(pattern, quarters=quarters), dtype=torch.float64)
    factor = solver.factor(solver.assembled(blocks, void))
    free = torch.as_tensor(pattern.free).repeat_interleave(3)
    patch = (3 * torch.as_tensor(pattern.patch)[:, None] + torch.arange(3)).ravel()
    inner = free.clone()
    inner[patch] = False
    assert not factor.indefinite.any()
    A, B, C = K[:, inner][:, :, inner], K[:, inner][:, :, patch], K[:, patch][:, :, patch]
    assert torch.allclose(factor.S, C - B.mT @ torch.linalg.solve(A, B), rtol=1e-9, atol=1e-9)
    b = torch.randn((2, pattern.size, 3), dtype=torch.float64)
    x = factor.solve(b, lambda load: torch.linalg.solve(factor.S, load))
    assert torch.allclose((K @ x.reshape(2, -1, 1))[:, free, 0], b.reshape(2, -1)[:, free], rtol=1e-9, atol=1e-9)
    assert (x[:, ~torch.as_tensor(pattern.free)] == 0).all()
    assert torch.allclose(solver.product(solver.assembled(blocks, void), x).reshape(2, -1)[:, free], b.reshape(2, -1)[:, free])
