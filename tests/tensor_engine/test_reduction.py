"""Schur complements reduced to what contact acts on: answers of the whole system, for scenes of unlike widths."""

import numpy as np
import pytest
from helpers.needs import needs

torch = needs("torch")


from tacgen.tensor_engine.dense import eliminate
from tacgen.tensor_engine.elements import ends_of
from tacgen.tensor_engine.reduction import reduced, solved, with_points

Array = np.ndarray
SIZES, WIDTH = (18, 24, 12), 24  # unknowns of each scene, and of the widest


def systems() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """S, active unknowns, facets, shape functions at two points of each, and tangents there which are not symmetric."""
    r = np.random.default_rng(3)
    S, active = np.tile(np.eye(WIDTH), (3, 1, 1)), np.zeros((3, WIDTH), bool)
    conn = np.array([[[0, 1, 2, 3], [2, 3, 4, 5]], [[0, 1, 2, 3], [4, 5, 6, 7]], [[0, 1, 2, 3], [0, 0, 0, 0]]])
    D = r.normal(size=(3, 2, 2, 3, 3)) + 3 * np.eye(3)
    D[2, 1] = 0.0
    for k, n in enumerate(SIZES):
        A = r.normal(size=(n, n))
        S[k, :n, :n] = A @ A.T + np.eye(n)
        D[k, 1] *= k == 1
        active[k, (3 * conn[k, : 1 + (k == 1)].ravel()[:, None] + np.arange(3)).ravel()] = True
    N = r.uniform(0.1, 0.4, (2, 4))
    return (*(torch.tensor(part) for part in (S, active, conn, N, D)),)


def exist() -> torch.Tensor:
    return torch.arange(WIDTH) < torch.tensor(SIZES)[:, None]


@pytest.mark.parametrize(("a", "e"), [(24, 12), (25, 17)])
def test_contact_on_the_reduced_system_has_the_answer_of_the_whole(a: int, e: int) -> None:
    S, active, conn, N, D = systems()
    part, definite = reduced(S, active, exist(), a, e)
    assert definite.all()
    assert part.G.shape == (3, e, e)
    there = D.flatten(2).abs().amax(2, keepdim=True) > 0
    facets = conn.int(), ends_of(torch.where(there, conn, WIDTH // 3), WIDTH // 3 + 1), N, D
    K = with_points(part.K, part.slots, part.kept, part.place, *facets)
    b = torch.tensor(np.random.default_rng(0).normal(size=(3, WIDTH)))
    x, good = part.solve(K, b, False)
    assert good.all()
    everywhere = torch.arange(WIDTH).expand(3, -1)
    whole = with_points(S, part.slots, everywhere, everywhere, *facets)
    assert (whole - whole.mT).abs().max() > 0.1
    wanted = torch.linalg.solve(whole, b[..., None]).squeeze(-1)
    assert torch.where(exist(), wanted, 0.0).numpy() == pytest.approx(x.numpy(), abs=1e-10)


def test_what_is_eliminated_must_be_positive_definite_and_a_symmetric_system_too() -> None:
    S, active, *_ = systems()
    S[0, 17, 17] = -1.0  # eliminated
    S[1, 0, 0] = -50.0  # kept
    part, definite = reduced(S, active, exist(), WIDTH, WIDTH)
    assert definite.tolist() == [False, True, True]
    _, good = part.solve(part.K, torch.ones(3, WIDTH, dtype=S.dtype), True)
    assert good.tolist()[1:] == [False, True]


def test_systems_that_have_no_good_solution_without_pivots_are_solved_with_them() -> None:
    r = np.random.default_rng(1)
    K = torch.tensor(r.normal(size=(3, 400, 400)) + 40 * np.eye(400), dtype=torch.float32)
    K[1, 5] = 0.0
    K[2, :192, :192] = 0.0  # a block on the diagonal
    b = torch.tensor(r.normal(size=(3, 400, 1)), dtype=torch.float32)
    x, good = solved(K, b)
    assert good.tolist() == [True, False, True]
    for k in (0, 2):
        assert (K[k] @ x[k]).numpy() == pytest.approx(b[k].numpy(), abs=1e-3)


@pytest.mark.parametrize("where", [0, 130, 360])
def test_elimination_tells_which_matrices_are_positive_definite(where: int) -> None:
    r = np.random.default_rng(2)
    A = r.normal(size=(2, 400, 400))
    A = A @ A.swapaxes(1, 2) + np.eye(400)
    A[1, where, where] = -1.0
    W = torch.tensor(np.concatenate([A, np.ones((2, 400, 1))], 2))
    assert eliminate(W, 400).tolist() == [True, False]
    x, good = solved(torch.tensor(A), torch.ones(2, 400, 1, dtype=torch.float64), symmetric=True)
    assert good.tolist() == [True, False]
    assert x[0].numpy() == pytest.approx(np.linalg.solve(A[0], np.ones((400, 1))), rel=1e-6)


def test_systems_without_unknowns_have_a_solution() -> None:
    x, good = solved(torch.zeros(2, 0, 0), torch.zeros(2, 0, 1))
    assert x.shape == (2, 0, 1)
    assert good.all()
