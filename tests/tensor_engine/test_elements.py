"""Batched element kernels: the CPU's to rounding, per law, per scene, and in single precision within bounds."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.needs import needs

torch = needs("torch")

from helpers.small import block, full

from tacgen.fem.assembly import pattern
from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import elements as cpu_elements
from tacgen.fem.folding_barrier import FoldingBarrier as OneFolding
from tacgen.fem.jacobian import least_jacobian as one_least_jacobian
from tacgen.fem.materials import EXAMPLE_LAWS, Law, Stiffened
from tacgen.fem.projection import Projection
from tacgen.tensor_engine.elements import Hexes, Topology
from tacgen.tensor_engine.inversion import FoldingBarriers, least_jacobian

torch.set_num_threads(1)
LAWS: dict[str, Law] = {**EXAMPLE_LAWS, "stiffened": Stiffened(EXAMPLE_LAWS["mooney_rivlin"], 1.7)}
SCENES = list(LAWS)  # one scene for each law
SHAKEN = 0.06  # motion of nodes [mm], of elements 1/3 mm wide: strains of some 40 %


class Case:
    """A block of hexes of each law, each with nodes of its own, deformed at random."""

    def __init__(self, shake: float = SHAKEN) -> None:
        self.points, self.cells = zip(*(block(3, 0.2, seed) for seed in range(len(SCENES))), strict=True)
        n, cells = len(self.points[0]), self.cells[0]
        r = np.random.default_rng(5)
        self.x = [p + r.uniform(-shake, shake, p.shape) for p in self.points]
        self.taken = [p + r.uniform(-shake, shake, p.shape) for p in self.points]
        self.pattern = pattern([cells], np.ones((n, 3), bool))
        self.one = [
            Elastic.on(self.pattern, cpu_elements(p, cells), law)
            for p, law in zip(self.points, LAWS.values(), strict=True)
        ]
        self.topology = Topology.shared(cells, np.zeros((0, 4), int), n)
        self.exists = torch.ones(len(SCENES), len(cells), dtype=torch.bool)
        table = np.array([[law.coefficients] * len(cells) for law in LAWS.values()])
        self.laws = torch.tensor(table)
        self.X = torch.tensor(np.array(self.points))
        self.many = Hexes.on(self.topology, self.X, self.exists, self.laws)

    def tensor(self, x: list[np.ndarray]) -> object:
        return torch.tensor(np.array(x), dtype=self.X.dtype)

    def assembled(self, K: object, row: int) -> np.ndarray:
        """The dense stiffness (3n, 3n) of the cells' tangents of one scene."""
        out, cells = np.zeros((self.pattern.size,) * 2), self.cells[0]
        for conn, block_ in zip(cells, K[row].numpy(), strict=True):
            dofs = (3 * conn[:, None] + np.arange(3)).ravel()
            out[np.ix_(dofs, dofs)] += block_
        return out


@pytest.fixture(scope="module")
def case() -> Case:
    return Case()


@pytest.mark.parametrize("row", range(len(SCENES)), ids=SCENES)
def test_energy_forces_and_mixed_pressure_are_those_of_one_scene(case: Case, row: int) -> None:
    here, there = case.tensor(case.x), case.tensor(case.taken)
    one, x, taken = case.one[row], case.x[row], case.taken[row]
    alone, other = one.evaluate(x), one.evaluate(taken)
    assert float(case.many.energy(here)[row]) == pytest.approx(alone.energy, rel=1e-11)
    forces = one.forces(alone, len(x))
    scale = np.abs(forces).max()
    assert case.many.gradient(here)[1][row].numpy() == pytest.approx(forces, abs=1e-11 * scale)
    predicted = one.predicted(other, alone, other.F)
    F = case.many.deformation(there)
    many = case.many.predicted(there, here, F)
    assert many[row].numpy() == pytest.approx(predicted, abs=1e-12)
    mixed = one.mixed_forces(alone, predicted, other.F, len(x))
    assert np.abs(mixed - forces).max() > 1e-3 * scale  # the pressures differ
    assert case.many.mixed_forces(here, many, F)[row].numpy() == pytest.approx(mixed, abs=1e-10 * scale)


@pytest.mark.parametrize("projection", Projection)
@pytest.mark.parametrize("mixed", [False, True])
def test_tangents_are_those_of_one_scene(case: Case, projection: Projection, mixed: bool) -> None:
    here, there = case.tensor(case.x), case.tensor(case.taken)
    J = case.many.predicted(there, here, case.many.deformation(there)) if mixed else None
    K = case.many.tangents(here, J, projection)[1]
    for row, one in enumerate(case.one):
        data = np.zeros(len(case.pattern.indices))
        alone = one.evaluate(case.x[row])
        one.add_tangent(alone, data, projection, None if J is None else J[row].numpy())
        whole = full(case.pattern, data)
        assert case.assembled(K, row) == pytest.approx(whole, abs=1e-9 * np.abs(whole).max()), SCENES[row]


def test_an_inverted_element_has_infinite_energy_in_its_scene_alone(case: Case) -> None:
    x = case.tensor(case.x)
    x[1, 0] += 1.5
    assert torch.isinf(case.many.energy(x)).tolist() == [False, True, False, False, False]


def test_void_cells_have_no_energy_forces_or_stiffness(case: Case) -> None:
    exists = case.exists.clone()
    exists[2, 5:] = False
    some = Hexes.on(case.topology, case.X, exists, case.laws)
    x = case.tensor(case.x)
    alone = replace(case.one[2], elements=cpu_elements(case.points[2], case.cells[2][:5]), slots=None)
    point = alone.evaluate(case.x[2])
    assert float(some.energy(x)[2]) == pytest.approx(point.energy, rel=1e-11)
    assert some.gradient(x)[1][2].numpy() == pytest.approx(alone.forces(point, len(case.X[2])), abs=1e-11)
    assert not some.tangents(x)[1][2, 5:].any()
    x[2, case.cells[0][-1, 6]] -= 1.5  # a corner of a void cell alone
    assert float(torch.linalg.det(some.deformation(x)[2]).min()) < 0
    assert float(some.energy(x)[2]) == pytest.approx(point.energy, rel=1e-11)


def test_single_precision_is_within_its_rounding(case: Case) -> None:
    x = case.tensor(case.x)
    many, one = case.many.tangents(x, dtype=torch.float32)[1], case.many.tangents(x)[1]
    assert many.dtype == torch.float32
    assert float((many - one).abs().max() / one.abs().max()) < 2e-6


def test_scenes_in_other_slots_than_their_own(case: Case) -> None:
    slots = torch.tensor([2, 0, 4, 3, 1])
    x, there = case.tensor(case.x), case.tensor(case.taken)
    taken = case.many.deformation(there)
    ahead = case.many.predicted(there, x, taken)
    some = case.many.rows(slots)
    for found, wanted in (
        (some.energy(x[slots]), case.many.energy(x)),
        (some.gradient(x[slots])[1], case.many.gradient(x)[1]),
        (some.predicted(there[slots], x[slots], taken), ahead),
        (some.mixed_forces(x[slots], ahead, taken), case.many.mixed_forces(x, ahead, taken)),
        (some.tangents(x[slots], ahead)[1], case.many.tangents(x, ahead)[1]),
    ):
        assert torch.equal(found, wanted[slots])


def folded(case: Case) -> list[np.ndarray]:
    """Some corners pushed far into their cells: J is small there, and not at the integration points."""
    x = [p.copy() for p in case.points]
    for row in range(len(x)):
        x[row][case.cells[0][row][0]] += 0.1 + 0.02 * row
    return x


@pytest.mark.parametrize("projection", [Projection.NONE, Projection.FULL])
def test_the_barrier_against_inversion_is_that_of_one_scene(case: Case, projection: Projection) -> None:
    x, times = folded(case), torch.tensor([1.0, 4.0, 1.0, 16.0, 1.0], dtype=torch.float64)
    mu = torch.tensor([[law.mu] * len(case.cells[0]) for law in LAWS.values()], dtype=torch.float64)
    barrier = FoldingBarriers.on(case.topology, case.X, case.many.weights.sum(-1), mu).stiffened(times)
    found, energy = barrier.evaluate(case.tensor(x)), barrier.energy(case.tensor(x))
    assert set(found.items[:, 0].tolist()) == set(range(len(SCENES)))
    forces, K = barrier.gradient(case.tensor(x)), torch.zeros(len(SCENES), len(case.cells[0]), 24, 24).double()
    found.add_tangents(K, projection)
    for row, one in enumerate(case.one):
        alone = OneFolding.on(case.pattern, case.points[row], one.elements, one.law.mu).stiffened(float(times[row]))
        data = np.zeros(len(case.pattern.indices))
        alone.add_hessian(x[row], data, projection)
        whole, g = full(case.pattern, data), alone.gradient(x[row])
        assert float(energy[row]) == pytest.approx(alone.value(x[row]), rel=1e-10)
        assert forces[row].numpy() == pytest.approx(g, abs=1e-10 * np.abs(g).max())
        assert case.assembled(K, row) == pytest.approx(whole, abs=1e-9 * np.abs(whole).max())


@pytest.mark.parametrize("shake", [0.02, 0.08, 0.3])
def test_the_certified_bound_is_that_of_one_scene(shake: float) -> None:
    case = Case(shake)
    many = least_jacobian(case.X, case.tensor(case.x), case.topology, case.exists)
    alone = [one_least_jacobian(p, x, case.cells[0]) for p, x in zip(case.points, case.x, strict=True)]
    assert many.numpy() == pytest.approx(np.array(alone), abs=1e-12)


def test_the_bound_is_of_the_cells_that_exist_and_of_finite_points(case: Case) -> None:
    x = case.tensor(case.x)
    x[0, case.cells[0][0, 0]] += 1.0
    x[1, 0] = torch.nan
    exists = case.exists.clone()
    exists[0, 0] = False
    around = [k for k, cell in enumerate(case.cells[0]) if case.cells[0][0, 0] in cell]
    exists[0, around] = False
    bound = least_jacobian(case.X, x, case.topology, exists)
    assert float(bound[0]) > 0
    assert float(bound[1]) == -np.inf
    assert float(least_jacobian(case.X, x, case.topology, case.exists)[0]) < 0
