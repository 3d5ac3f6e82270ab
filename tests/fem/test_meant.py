"""The pressure that steps are meant to give leads to the same answer, in fewer steps the less volume may change."""

import numpy as np
import pytest

from tacgen.fem.assembly import carried, deformation, pattern
from tacgen.fem.elements import hexes
from tacgen.fem.linear import Cholmod
from tacgen.fem.materials import NeoHooke
from tacgen.fem.meant import Meant
from tacgen.fem.newton import Solution, Status, minimise
from tacgen.fem.potentials import LAST, Elastic

from .small import block, dense

Array = np.ndarray
MU = 0.05


def held_block(kappa: float) -> tuple[Elastic, Array, Cholmod]:
    """A block between two plates; its points."""
    points, cells = block(4, 0.1)
    free = np.ones((len(points), 3), bool)
    free[(points[:, 2] == 0) | (points[:, 2] == 1)] = False
    pat = pattern([cells], free)
    return Elastic.on(pat, hexes(points, cells), NeoHooke(MU, kappa), lazy=0.0), points, Cholmod(pat)


def pulled(kappa: float, hold: bool) -> Solution:
    """Its upper plate is moved aside, everything between guessed along with it."""
    body, points, solver = held_block(kappa)
    if hold:
        body.hold(points)
    x = points + 0.3 * points[:, 2:] * [1.0, 0.0, 0.0] - 0.2 * points[:, 2:] * [0.0, 0.0, 1.0]
    return minimise(body, x, solver._pattern, solver, xtol=1e-9)


def test_it_leads_to_the_same_answer_in_fewer_steps_where_volume_is_kept() -> None:
    for kappa, part in ((30 * MU, 1.01), (3000 * MU, 0.75)):
        plain, held = (pulled(kappa, hold) for hold in (False, True))
        assert plain.status is held.status is Status.converged
        assert held.x == pytest.approx(plain.x, abs=1e-8)
        assert len(held.steps) <= part * len(plain.steps), kappa


def test_the_pressure_of_the_last_answer_is_to_be_had_after_a_step_that_meant_another() -> None:
    """Far from it the stiffness meant is indefinite, though that with the pressure of the answer is not."""
    body, points, solver = held_block(300 * MU)
    pat = solver._pattern

    def least(x: Array, project: int) -> float:
        return float(np.linalg.eigvalsh(dense(body, x, pat, project)).min())

    assert least(points, LAST) == least(points, 0)  # before there is any answer
    body.hold(points)
    body.gradient(points)
    x = points.copy()
    x.ravel()[pat.free] += 0.02 * np.random.default_rng(1).normal(size=pat.size)
    body.gradient(x)
    assert least(x, 0) < 0 < least(x, LAST)
    body.hold(x)  # as if it were one, with its pressure
    assert least(x, LAST) == least(x, 0) < 0


def test_one_stiffness_leads_to_the_answer_where_volume_is_kept() -> None:
    """The steps of a stiffness taken once shorten; by the gradient alone they grow where volume hardly changes."""
    lengths: dict[str, list[float]] = {"gradient": [], "unbalanced": []}
    for name, found in lengths.items():
        body, points, solver = held_block(3000 * MU)
        body.hold(points)
        x = points + 0.1 * points[:, 2:] * [1.0, 0.0, 0.0]
        body.gradient(x)
        data, free = np.zeros(len(solver._pattern.indices)), solver._pattern.free
        body.add_hessian(x, data, 0)
        solver.factor(data)
        while len(found) < 10 and (not found or found[-1] < 1):
            p = np.zeros(x.size)
            p[free] = solver.solve(-getattr(body, name)(x).ravel()[free])
            x = x + p.reshape(x.shape)
            found.append(float(np.abs(p).max()))
    assert lengths["gradient"][-1] > 1 > 1e-9 > lengths["unbalanced"][-1]
    assert np.abs(body.gradient(x).ravel()[free]).max() < 1e-9 * MU  # of the last, where pressure is what was meant


def test_j_is_carried_on_by_its_first_derivative() -> None:
    rng = np.random.default_rng(3)
    F, by = np.eye(3) + 0.2 * rng.normal(size=(2, 3, 2, 3, 3))
    h = 1e-6
    slope = (np.linalg.det(F + h * by) - np.linalg.det(F - h * by)) / (2 * h)
    assert carried(F, F, np.linalg.det(F), F + by) == pytest.approx(np.linalg.det(F) + slope, abs=1e-8)
    other = np.eye(3) + 0.2 * rng.normal(size=F.shape)
    assert carried(other, F, np.ones(F.shape[:2]), F) == pytest.approx(np.ones(F.shape[:2]))


def test_an_answer_holds_until_a_step_and_a_step_leads_on() -> None:
    rng = np.random.default_rng(3)
    F, G, H = np.eye(3) + 0.1 * rng.normal(size=(3, 2, 1, 3, 3))
    J = [np.linalg.det(A) for A in (F, G, H)]
    meant = Meant()
    meant.step(F, J[0], F)
    assert meant.at(F, J[0]) is J[0]  # before the first answer
    answer = np.array([[1.1], [0.9]])
    meant.hold(answer)
    assert meant.at(F, J[0]) is J[0]  # the way there is not known
    meant.step(F, J[0], F)
    assert meant.at(F, J[0]) == pytest.approx(answer)
    meant.step(G, J[1], F)
    assert meant.at(G, J[1]) == pytest.approx(carried(F, F, J[0], G))
    meant.step(H, J[2], G)
    meant.step(H, J[2], G)
    assert meant.at(H, J[2]) == pytest.approx(carried(G, G, J[1], H))
    meant.hold(9 * J[0])
    meant.step(F, J[0], F)
    assert meant.at(F, J[0]) == pytest.approx(2 * J[0])  # no more than that


def test_the_stiffness_is_the_true_one_where_nothing_was_guessed() -> None:
    rng = np.random.default_rng(3)
    body, points, solver = held_block(100 * MU)
    x = points + 0.05 * points[:, 2:] * rng.normal(size=points.shape)
    true = dense(body, x, solver._pattern)
    body.hold(points)
    again, _, _ = held_block(100 * MU)
    assert dense(again, x, solver._pattern) == pytest.approx(true)
    body.gradient(x)
    assert np.abs(dense(body, x, solver._pattern) - true).max() > 1e-3 * np.abs(true).max()
    assert deformation(points, body.elements.conn, body.elements.gradients) == pytest.approx(
        np.broadcast_to(np.eye(3), (len(body.elements.conn), 8, 3, 3)), abs=1e-12
    )
