"""Schur complements of a batch, reduced to each scene's own unknowns in contact: as condensation.Schur has them."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from tacgen.mechanics import condensation
from tacgen.tensor_engine.schur import colours, reduced

torch.set_num_threads(1)
BATCH, SIZE, D = 3, 60, torch.float64
FACETS = [[0, 1, 2, 3], [2, 3, 4, 5], [10, 11, 12, 13], [4, 5, 6, 7]]


@pytest.fixture
def system():
    """Stiffnesses, that of the second scene indefinite where nothing touches; at rest; and unknowns in contact."""
    generator = torch.Generator().manual_seed(1)
    half = torch.randn((BATCH + 1, SIZE, SIZE), generator=generator, dtype=D)
    S = half @ half.mT / SIZE + 0.2 * torch.eye(SIZE, dtype=D)
    S[1, 40, 40] -= 3.0
    active = torch.zeros((BATCH, SIZE), dtype=torch.bool)
    active[0, :9] = active[1, 4:30] = active[2, 20:25] = True
    return S[:BATCH], S[BATCH:].expand(BATCH, -1, -1) * 2, active


def on_a_core(S, rest, active):
    out = condensation.Schur(S.numpy(), rest.numpy)
    out.activate(active.numpy())
    return out


def test_solutions_and_damping_are_those_of_the_solver_on_a_core(system):
    S, rest, active = system
    found = reduced(S, rest, torch.zeros(BATCH, dtype=D), active)
    b = torch.randn((BATCH, SIZE), dtype=D)
    contact = torch.randn((BATCH, SIZE, SIZE), dtype=D)
    contact *= active[:, :, None] & active[:, None, :]
    K = found.K + torch.stack([contact[i][kept[:, None], kept] for i, kept in enumerate(found.kept)])
    x, failed = found.solve(K, b)
    assert not failed.any()
    assert not found.indefinite.any()
    for i in range(BATCH):
        same = on_a_core(S[i], rest[i], active[i])
        assert found.damping[i] == same.damping
        part = contact[i][active[i]][:, active[i]].numpy()
        assert x[i].numpy() == pytest.approx(same.solver(same.reduced + part)(b[i].numpy()), rel=1e-9, abs=1e-9)
    assert (found.damping > 0).tolist() == [False, True, False]
    assert torch.allclose(found.times(x) + (contact @ x[:, :, None]).squeeze(-1), b)


def test_blocks_of_facets_are_added_wherever_their_unknowns_are_kept(system):
    S, rest, active = system
    found = reduced(S, rest, torch.zeros(BATCH, dtype=D), active)
    dofs = torch.tensor(FACETS)
    blocks = torch.randn((BATCH, len(dofs), 4, 4), dtype=D)
    whole = torch.zeros((BATCH, SIZE, SIZE), dtype=D)
    for f, at in enumerate(dofs):
        whole[:, at[:, None], at] += blocks[:, f]
    K = found.stiffness(blocks, dofs, colours(dofs))
    for i, kept in enumerate(found.kept):
        assert torch.allclose(K[i], found.K[i] + whole[i][kept[:, None], kept])


def test_facets_of_a_set_share_no_unknown():
    dofs = torch.tensor(FACETS)
    sets = colours(dofs)
    assert sorted(np.concatenate(sets)) == [0, 1, 2, 3]
    assert all(dofs[each].unique().numel() == dofs[each].numel() for each in sets)


def test_a_symmetric_stiffness_that_is_not_definite_has_no_answer(system):
    S, rest, active = system
    found = reduced(S, rest, torch.zeros(BATCH, dtype=D), active)
    K = torch.eye(found.K.shape[-1], dtype=D).repeat(BATCH, 1, 1)
    K[2, -1, -1] = -1.0
    b = torch.ones((BATCH, SIZE), dtype=D)
    assert found.solve(K, b, symmetric=True)[1].tolist() == [False, False, True]
    assert found.solve(K, b)[1].tolist() == [False, False, False]


def test_solutions_in_single_precision_are_refined_to_double(system):
    S, rest, active = system
    found = reduced(S.float(), rest.float(), torch.zeros(BATCH), active)
    K, b = found.K.double(), torch.randn((BATCH, SIZE), dtype=D)
    b.scatter_(1, found.dropped, 0.0)
    x, _ = found.solve(K, b, rounds=3)
    kept = x.gather(1, found.kept)
    assert torch.allclose((K @ kept[:, :, None]).squeeze(-1), b.gather(1, found.kept), rtol=1e-12, atol=1e-12)


def test_damping_ends_where_nothing_helps(system):
    S, rest, active = system
    found = reduced(S, 0 * rest, torch.zeros(BATCH, dtype=D), active)
    assert found.indefinite.tolist() == [False, True, False]
