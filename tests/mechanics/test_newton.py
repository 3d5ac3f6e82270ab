"""Newton: its order, its ends, and what it must never accept."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from helpers.small import Load, block

from tacgen.fem.assembly import Pattern, pattern
from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import elements
from tacgen.fem.materials import NeoHooke
from tacgen.fem.potential import Potential, Projection, Total
from tacgen.mechanics.linear_solvers import Cholmod
from tacgen.mechanics.newton import Solution, Status, minimise

Array = np.ndarray


@dataclass(frozen=True)
class Spring:
    """k/2 |x - target|^2; `tell` bends what it says of itself."""

    pattern: Pattern
    target: float
    stiffness: float = 2.0
    tell: Callable[[Array], Array] = lambda g: g

    def value(self, x: Array) -> float:
        return float(self.stiffness / 2 * ((x - self.target) ** 2).sum())

    def gradient(self, x: Array) -> Array:
        return self.tell(self.stiffness * (x - self.target))

    def add_hessian(self, x: Array, data: Array, projection: Projection) -> None:
        data[self.pattern.indptr[:-1]] += self.stiffness

    def max_step(self, x: Array, p: Array) -> float:
        return 1.0


@dataclass(frozen=True)
class Watched:
    """A potential, with the places Newton accepted (where it asks for the slope) and the energies it tried."""

    inner: Potential
    accepted: list[Array] = field(default_factory=list)
    tried: list[float] = field(default_factory=list)

    def value(self, x: Array) -> float:
        self.tried.append(self.inner.value(x))
        return self.tried[-1]

    def gradient(self, x: Array) -> Array:
        self.accepted.append(x)
        return self.inner.gradient(x)

    def add_hessian(self, x: Array, data: Array, projection: Projection) -> None:
        self.inner.add_hessian(x, data, projection)

    def max_step(self, x: Array, p: Array) -> float:
        return self.inner.max_step(x, p)


def held_block(n: int, lift: float) -> tuple[Elastic, Array, Pattern]:
    """A block between two plates, the upper one moved by `lift` and everything else left behind."""
    points, cells = block(n, 0.2)
    free = np.ones((len(points), 3), bool)
    plates = (points[:, 2] == 0) | (points[:, 2] == 1)
    free[plates] = False
    pat = pattern([cells], free)
    x = points.copy()
    x[points[:, 2] == 1, 2] += lift
    return Elastic.on(pat, elements(points, cells), NeoHooke(0.05, 1.0)), x, pat


def run(potential: Potential, x: Array, pat: Pattern, **how: object) -> Solution:
    return minimise(potential, x, pat, Cholmod(pat), **{"xtol": 1e-9, "near": 0.05, **how})  # type: ignore[arg-type]


def single() -> Pattern:
    return pattern([np.arange(8)[None]], np.ones((8, 3), bool))


def test_it_converges_quadratically_to_where_the_forces_vanish() -> None:
    potential, x, pat = held_block(3, 0.4)
    found = run(potential, x, pat, xtol=1e-11)
    assert found.status is Status.converged
    assert np.abs(potential.gradient(found.x).ravel()[pat.free]).max() < 1e-13
    lengths = np.array([s.length for s in found.steps])
    tail = lengths[(lengths < 0.1) & (lengths > 1e-13)]
    orders = np.log(tail[2:] / tail[1:-1]) / np.log(tail[1:-1] / tail[:-2])
    assert len(tail) >= 3, lengths
    assert 1.7 < orders[-1] < 2.4, (lengths, orders)
    assert [s.energy for s in found.steps] == sorted((s.energy for s in found.steps), reverse=True)
    held = np.ones(x.size, bool)
    held[pat.free] = False
    assert (found.x.ravel()[held] == x.ravel()[held]).all()


def test_it_projects_while_far_and_not_when_near() -> None:
    potential, x, pat = held_block(3, 0.4)
    found = run(potential, x, pat)
    assert found.steps[0].projected
    assert not found.steps[-1].projected


def test_an_inversion_is_never_accepted() -> None:
    """A block in a well-fitting box, pushed down by a dead load for which the linear answer is thrice its height."""
    points, cells = block(3)
    free = np.zeros((len(points), 3), bool)
    free[points[:, 2] > 0, 2] = True
    pat = pattern([cells], free)
    elastic = Elastic.on(pat, elements(points, cells), NeoHooke(0.05, 1.0))
    watched = Watched(Total((elastic, Load(np.where(points[:, 2:] == 1, [0, 0, -0.2], 0.0)))))
    found = run(watched, points, pat)
    assert found.status is Status.converged
    assert np.isinf(watched.tried).any(), "no trial turned an element inside out: the test sees nothing"
    for state in [*watched.accepted, found.x]:
        assert elastic.evaluate(state).J.min() > 0
    assert 0.05 < found.x[points[:, 2] == 1, 2].mean() < 0.6


def test_refresh_is_asked_and_its_answer_used() -> None:
    """A potential that follows the answer: x settles at half of x + 1, that is at 1."""
    pat, asked = single(), []

    def refresh(x: Array) -> Potential | None:
        asked.append(x[0, 0])
        return None if abs(2 * x[0, 0] - 1 - x[0, 0]) < 1e-6 else Spring(pat, (x[0, 0] + 1) / 2)

    found = run(Spring(pat, 0.96), np.full((8, 3), 0.97), pat, xtol=1e-3, refresh=refresh)
    assert found.status is Status.converged
    assert found.x == pytest.approx(np.ones((8, 3)), abs=2e-6)
    assert asked[:2] == pytest.approx([0.96, 0.98])
    assert len(asked) == len(found.steps)


def test_refresh_waits_until_newton_is_near() -> None:
    pat, asked = single(), []
    found = run(Spring(pat, 1.0), np.zeros((8, 3)), pat, refresh=lambda x: asked.append(x))
    assert found.status is Status.converged
    assert [s.length for s in found.steps] == pytest.approx([1.0])
    assert len(asked) == 1  # not after the step of 1 mm


def test_it_says_that_it_ran_out_of_steps() -> None:
    potential, x, pat = held_block(2, 0.4)
    found = run(potential, x, pat, max_steps=2)
    assert found.status is Status.out_of_steps
    assert len(found.steps) == 2


def test_a_refresh_without_end_runs_out_of_steps() -> None:
    pat = single()
    found = run(Spring(pat, 0.0), np.zeros((8, 3)), pat, refresh=lambda x: Spring(pat, x[0, 0] + 0.01), max_steps=30)
    assert found.status is Status.out_of_steps


def test_it_says_that_it_stalled() -> None:
    """The energy rises where its slope says that it falls."""
    pat = single()
    lying = Spring(pat, 1.0, tell=lambda g: -g)
    found = run(lying, np.zeros((8, 3)), pat)
    assert found.status is Status.stalled
    assert (found.x == 0).all()


def test_it_says_that_something_is_not_finite() -> None:
    pat = single()
    assert run(Spring(pat, 1.0, stiffness=-1.0), np.zeros((8, 3)), pat).status is Status.nonfinite
    broken = Spring(pat, 1.0, tell=lambda g: g * np.nan)
    assert run(broken, np.zeros((8, 3)), pat).status is Status.nonfinite


def test_a_sum_of_potentials_is_one() -> None:
    pat = single()
    total = Total((Spring(pat, 0.0, 1.0), Spring(pat, 1.0, 3.0)))
    assert isinstance(total, Potential)
    assert run(total, np.zeros((8, 3)), pat).x == pytest.approx(np.full((8, 3), 0.75))
