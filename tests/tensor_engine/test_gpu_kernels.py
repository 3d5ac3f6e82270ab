"""What a GPU computes in one launch is what NumPy and PyTorch compute; without a GPU by Triton's interpreter."""

import os
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

if not torch.cuda.is_available():
    os.environ["TRITON_INTERPRET"] = "1"  # read when the kernels are defined
pytest.importorskip("triton")

from tacgen.tensor_engine import device as devices
from tacgen.tensor_engine import gpu_blocks, gpu_contact, gpu_distance, gpu_elements, gpu_tangents, load_step, products
from tacgen.tensor_engine.elements import Hexes
from tacgen.tensor_engine.inversion import FoldingBarriers
from tacgen.tensor_engine.shapes import Shapes
from tensor_engine import test_elements
from tensor_engine.test_contact import SHAPES, Case

pytestmark = pytest.mark.slow  # the interpreter takes seconds
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"


def close(found: torch.Tensor, wanted: torch.Tensor, relative: float = 1e-11) -> bool:
    """Whether two are equal but for rounding, scene by scene."""
    size = wanted.abs().flatten(1).amax(1).clamp(min=1e-3)
    return bool(((found.cpu() - wanted).abs().flatten(1).amax(1) <= relative * size).all())


def test_distances_of_all_shapes() -> None:
    shapes = Shapes.of(list(SHAPES.values()), torch.float64, "cpu")
    p = torch.tensor(np.random.default_rng(2).normal(size=(len(SHAPES), 140, 3))) * torch.tensor([0.5, 0.5, 0.3])
    p[-1, 3] = torch.nan
    parts = (part.to(DEVICE) for part in (p, shapes.kinds, shapes.table, shapes.values))
    both = list(zip(gpu_distance.distances(*parts), shapes.distance(p), strict=True))
    nowhere = both[0][1].isnan()
    assert torch.equal(both[0][0].isnan().cpu(), nowhere)
    assert nowhere.sum() == 1
    for found, wanted in both:
        found[nowhere.to(DEVICE)] = wanted[nowhere] = 0.0
        assert close(found, wanted, 1e-10)


@pytest.mark.skipif(DEVICE == "cuda", reason="the plain formulas run on a CPU alone")
@pytest.mark.parametrize(("slide", "friction"), [(0.05, True), (0.002, True), (0.05, False)],
                         ids=["sliding", "sticking", "frictionless"])  # fmt: skip
def test_forces_tangents_and_merits(slide: float, friction: bool) -> None:
    case = Case(slide, friction)
    areas = case.many.areas.clone()
    areas[:, 3] = 0.0  # a facet that does not exist
    many, r = case.many.only(case.many.conn, areas, case.many.anchor), np.random.default_rng(3)
    wanted = many.evaluate(case.X)
    names = ("gap", "at", "normal", "N", "force", "tangent", "definite")
    for name, found in zip(names, gpu_contact.forces(many, case.X), strict=True):
        assert close(found, getattr(wanted, name)), name
    p, fractions = (
        torch.tensor(r.normal(size=case.X.shape)) * 0.3,
        0.5 ** torch.arange(3).double().expand(len(areas), -1),
    )
    merits = gpu_contact.merits(many, case.X, p, fractions, wanted)
    assert close(merits, many.merits(case.X, p, fractions, wanted))
    assert merits.shape == (len(areas), 3)


@pytest.mark.parametrize("size", [3, 16, 29, 41, 64])
def test_inverses_of_gpu_blocks(size: int) -> None:
    r = np.random.default_rng(size)
    A = torch.tensor(r.normal(size=(3, size, size)), dtype=torch.float32)
    A = A @ A.mT + size * torch.eye(size)
    B = A + 0.3 * torch.tensor(r.normal(size=A.shape), dtype=torch.float32)
    around = torch.zeros(3, size + 5, size + 4)
    block = around[:, 2 : size + 2, 1 : size + 1]
    block.copy_(torch.tril(A) + 7 * torch.triu(torch.ones_like(A), 1))  # only the lower triangle is read
    around = around.to(DEVICE)
    block = around[:, 2 : size + 2, 1 : size + 1]
    assert gpu_blocks.lower_inverse(block).tolist() == [0, 0, 0]
    assert close(block, torch.linalg.inv(torch.linalg.cholesky(A)), 2e-6)
    assert float(around[:, :2].abs().sum() + around[:, :, 0].abs().sum()) == 0.0
    inverse = B.clone().to(DEVICE)
    gpu_blocks.inverse(inverse)
    assert close(inverse, torch.linalg.inv(B), 2e-5)


@pytest.mark.filterwarnings("ignore:invalid value encountered")
def test_the_first_minor_that_is_not_positive_is_told() -> None:
    A = torch.eye(40).repeat(2, 1, 1)
    A[0, 35, 35] = -1.0
    assert gpu_blocks.lower_inverse(A.to(DEVICE)).tolist() == [36, 0]


@pytest.mark.skipif(DEVICE == "cuda", reason="the plain formulas run on a CPU alone")
def test_energy_and_forces_of_cells() -> None:
    """Of scenes in other slots than their own, with void cells and one that is inverted."""
    case = test_elements.Case()
    exists = case.exists.clone()
    exists[2, 5:] = False
    slots = torch.tensor([2, 0, 4, 3, 1])
    hexes = Hexes.on(case.topology, case.X, exists, case.laws).rows(slots)
    x, there = case.tensor(case.x)[slots], case.tensor(case.taken)[slots]
    x[4, 0] += 1.5
    taken, ahead = torch.zeros(5, 27, 8, 3, 3, dtype=x.dtype), torch.zeros(5, 27, 8, dtype=x.dtype)
    taken[slots] = hexes.deformation(there)
    J, forces = hexes.gradient(x)
    energy, found, parts = gpu_elements.states(hexes, x, True)
    assert torch.isinf(hexes.energy(x)).tolist() == torch.isinf(energy.sum(1)).tolist() == [False] * 4 + [True]
    assert close(energy.sum(1)[:4, None], hexes.energy(x)[:4, None])
    assert torch.equal(gpu_elements.states(hexes, x, False)[0], energy)
    for name, one, other in (
        ("J", found, J),
        ("forces", case.topology.at_nodes(parts), forces),
        ("predicted", gpu_elements.predictions(hexes, there, x, taken), hexes.predicted(there, x, taken)),
    ):
        assert close(one[:4], other[:4]), name
    ahead[slots] = hexes.predicted(there, x, taken)
    mixed = case.topology.at_nodes(gpu_elements.states(hexes, x, True, ahead, taken)[2])
    wanted = hexes.mixed_forces(x, ahead, taken)
    assert close(mixed[:4], wanted[:4])
    assert not close(mixed[:4], forces[:4], 1e-3)


@pytest.mark.skipif(DEVICE == "cuda", reason="the plain formulas run on a CPU alone")
@pytest.mark.parametrize("mixed", [False, True])
def test_tangents_of_cells(mixed: bool) -> None:
    case, slots = test_elements.Case(), torch.tensor([3, 1, 0])
    hexes = Hexes.on(case.topology, case.X, case.exists, case.laws).rows(slots)
    x, there = case.tensor(case.x)[slots], case.tensor(case.taken)[slots]
    J = hexes.predicted(there, x, case.many.deformation(case.tensor(case.taken))) if mixed else None
    F, wanted = hexes.tangents(x, J)
    found, K = gpu_tangents.tangents(hexes, x, J)
    assert close(found, F)
    assert close(K, wanted, 1e-6)


def test_lowest_jacobians_of_cells() -> None:
    case = test_elements.Case()
    x, one = case.tensor(case.x), torch.ones(case.exists.shape, dtype=torch.float64)
    barriers = FoldingBarriers.on(case.topology, case.X, one, one)
    assert close(gpu_elements.lowest(case.topology, x, barriers.rest), barriers._lowest(x, barriers.rest))


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


@pytest.mark.skipif(DEVICE == "cuda", reason="the plain formulas run on a CPU alone")
def test_the_barrier_of_cells() -> None:
    """Of scenes in other slots than their own, with an inverted cell and a void one."""
    case, slots = test_elements.Case(), torch.tensor([3, 4, 0, 1])
    mu, times = torch.linspace(0.1, 0.4, case.exists.numel()).double().view(case.exists.shape), torch.arange(5.0) + 1
    volume = case.many.weights.sum(-1)
    volume[0, 0] = 0.0
    barrier = FoldingBarriers.on(case.topology, case.X, volume, mu).rows(slots)
    x = (case.X + 0.6 * (case.tensor(test_elements.folded(case)) - case.X))[slots]
    x[1, 0] += 1.0
    x[2, case.cells[0][0][0]] += 0.4  # of the void cell alone
    energy, parts = gpu_elements.folds(barrier, x, times.double(), True)
    wanted, forces = barrier.energy(x, times.double()), barrier.gradient(x, times.double())
    assert torch.isinf(energy.sum(1)).tolist() == torch.isinf(wanted).tolist() == [False, True, False, False]
    assert close(energy.sum(1)[[0, 2, 3], None], wanted[[0, 2, 3], None])
    assert (wanted > 0).tolist() == [True, True, False, True]  # the only folded cell of slot 0 is void
    assert close(gpu_elements.at_nodes(case.topology, parts)[[0, 2, 3]], forces[[0, 2, 3]])
    parts = torch.tensor(np.random.default_rng(8).normal(size=parts.shape))
    assert close(gpu_elements.at_nodes(case.topology, parts), case.topology.at_nodes(parts))
    assert torch.equal(gpu_elements.folds(barrier, x, times.double(), False)[0], energy)


@pytest.mark.skipif(DEVICE == "cuda", reason="the plain formulas run on a CPU alone")
@pytest.mark.parametrize(("drop", "reach", "many"), [(0.05, 0.5, 0), (0.6, 9.0, 1), (0.6, 0.7, 7)])
def test_points_that_pass_through(drop: float, reach: float, many: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Too deep, and out on the other side; in few parts and in many."""
    case, s = Case(), torch.arange(len(SHAPES))
    contact, far = case.many, torch.tensor([0.1, 0.05, 0.4])
    old = replace(contact, position=contact.position + far, rotation=contact.rotation[:, [1, 0, 2]])
    t = SimpleNamespace(offset=contact.offset, h_x=case.X, h_rotation=old.rotation, h_position=old.position)
    t.h_gap = old.gap_at_nodes(case.X)
    t.h_gap[1] += 9.0  # not near
    b = SimpleNamespace(t=t, reach=torch.full((len(s),), reach).double(), face=lambda s, offset: contact)
    x = case.X + torch.tensor([0.1, 0.0, drop])
    wanted = load_step.blocked(b, s, x)
    monkeypatch.setattr(devices, "by_kernels", lambda x: True)
    assert close(contact.gap_at_nodes(x), contact.gap(contact.points(x)))
    assert load_step.blocked(b, s, x).tolist() == wanted.tolist()
    assert wanted.sum() == many
