"""Contact and friction on a bulk that is known in full: balance, Coulomb's law, and where the search must end."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.small import patch

from tacgen.geometry.analytic_sdf import BoxSdf, CylinderSdf, Shape, SphereSdf, WedgeSdf
from tacgen.geometry.pose import Pose
from tacgen.mechanics import contact_newton
from tacgen.mechanics.barrier import Contact
from tacgen.mechanics.condensation import Schur
from tacgen.mechanics.contact_newton import ContactIterate, ContactStatus, Quadratic, QuadraticPoint, solve_contact
from tacgen.mechanics.coupled import CoupledContact
from tacgen.mechanics.measures import slip
from tacgen.physics.decisions import MIN_LINE_SEARCH_FRACTION, after_step, shrinks

Array = np.ndarray
DHAT, EPS, FRICTION, XTOL = 0.05, 0.05 / 8, 0.5, 1e-5
POINTS, FACES, _ = patch(6, 2.4)
RIM = np.abs(POINTS[:, :2]).max(1) > 1.19


def bulk(force: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Quadratic:
    """A sheet on a bed of springs, its rim held; `force` on each node."""
    near = np.linalg.norm(POINTS[:, None] - POINTS[None], axis=-1)
    sheet = 0.05 * np.exp(-((near / 0.4) ** 2))
    dofs = np.full(POINTS.shape, -1)
    dofs[~RIM] = np.arange(3 * (~RIM).sum()).reshape(-1, 3)
    S = np.kron(sheet[np.ix_(~RIM, ~RIM)], np.eye(3)) + 0.02 * np.eye(3 * (~RIM).sum())
    return Quadratic(POINTS, dofs, Schur(S, lambda: np.eye(len(S))), np.tile(force, (~RIM).sum()))


def against(
    shape: Shape, depth: float, anchor: tuple[float, float, float] = (0.0, 0.0, 0.0), friction: float = FRICTION
) -> CoupledContact:
    """Pressed in by `depth`, every point sticking to where it was, moved by `anchor`."""
    contact = Contact(FACES, shape, Pose(np.eye(3), np.array([0.02, 0.01, -depth])), DHAT, 0.3)
    return CoupledContact(contact, friction, FACES.at(POINTS) + np.array(anchor), EPS)


def solved(to: Quadratic, contact: CoupledContact, **how: float) -> ContactIterate[QuadraticPoint]:
    return solve_contact(to, contact, to.start, **{"xtol": XTOL, "max_steps": 40, **how})  # type: ignore[arg-type]


CASES = {
    "ball": against(SphereSdf(1.5), 0.2),
    "ball that slides": against(SphereSdf(1.5), 0.2, (0.3, 0.1, 0)),
    "punch": against(CylinderSdf(0.7, 0.1), 0.2, (0.0, 0.02, 0)),
    "box that slides": against(BoxSdf(1.2, 0.8, 0.15), 0.15, (-0.2, 0.1, 0)),
    "without friction": against(SphereSdf(1.5), 0.2, (0.3, 0.1, 0), 0.0),
    "a touch": against(SphereSdf(1.5), 0.005),
}


@pytest.mark.parametrize("name", CASES)
def test_it_ends_in_balance_with_the_indenter_shrunk_by_the_mean_gap(name: str) -> None:
    to, contact = bulk(), CASES[name]
    found = solved(to, contact)
    assert found.converged
    assert found.steps <= 25
    forces = found.contact.evaluate(found.x)
    assert (forces.force == found.forces.force).all()
    assert forces.N.sum() > 1e-4
    unbalanced = (to.at(found.x).gradient - FACES.scatter(forces.force, len(POINTS)))[~RIM]
    assert np.linalg.norm(unbalanced) < 1e-3 * forces.N.sum()
    assert found.contact.contact.offset == pytest.approx(forces.mean_gap, abs=2 * XTOL)
    assert (found.x[RIM] == POINTS[RIM]).all()
    rub = np.linalg.norm(forces.force - forces.N[..., None] * forces.normal, axis=-1)
    assert (rub <= contact.friction * forces.N * (1 + 1e-9) + 1e-15).all()
    if "slides" in name:
        slipped = slip(forces.at, found.contact.anchor, forces.normal)
        length = np.linalg.norm(slipped, axis=-1)[forces.N > 0]
        assert (length > EPS).mean() > 0.5
        assert np.sign(forces.force.sum((0, 1))[0]) == np.sign((contact.anchor - FACES.at(POINTS))[0, 0, 0])


def test_near_the_answer_it_takes_a_few_steps() -> None:
    """With a consistent tangent each doubles the digits."""
    to, contact = bulk(), CASES["ball that slides"]
    first = solved(to, contact)
    again = solve_contact(to, first.contact, first.x, xtol=XTOL, max_steps=40)
    assert again.converged
    assert again.steps <= 3
    assert again.x == pytest.approx(first.x, abs=3 * XTOL)
    off = first.x + np.where(RIM[:, None], 0.0, 2e-4 * np.sin(7 * POINTS[:, :1]))
    near = solve_contact(to, first.contact, off, xtol=1e-9, max_steps=40)
    assert near.converged
    assert near.steps <= 8


def test_it_ends_where_a_node_has_come_to_the_radius() -> None:
    to, contact = bulk((0.0, 0.0, 0.004)), CASES["ball"]
    free = solved(to, contact)
    gone = np.abs(free.x - POINTS).max()
    assert free.converged
    assert gone > 0.1
    for radius in (0.02, 0.5 * gone):
        found = solved(to, contact, radius=radius)
        assert found.status is ContactStatus.unstable
        assert np.abs(found.x - POINTS).max() == pytest.approx(radius)
        assert (found.forces.force == found.contact.evaluate(found.x).force).all()
    assert solved(to, contact, radius=2 * gone).converged


def test_it_ends_where_the_bulk_is_unstable() -> None:
    """Springs that push the sheet away, harder than the contact holds it."""
    to, contact = bulk(), CASES["ball that slides"]
    unit = np.eye(len(to.force))
    pushing = replace(to, schur=Schur(to.schur.S - 2.0 * unit, lambda: unit))
    found = solved(pushing, contact)
    assert found.status is ContactStatus.unstable
    damped = replace(to, schur=pushing.schur.damped(2.0))
    assert solved(damped, contact).converged


def test_it_says_that_it_ran_out_of_steps() -> None:
    found = solved(bulk(), CASES["box that slides"], max_steps=2)
    assert not found.converged
    assert found.steps == 2


def test_it_ends_where_it_goes_to_and_fro_over_an_edge(monkeypatch: pytest.MonkeyPatch) -> None:
    """A punch with all but sharp edges on a soft bed: at the better of the two places, where more steps lead to."""
    stiff = bulk()
    to = replace(stiff, schur=Schur(0.1 * stiff.schur.S, lambda: np.eye(len(stiff.force))))
    contact = against(CylinderSdf(0.7, 0.002), 0.1, friction=0.0)
    found = solved(to, contact)
    assert found.status is ContactStatus.circling
    assert found.steps < 40
    monkeypatch.setattr(contact_newton, "SAME_ITERATE_TOL", -1.0)
    even, odd = (solved(to, contact, max_steps=steps) for steps in (40, 41))
    assert (even.steps, odd.steps) == (40, 41)
    size = [float(np.linalg.norm(one.g)) for one in (even, odd)]
    assert max(size) > 2 * min(size)
    assert np.linalg.norm(found.g) < max(size) / 2
    assert found.x == pytest.approx((even, odd)[int(size[1] < size[0])].x, abs=XTOL)


@pytest.mark.parametrize(
    ("part", "length", "drift", "off", "wanted"),
    [
        (1.0, 1e-6, 0.0, np.nan, ContactStatus.converged),  # without contact
        (1.0, 1e-6, -9e-6, 9e-6, ContactStatus.converged),
        (1.0, 1e-6, -2e-5, 0.0, ContactStatus.running),
        (1.0, 1e-6, 0.0, 2e-5, ContactStatus.running),
        (1.0, 1e-4, 0.0, 0.0, ContactStatus.running),
        (0.5, 1e-6, 0.0, 0.0, ContactStatus.running),
        (1e-9, 1e-6, 0.0, 0.0, ContactStatus.converged),
        (1e-11, 1e-3, 0.0, 0.0, ContactStatus.stopped),
    ],
)
def test_how_it_stands_after_a_step(
    part: float, length: float, drift: float, off: float, wanted: ContactStatus
) -> None:
    assert after_step(part == 1, part, length, drift, off, XTOL, MIN_LINE_SEARCH_FRACTION) is wanted


def test_the_indenter_is_shrunk_by_the_mean_gap_of_a_contact_near_the_solution() -> None:
    assert [shrinks(length, DHAT, gap) for length, gap in ((DHAT, 0.01), (DHAT, -0.01), (2 * DHAT, 0.01))] == [1, 1, 0]
    assert not shrinks(0.0, DHAT, np.nan)


def test_it_goes_on_from_the_same_place_with_another_mean_gap() -> None:
    """A sharp wedge pushes the sheet away in the first step, and in the second it is back, with the wedge shrunk."""
    found = solved(bulk(), against(WedgeSdf(np.radians(45), 0.01, 1.0), 0.05, friction=0.0))
    assert found.converged
    assert found.steps > 2


def test_nothing_that_it_was_given_is_changed() -> None:
    to, contact = bulk(), CASES["ball"]
    kept = to.schur.S.copy(), to.force.copy(), to.start.copy(), contact.anchor.copy()
    first = solved(to, contact)
    assert all((a == b).all() for a, b in zip(kept, (to.schur.S, to.force, to.start, contact.anchor), strict=True))
    assert contact.contact.offset == 0
    other = bulk()
    second = solved(other, replace(contact))
    assert (first.x == second.x).all()


def test_the_quadratic_has_the_slopes_it_says() -> None:
    to = bulk((0.001, 0.0, -0.002))
    x = POINTS + np.where(RIM[:, None], 0.0, np.random.default_rng(0).normal(0, 0.1, POINTS.shape))
    here = to.at(x)
    g = here.gradient
    assert not g[RIM].any()
    assert to.at(POINTS).energy == 0
    for node, axis in ((16, 0), (24, 1), (17, 2)):
        step = np.zeros_like(x)
        step[node, axis] = 1e-4
        assert g[node, axis] == pytest.approx((to.at(x + step).energy - to.at(x - step).energy) / 2e-4)
    p = np.where(RIM[:, None], 0.0, np.random.default_rng(1).normal(0, 0.1, POINTS.shape))
    along = to.along(here, x, p)
    for part in (0.0, 0.25, 1.0):
        assert along(part) == pytest.approx(to.at(x + part * p).energy, rel=1e-12)
