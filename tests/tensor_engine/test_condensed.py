"""Tangents condensed to each scene's own nodes, and kept in slots."""

import pytest
from helpers.needs import needs

torch = needs("torch")

from tacgen.tensor_engine.condensed import Condensed
from tacgen.tensor_engine.dissection import dissected
from tacgen.tensor_engine.grids import GridPattern
from tacgen.tensor_engine.multifrontal import Multifrontal

from .test_multifrontal import matrices

torch.set_num_threads(1)
PATTERN = GridPattern((10, 9, 3))
D = torch.float64


@pytest.fixture(scope="module")
def kept():
    """Three matrices in slots 4, 0 and 2 of 5, condensed to different nodes, factorised in two calls."""
    elements, K = matrices(PATTERN, batch=3, void=(0, 1, 2))
    patch = torch.as_tensor(PATTERN.patch)
    own = [patch[[0, 3, 7]], patch[[5, 2]], patch[torch.randperm(len(patch))[:9]]]
    nodes = torch.full((3, 9), -1)
    for row, some in zip(nodes, own, strict=True):
        row[: len(some)] = some
    condensed, slots = Condensed(Multifrontal(dissected(PATTERN), dtype=D), 5), torch.tensor([4, 0, 2])
    condensed.reserve(9)
    first = condensed.factor(slots[:2], elements[:2], nodes[:2, :3])
    second = condensed.factor(slots[2:], elements[2:], nodes[2:], 9)
    return condensed, slots, K, own, [*first[1], *second[1]], torch.cat([first[0], second[0]])


def parts(nodes):
    """Unknowns of these nodes, and the other free ones."""
    c = (3 * nodes[:, None] + torch.arange(3)).ravel()
    others = torch.as_tensor(PATTERN.free).repeat_interleave(3)
    others[c] = False
    return c, torch.nonzero(others).ravel()


def test_schur_complements_are_those_of_the_whole_matrix(kept):
    _, _, K, own, S, ok = kept
    assert ok.all()
    for matrix, nodes, found in zip(K, own, S, strict=True):
        c, o = parts(nodes)
        exact = matrix[c][:, c] - matrix[c][:, o] @ torch.linalg.solve(matrix[o][:, o], matrix[o][:, c])
        assert torch.allclose(found[: len(c), : len(c)], exact, rtol=1e-9, atol=1e-9)
        assert (found[len(c) :] == torch.eye(len(found), dtype=D)[len(c) :]).all()


def test_substitutions_are_those_of_the_whole_matrix_in_any_order_of_slots(kept):
    condensed, slots, K, own, _, _ = kept
    which = torch.tensor([2, 0, 1])
    g, u = torch.randn((3, PATTERN.size, 3), dtype=D), torch.randn((3, 27), dtype=D)
    for i, scene in enumerate(which):
        u[i, 3 * len(own[scene]) :] = 0
    y, load = condensed.forward(slots[which], g, 9)
    p = condensed.expand(slots[which], u, y)
    alone = condensed.expand(slots[which], u, torch.zeros_like(y))
    for i, scene in enumerate(which):
        (c, o), matrix, b = parts(own[scene]), K[scene], g[i].ravel()
        k = len(c)
        inverse = torch.linalg.inv(matrix[o][:, o])
        assert torch.allclose(load[i, :k], b[c] - matrix[c][:, o] @ inverse @ b[o])
        assert (load[i, k:] == 0).all()
        assert torch.allclose(p[i].ravel()[o], -inverse @ (b[o] + matrix[o][:, c] @ u[i, :k]))
        assert torch.allclose(p[i].ravel()[c], u[i, :k])
        assert torch.allclose(alone[i].ravel()[o], -inverse @ matrix[o][:, c] @ u[i, :k])
        assert (p[i, ~torch.as_tensor(PATTERN.free)] == 0).all()


def test_a_matrix_that_is_indefinite_away_from_the_contact_is_told(kept):
    condensed, _, _, own, S, _ = kept
    elements, _ = matrices(PATTERN, batch=3, void=(0, 1, 2))
    nodes = own[0][None].expand(3, -1)
    top = PATTERN.hexes[:, 4:] == int(PATTERN.patch[18])  # not condensed, in the patch
    e, a = (int(index[0]) for index in top.nonzero())
    elements[1, e, 3 * (a + 4), 3 * (a + 4)] -= 1e4
    elements[2, 3 * 4, 0, 0] -= 1e6  # a cell at the side
    elements[2, 3 * 4, 14, 14] -= 1e6
    ok, found = condensed.schur(elements, nodes)
    assert ok.tolist() == [True, False, False]
    assert torch.allclose(found[0], S[0])
