"""Elimination by blocks, factors of fronts and products in slots, against PyTorch's whole matrices.

On a GPU, if there is one, of its kernels, in which a warp eliminates a block; else of the same formulas on a core.
"""

from typing import Any

import numpy as np
import pytest
import warp as wp
from helpers.needs import needs

torch = needs("torch")

from torch.multiprocessing.reductions import StorageWeakRef

from tacgen.physics import elimination, runtime
from tacgen.tensor_engine import dense, multifrontal, products
from tacgen.tensor_engine.condensed import Condensed
from tacgen.tensor_engine.dissection import dissected
from tacgen.tensor_engine.grids import GridPattern
from tacgen.tensor_engine.multifrontal import Fronts, Panel

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
SIZE = (elimination.ON_GPU if DEVICE == "cuda" else elimination.ON_CORE[4]).size


def close(found: torch.Tensor, wanted: torch.Tensor, relative: float = 1e-11) -> bool:
    """Whether two are equal but for rounding, scene by scene."""
    size = wanted.abs().flatten(1).amax(1).clamp(min=1e-3)
    return bool(((found.cpu() - wanted).abs().flatten(1).amax(1) <= relative * size).all())


@pytest.mark.parametrize("size", [3, 16, 29, 41, 64, 70, 150])
def test_inverse_factors_by_blocks(size: int) -> None:
    r = np.random.default_rng(size)
    A = torch.tensor(r.normal(size=(3, size, size)), dtype=torch.float32)
    A = A @ A.mT + size * torch.eye(size)
    around = torch.zeros(3, size + 5, size + 4)
    block = around[:, 2 : size + 2, 1 : size + 1]
    block.copy_(torch.tril(A) + 7 * torch.triu(torch.ones_like(A), 1))  # only the lower triangle is read
    around = around.to(DEVICE)
    block = around[:, 2 : size + 2, 1 : size + 1]
    assert dense.invert_factor(block).tolist() == [0, 0, 0]
    assert close(block, torch.linalg.inv(torch.linalg.cholesky(A)), 2e-6)
    assert float(around[:, :2].abs().sum() + around[:, :, 0].abs().sum()) == 0.0


SINGLE, DOUBLE = (torch.float32, 2e-5), (torch.float64, 1e-11)  # on a GPU numbers are single
SIZES = [*((n, m, *SINGLE) for n, m in ((3, 1), (32, 33), (41, 1), (64, 70), (150, 2)))]
SIZES += [(n, 2, *DOUBLE) for n in (1, 97, 400, 700)] if DEVICE == "cpu" else []


@pytest.mark.parametrize(("size", "columns", "dtype", "tol"), SIZES)
def test_solutions_by_elimination(size: int, columns: int, dtype: torch.dtype, tol: float) -> None:
    r = np.random.default_rng(size)
    A = torch.tensor(r.normal(size=(3, size, size)), dtype=dtype)
    A = A + A.mT + 6 * size**0.5 * torch.eye(size)
    A[1, size - 1, size - 1] = -1.0
    A[2] += torch.tensor(r.normal(size=(size, size)), dtype=dtype)
    B = torch.tensor(r.normal(size=(3, size, columns)), dtype=dtype)
    W = torch.full((3, size + 2, size + columns + 3), 7.0, dtype=dtype)
    W[:, 1:-1, 2:-1] = torch.cat([A, B], 2)
    W = W.to(DEVICE)
    positive = dense.eliminate(W[:, 1:-1, 2:-1], size)
    assert positive.tolist()[:2] == [True, False]
    assert close(W[:, 1:-1, size + 2 : -1].contiguous(), torch.linalg.solve(A, B), tol)
    W[:, 1:-1, 2:-1] = 7.0
    assert (W == 7.0).all()


@pytest.mark.parametrize("first", [0, 20])
def test_rows_beyond_those_of_a_scene_are_not_read(first: int) -> None:
    """But for those of its last block; of the second half of a matrix, too."""
    r, size, slots, own = np.random.default_rng(0), 100, torch.tensor([1, 3, 4, 0]), torch.tensor([0, 20, 7, 37, 100])
    A, B = (torch.tensor(r.normal(size=(4, size, n)), dtype=torch.float32) for n in (size, 1))
    A += 6 * size**0.5 * torch.eye(size)
    wanted = torch.zeros(4, size, 1)
    for k, n in enumerate(own[slots].tolist()):
        A[k, n:], A[k, :, n:], B[k, n:] = 0.0, 0.0, 0.0
        A[k, range(n, size), range(n, size)] = 1.0
        wanted[k] = torch.linalg.solve(A[k], B[k])
        block = (
            -(-n // (dense.ON_GPU if DEVICE == "cuda" else dense.ON_CORE[4]).size)
            * (dense.ON_GPU if DEVICE == "cuda" else dense.ON_CORE[4]).size
        )
        A[k, block:, block:] = torch.nan
    W = torch.cat([A, B], 2).to(DEVICE)
    given = (own + first).to(DEVICE), slots.to(DEVICE)
    assert dense.eliminate(W, size, given, first).all()
    assert close(W[..., size:].contiguous(), wanted, 2e-5)
    W = torch.cat([torch.eye(size).repeat(4, 1, 1), B], 2).to(DEVICE)
    W[0, 19, 19] = W[1, 36, 36] = W[2, 99, 99] = -1.0  # the last of a scene's own
    assert dense.eliminate(W, size, given, first).tolist() == [False, False, False, True]


@pytest.mark.filterwarnings("ignore:invalid value encountered")
@pytest.mark.parametrize("size", [40, 130])
def test_the_first_minor_that_is_not_positive_is_told(size: int) -> None:
    A = torch.eye(size).repeat(2, 1, 1)
    A[0, size - 5, size - 5] = A[0, size - 3, size - 3] = -1.0
    assert dense.invert_factor(A.to(DEVICE)).tolist() == [size - 4, 0]


def test_fronts_of_several_tiles() -> None:
    """Of the updates of one child, in another order for each of two scenes, with padding; into larger panels."""
    r, nodes, w = np.random.default_rng(4), 50, 25
    A = torch.tensor(r.normal(size=(2, 3 * nodes, 3 * nodes)), dtype=torch.float32)
    A = A @ A.mT + 3 * nodes * torch.eye(3 * nodes)
    places = torch.tensor(np.array([r.permutation(nodes)[: nodes - 2] for _ in range(2)]), dtype=torch.int32)
    places[1, [w - 1, -1]] = -2
    one = torch.zeros(1, 1, dtype=torch.int32, device=DEVICE)
    fronts = Fronts(places[:, None, None].to(DEVICE), one, one + 3 * nodes, None, w)
    panel = Panel(*(torch.full((3, 1, n, 80), torch.nan, device=DEVICE) for n in (80, 90)))
    S = torch.full((2, 1, 69, 69), torch.nan, device=DEVICE)
    slots = torch.tensor([2, 0], device=DEVICE)
    nothing = torch.zeros(2, 0, device=DEVICE)
    info = multifrontal.eliminate(fronts, nothing, A.flatten(1).to(DEVICE), panel, slots, S, True)
    assert info.tolist() == [[0], [0]]
    dofs = (3 * places.clamp(min=0).long()[..., None] + torch.arange(3)).flatten(1)
    padded = (places == -2).repeat_interleave(3, 1)
    M = torch.stack([each[at][:, at] for each, at in zip(A.double(), dofs, strict=True)])
    M = torch.where(padded[:, :, None] | padded[:, None], torch.diag_embed(padded.double()), M)
    k = 3 * w
    L = torch.linalg.cholesky(M)[:, :, :k]
    wanted = torch.zeros(2, 80, 80), torch.zeros(2, 90, 80)
    wanted[0][:, :k, :k], wanted[1][:, : M.shape[1] - k, :k] = torch.linalg.inv(L[:, :k]), L[:, k:]
    assert close(panel.inverse[slots][:, 0], wanted[0], 1e-5)
    assert close(panel.below[slots][:, 0], wanted[1], 1e-5)
    assert close(S[:, 0], M[:, k:, k:] - L[:, k:] @ L[:, k:].mT, 1e-5)
    assert torch.equal(S, S.mT)


def test_launches_of_a_factor_and_of_substitutions(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few, whatever the number of scenes: a recording of small calls takes the time of its launches."""
    tree, found = dissected(GridPattern((18, 18, 5))), list[str]()
    for module in (dense, multifrontal, products):
        monkeypatch.setattr(module, "launch", lambda kernel, *_: found.append(kernel.key))
    monkeypatch.setattr(dense, "ON_CORE", dict.fromkeys((4, 8), elimination.ON_GPU))
    factors = Condensed(multifrontal.Multifrontal(tree), 2)
    factors.reserve(16)
    slots, elements = torch.arange(2), torch.zeros(2, len(tree.pattern.hexes), 24, 24)
    nodes = torch.as_tensor(tree.pattern.patch[:16]).expand(2, -1)
    counts = []
    for work in (
        lambda: factors.factor(slots, elements, nodes, 16),
        lambda: factors.forward(slots, torch.zeros(2, tree.pattern.size, 3), 16),
        lambda: factors.expand(slots, torch.zeros(2, 48), torch.zeros(2, tree.pattern.size, 3)),
    ):
        found.clear()
        work()
        counts.append(len(found))
    assert [found <= most for found, most in zip(counts, (120, 26, 22), strict=True)] == [True] * 3, counts


def test_memory_of_a_factor(monkeypatch: pytest.MonkeyPatch) -> None:
    """Calls are as large as `work` has room for, besides entries and tangents."""
    tree = dissected(GridPattern((18, 18, 5)))
    monkeypatch.setattr(dense, "ON_CORE", dict.fromkeys((4, 8), elimination.ON_GPU))
    for module in (dense, multifrontal):
        monkeypatch.setattr(module, "launch", lambda *_: None)
    factors = Condensed(multifrontal.Multifrontal(tree), 2)
    new, made, most = torch.Tensor.new_empty, [], [0]

    def new_empty(*args: Any, **kwargs: Any) -> torch.Tensor:
        out = new(*args, **kwargs)
        made.append((StorageWeakRef(out.untyped_storage()), out.numel()))
        most.append(sum(n for storage, n in made if not storage.expired()))
        return out

    data = torch.zeros(2, factors.solver.pairs + 1, 9)
    monkeypatch.setattr(torch.Tensor, "new_empty", new_empty)
    factors.solver.factor(data, factors._panels, torch.arange(2))
    assert 0.95 <= max(most) / (2 * tree.work) <= 1.05


@pytest.mark.parametrize("shape", [(6, 70, 100), (6, 3, 20, 5), (6, 3, 0, 5)])
@pytest.mark.parametrize("transposed", [False, True])
def test_products_of_matrices_in_slots(shape: tuple[int, ...], transposed: bool) -> None:
    r = np.random.default_rng(7)
    A = torch.tensor(r.normal(size=(*shape[:-1], shape[-1] + 7)), dtype=torch.float32)[..., : shape[-1]]
    x = torch.tensor(r.normal(size=(2, *shape[1:-2], shape[-2 if transposed else -1])))
    slots = torch.tensor([4, 1])
    some = A[slots].to(x.dtype)
    wanted = ((some.mT if transposed else some) @ x[..., None]).squeeze(-1)
    parts = (part.to(DEVICE) for part in (A, slots, x))
    found = products.slot_times(*parts, transposed)
    assert found.shape == wanted.shape
    assert not wanted.numel() or close(found, wanted, 1e-12)


@pytest.mark.parametrize("transposed", [False, True])
def test_products_of_parts_of_matrices(transposed: bool) -> None:
    """Whatever is beyond the rows and columns that are used is neither read nor written."""
    r = np.random.default_rng(8)
    A = torch.tensor(r.normal(size=(4, 90, 300)), dtype=torch.float32)
    down, across, slots = torch.tensor([90, 7, 0, 33]), torch.tensor([300, 299, 5, 40]), torch.tensor([3, 1, 2])
    x = torch.tensor(r.normal(size=(3, 90 if transposed else 300)))
    parts = A.clone()
    for k in range(4):
        parts[k, down[k] :] = parts[k, :, across[k] :] = 0.0
        A[k, down[k] :] = A[k, :, across[k] :] = torch.nan
    some = parts[slots].to(x.dtype)
    wanted = ((some.mT if transposed else some) @ x[..., None]).squeeze(-1)
    found = products.slot_times(
        *(part.to(DEVICE) for part in (A, slots, x)), transposed, (down.to(DEVICE), across.to(DEVICE))
    )
    assert close(found, wanted, 1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("module", ["tacgen.elimination", runtime.BATCHES])
def test_kernels_of_batches_compile_for_a_gpu(module: str, tmp_path: Any) -> None:
    """For sm_90, the H100's, by a machine that has none."""
    runtime.load(runtime.BATCHES, "cpu")
    made = wp.compile_aot_module(wp.get_module(module), arch=90, module_dir=tmp_path)
    assert made[0].stat().st_size > 10_000
