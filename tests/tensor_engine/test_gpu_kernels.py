"""What a GPU computes in one launch is what NumPy and PyTorch compute; without a GPU by Triton's interpreter."""

import os
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from helpers.needs import needs

torch = needs("torch")

if not torch.cuda.is_available():
    os.environ["TRITON_INTERPRET"] = "1"  # read when the kernels are defined
triton = needs("triton")

from torch.multiprocessing.reductions import StorageWeakRef
from torch.utils._python_dispatch import TorchDispatchMode

from tacgen.tensor_engine import (
    condensed,
    dense,
    gpu_blocks,
    gpu_fronts,
    gpu_substitution,
    multifrontal,
    products,
)
from tacgen.tensor_engine.condensed import Condensed
from tacgen.tensor_engine.dissection import dissected
from tacgen.tensor_engine.fronts import Fronts, Panel
from tacgen.tensor_engine.grids import GridPattern
from tensor_engine.compiling import interpreted_and_compiled
from tensor_engine.test_multifrontal import matrices

pytestmark = pytest.mark.slow  # the interpreter takes seconds
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"


@pytest.fixture(autouse=True)
def interpreted(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with interpreted_and_compiled(monkeypatch):
        yield


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
    assert gpu_blocks.lower_inverse(block).tolist() == [0, 0, 0]
    assert close(block, torch.linalg.inv(torch.linalg.cholesky(A)), 2e-6)
    assert float(around[:, :2].abs().sum() + around[:, :, 0].abs().sum()) == 0.0


@pytest.mark.parametrize(("size", "columns"), [(3, 1), (32, 33), (41, 1), (64, 70), (150, 2)])
def test_solutions_by_elimination(size: int, columns: int) -> None:
    r = np.random.default_rng(size)
    A = torch.tensor(r.normal(size=(3, size, size)), dtype=torch.float32)
    A = A + A.mT + 6 * size**0.5 * torch.eye(size)
    A[1, size - 1, size - 1] = -1.0
    A[2] += torch.tensor(r.normal(size=(size, size)), dtype=torch.float32)
    B = torch.tensor(r.normal(size=(3, size, columns)), dtype=torch.float32)
    W = torch.full((3, size + 2, size + columns + 3), 7.0)
    W[:, 1:-1, 2:-1] = torch.cat([A, B], 2)
    W = W.to(DEVICE)
    positive = gpu_blocks.eliminate(W[:, 1:-1, 2:-1], size)
    assert positive.tolist()[:2] == [True, False]
    assert close(W[:, 1:-1, size + 2 : -1].contiguous(), torch.linalg.solve(A, B), 2e-5)
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
        block = -(-n // gpu_blocks.ELIMINATED_ROWS) * gpu_blocks.ELIMINATED_ROWS
        A[k, block:, block:] = torch.nan
    W = torch.cat([A, B], 2).to(DEVICE)
    given = (own + first).to(DEVICE), slots.to(DEVICE)
    assert gpu_blocks.eliminate(W, size, given, first).all()
    assert close(W[..., size:].contiguous(), wanted, 2e-5)
    W = torch.cat([torch.eye(size).repeat(4, 1, 1), B], 2).to(DEVICE)
    W[0, 19, 19] = W[1, 36, 36] = W[2, 99, 99] = -1.0  # the last of a scene's own
    assert gpu_blocks.eliminate(W, size, given, first).tolist() == [False, False, False, True]


@pytest.mark.filterwarnings("ignore:invalid value encountered")
@pytest.mark.parametrize("size", [40, 130])
def test_the_first_minor_that_is_not_positive_is_told(size: int) -> None:
    A = torch.eye(size).repeat(2, 1, 1)
    A[0, size - 5, size - 5] = A[0, size - 3, size - 3] = -1.0
    assert gpu_blocks.lower_inverse(A.to(DEVICE)).tolist() == [size - 4, 0]


def test_fronts_of_several_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the updates of one child, in another order for each of two scenes, with padding; into larger panels."""
    r, nodes, w = np.random.default_rng(4), 50, 25
    A = torch.tensor(r.normal(size=(2, 3 * nodes, 3 * nodes)), dtype=torch.float32)
    A = A @ A.mT + 3 * nodes * torch.eye(3 * nodes)
    places = torch.tensor(np.array([r.permutation(nodes)[: nodes - 2] for _ in range(2)]), dtype=torch.int32)
    places[1, [w - 1, -1]] = -2
    both = []
    for device, kernels in (("cpu", False), (DEVICE, True)):
        monkeypatch.setattr(dense, "fused", lambda x, kernels=kernels: kernels)
        one = torch.zeros(1, 1, dtype=torch.int32, device=device)
        fronts = Fronts(places[:, None, None].to(device), one, one + 3 * nodes, None, w)
        panel = Panel(*(torch.full((3, 1, n, 80), torch.nan, device=device) for n in (80, 90)))
        S = torch.full((2, 1, 69, 69), torch.nan, device=device)
        slots = torch.tensor([2, 0], device=device)
        info = multifrontal.eliminate(
            fronts, A.new_empty(2, 0, device=device), A.flatten(1).to(device), panel, slots, S, True
        )
        assert info.tolist() == [[0], [0]]
        both.append((panel.inverse[slots], panel.below[slots], S))
    for wanted, found in zip(*both, strict=True):
        assert close(found, wanted, 1e-5)
    assert torch.equal(S, S.mT)


class Launches(TorchDispatchMode):
    """Counts kernels of PyTorch and, in the place of Triton's, calls of them."""

    NONE = (
        "empty",
        "view",
        "alias",
        "slice",
        "select",
        "expand",
        "unsqueeze",
        "transpose",
        "permute",
        "as_strided",
        "detach",
    )

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):  # type: ignore[no-untyped-def]
        self.count += not any(name in func.__name__ for name in self.NONE)
        return func(*args, **(kwargs or {}))

    def __getitem__(self, grid: object) -> Callable[..., None]:
        return self._launched

    def _launched(self, *args: object, **kwargs: object) -> None:
        self.count += 1


@pytest.fixture
def unlaunched(monkeypatch: pytest.MonkeyPatch) -> tuple[Launches, Condensed]:
    """Factors of two scenes whose kernels are counted, and do nothing."""
    tree, counted = dissected(GridPattern((18, 18, 5))), Launches()
    monkeypatch.setattr(dense, "fused", lambda x: True)
    monkeypatch.setattr(condensed, "slot_times", gpu_blocks.slot_times)
    kernels = type(gpu_blocks._rows)
    for module in (gpu_blocks, gpu_fronts, gpu_substitution):
        for name in [name for name, part in vars(module).items() if isinstance(part, kernels)]:
            monkeypatch.setattr(module, name, counted)
    factors = Condensed(multifrontal.Multifrontal(tree), 2)
    factors.reserve(16)
    return counted, factors


def test_launches_of_a_factor_and_of_substitutions(unlaunched: tuple[Launches, Condensed]) -> None:
    """Few, whatever the number of scenes: a recording of small calls takes the time of its launches."""
    counted, factors = unlaunched
    tree = factors.solver.tree
    slots, elements = torch.arange(2), torch.zeros(2, len(tree.pattern.hexes), 24, 24)
    nodes = torch.as_tensor(tree.pattern.patch[:16]).expand(2, -1)
    counts = []
    for work in (
        lambda: factors.factor(slots, elements, nodes, 16),
        lambda: factors.forward(slots, torch.zeros(2, tree.pattern.size, 3), 16),
        lambda: factors.expand(slots, torch.zeros(2, 48), torch.zeros(2, tree.pattern.size, 3)),
    ):
        counted.count = 0
        with counted:
            work()
        counts.append(counted.count)
    assert [found <= most for found, most in zip(counts, (184, 28, 30), strict=True)] == [True] * 3, counts


def test_memory_of_a_factor(unlaunched: tuple[Launches, Condensed], monkeypatch: pytest.MonkeyPatch) -> None:
    """Calls are as large as `work` has room for, besides entries and tangents."""
    _, factors = unlaunched
    tree, new, made, most = factors.solver.tree, torch.Tensor.new_empty, [], [0]

    def new_empty(*args: Any, **kwargs: Any) -> torch.Tensor:
        out = new(*args, **kwargs)
        made.append((StorageWeakRef(out.untyped_storage()), out.numel()))
        most.append(sum(n for storage, n in made if not storage.expired()))
        return out

    data = torch.zeros(2, factors.solver.pairs + 1, 9)
    monkeypatch.setattr(torch.Tensor, "new_empty", new_empty)
    factors.solver.factor(data, factors._panels, torch.arange(2))
    assert 0.95 <= max(most) / (2 * tree.work) <= 1.05


def test_factors_condensed_to_nodes_and_substitutions(monkeypatch: pytest.MonkeyPatch) -> None:
    """With children in two groups, void cells, a slot that is asked for twice as recordings do, and scenes with nodes
    of their own."""
    pattern, slots = GridPattern((8, 7, 2)), torch.tensor([2, 0, 2])
    tree = dissected(pattern, leaf=3, quartered=5)
    assert max(len(level.groups) for level in tree.levels) == 2
    elements, _ = matrices(pattern, batch=2, void=(0, 1, 2))
    elements = elements[[0, 1, 0]].float()
    nodes = torch.as_tensor(pattern.patch)[torch.tensor([[0, 2, 5], [4, 1, 0], [0, 2, 5]])]
    nodes[1, 2] = -1
    r = np.random.default_rng(5)
    g, u = (torch.tensor(r.normal(size=(3, *shape)), dtype=torch.float32) for shape in ((pattern.size, 3), (9,)))
    g[2], u[2] = g[0], u[0]
    both = []
    for device, kernels in (("cpu", False), (DEVICE, True)):
        monkeypatch.setattr(dense, "fused", lambda x, kernels=kernels: kernels)
        kept = Condensed(multifrontal.Multifrontal(tree, device), 3)
        kept.reserve(4)
        kept._inverse.fill_(torch.nan)  # of what a slot had before
        kept._coupling.fill_(torch.nan)
        at, K, some, b, v = (part.to(device) for part in (slots, elements, nodes, g, u))
        good, S = kept.factor(at, K, some, 2)
        assert good.all()
        y, load = kept.forward(at, b, 3)
        p = kept.expand(at, v, y)
        both.append((S, *(part for panel in kept._panels
                     for part in (panel.inverse[at], panel.below[at])),
                     kept._inverse[at], kept._coupling[at], y, load, p))  # fmt: skip
    for wanted, found in zip(*both, strict=True):
        assert close(found, wanted, 3e-5)


@pytest.mark.parametrize("shape", [(6, 70, 100), (6, 3, 20, 5), (6, 3, 0, 5)])
@pytest.mark.parametrize("transposed", [False, True])
def test_products_of_matrices_in_slots(shape: tuple[int, ...], transposed: bool) -> None:
    r = np.random.default_rng(7)
    A = torch.tensor(r.normal(size=(*shape[:-1], shape[-1] + 7)), dtype=torch.float32)[..., : shape[-1]]
    x = torch.tensor(r.normal(size=(2, *shape[1:-2], shape[-2 if transposed else -1])))
    slots = torch.tensor([4, 1])
    wanted = products.slot_times(A, slots, x, transposed)
    parts = (part.to(DEVICE) for part in (A, slots, x))
    found = gpu_blocks.slot_times(*parts, transposed)
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
    wanted = products.slot_times(parts, slots, x, transposed)
    found = gpu_blocks.slot_times(
        *(part.to(DEVICE) for part in (A, slots, x)), transposed, (down.to(DEVICE), across.to(DEVICE))
    )
    assert close(found, wanted, 1e-12)
