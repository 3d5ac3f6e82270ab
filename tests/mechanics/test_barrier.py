"""Barrier, contact and anchors on a small bent patch below a turned indenter."""

import numpy as np
import pytest
from helpers.small import patch, turn

from tacgen.geometry.analytic_sdf import ConeSdf, Shape, SphereSdf
from tacgen.geometry.pose import Pose
from tacgen.mechanics.barrier import Contact, barrier
from tacgen.mechanics.coupled import CoupledContact, smooth
from tacgen.mechanics.measures import dragged
from tacgen.physics.contact import PARABOLA_GAP_RATIO

Array = np.ndarray
DHAT = 0.3
POINTS, FACES, _ = patch(2, 1.2)
TILTED = Pose(turn(4), np.array([0.1, -0.05, 0.02]))


def bent(seed: int = 0) -> Array:
    """The patch bent and shifted, x (n, 3)."""
    return POINTS + np.random.default_rng(seed).uniform(-0.08, 0.08, POINTS.shape)


def against(shape: Shape, offset: float = 0.04) -> Contact:
    """Contact whose turned indenter overlaps some of the patch, is near other parts and out of reach of some."""
    lowest = np.zeros(3)
    pose = Pose(TILTED.rotation, np.zeros(3))
    down = pose.rotation.T @ np.array([0.0, 0.0, -1.0])
    if isinstance(shape, SphereSdf):
        lowest = np.array([0.0, 0.0, shape.radius]) + shape.radius * down
    return Contact(FACES, shape, Pose(pose.rotation, -pose.rotation @ lowest - [0, 0, 0.06]), DHAT, 0.7, offset)


CONTACTS = {"sphere": against(SphereSdf(0.8)), "cone": against(ConeSdf(np.radians(50), 0.4))}


def test_barrier_derivatives() -> None:
    d = DHAT * np.array([-0.7, 0.1, 0.45, 0.55, 0.8, 0.95, 0.999, 1.2])
    h = 1e-7
    b, db, ddb = barrier(d, DHAT)
    assert db == pytest.approx((barrier(d + h, DHAT)[0] - barrier(d - h, DHAT)[0]) / (2 * h), abs=1e-8)
    assert ddb == pytest.approx((barrier(d + h, DHAT)[1] - barrier(d - h, DHAT)[1]) / (2 * h), rel=1e-6, abs=1e-8)
    assert (b[:-1] > 0).all()
    assert (db[:-1] < 0).all()  # it pushes apart
    assert (ddb[:-1] > 0).all()
    assert b[-1] == db[-1] == ddb[-1] == 0
    inner = DHAT * np.array([0.6, 0.8])
    assert barrier(inner, DHAT)[0] == pytest.approx(-DHAT * (inner / DHAT - 1) ** 2 * np.log(inner / DHAT), rel=1e-12)


@pytest.mark.parametrize("where", [1.0, PARABOLA_GAP_RATIO])
def test_barrier_is_c2_where_its_pieces_meet(where: float) -> None:
    below, above = (barrier(np.array(DHAT * where * (1 + s * 1e-9)), DHAT) for s in (-1, 1))
    for left, right, size in zip(below, above, (DHAT, 1.0, 1 / DHAT), strict=True):
        assert left == pytest.approx(right, abs=1e-7 * size)


def test_quadrature_has_the_area_and_scatters_everything() -> None:
    assert FACES.areas.sum() == pytest.approx(1.44)
    forces = np.random.default_rng(2).normal(size=(*FACES.areas.shape, 3))
    nodal = FACES.scatter(forces, len(POINTS))
    assert nodal.sum(0) == pytest.approx(forces.sum((0, 1)))
    x = bent()
    assert np.cross(x, nodal).sum(0) == pytest.approx(np.cross(FACES.at(x), forces).sum((0, 1)))


def test_contact_forces_push_the_gel_off() -> None:
    contact, x = CONTACTS["sphere"], bent()
    found = CoupledContact(contact, 0.0, contact.faces.at(x), 0.1).evaluate(x)
    force, normal, gap = found.N, found.normal, found.gap
    assert (force >= 0).all()
    assert ((force > 0) == (gap < DHAT)).all()
    assert np.linalg.norm(normal, axis=-1) == pytest.approx(np.ones(gap.shape), abs=1e-12)
    out = contact.faces.at(x) + 1e-6 * normal
    assert contact.shape.distance(contact.pose.local(out).reshape(-1, 3))[0] + 0.04 == pytest.approx(gap.ravel() + 1e-6)


def test_shrinking_the_indenter_opens_every_gap_by_as_much() -> None:
    contact, x = CONTACTS["cone"], bent()
    assert contact.moved(contact.pose, 0.14).gap(x) - contact.gap(x) == pytest.approx(0.1)


def test_no_step_passes_through_the_indenter() -> None:
    """Straight through a ball's middle: stopped before its far half."""
    contact = Contact(FACES, SphereSdf(1.0), Pose(np.eye(3), np.array([0, 0, 0.3])), DHAT, 0.7)
    p = np.zeros_like(POINTS)
    p[:, 2] = 50.0
    gap = contact.gap(POINTS)
    part = contact.max_step(gap, p)
    assert 0 < part < 1
    after = contact.faces.at(POINTS + part * p)
    near = gap < 0.5
    assert (after[near][:, 2] < 1.3).all()
    assert contact.max_step(gap, 1e-3 * p) == 1.0
    assert contact.max_step(gap, 0 * p) == 1.0


def test_smoothed_coulomb_law() -> None:
    eps, h = 0.02, 1e-8
    u = np.array([0.001, 0.01, 0.0199, 0.0201, 0.5])
    _, over_u, bend = smooth(u, eps)
    d1 = (smooth(u + h, eps)[0] - smooth(u - h, eps)[0]) / (2 * h)
    d2 = (smooth(u + h, eps)[1] * (u + h) - smooth(u - h, eps)[1] * (u - h)) / (2 * h)
    assert over_u * u == pytest.approx(d1, rel=1e-5)
    assert bend * u**2 + over_u == pytest.approx(d2, rel=1e-4, abs=1e-5)
    assert (over_u * u <= 1 + 1e-12).all()
    assert over_u[3:] * u[3:] == pytest.approx([1, 1])
    zero = smooth(np.zeros(1), eps)
    assert zero[0][0] == pytest.approx(0, abs=1e-12)
    assert zero[1][0] == pytest.approx(2 / eps)
    left, right = smooth(np.array([eps * (1 - 1e-9)]), eps), smooth(np.array([eps * (1 + 1e-9)]), eps)
    assert left[0] == pytest.approx(right[0], rel=1e-8)
    assert left[1] == pytest.approx(right[1], rel=1e-8)


def test_anchors_are_dragged_along_only_by_what_exceeds_eps() -> None:
    normal, anchor = np.broadcast_to([0.0, 0, 1], (1, 3, 3)), np.zeros((1, 3, 3))
    x = np.array([[[0.05, 0, 0.3], [3.0, 4.0, 0.3], [3.0, 4.0, 0.3]]])
    new, sliding = dragged(anchor, x, normal, np.array([[1.0, 1.0, 0.0]]), 0.1, 0.01)
    assert sliding.tolist() == [[False, True, False]]
    assert (x - new)[0, 0, :2] == pytest.approx([0.05, 0])  # sticks: its anchor stays
    assert (x - new)[0, 1, :2] == pytest.approx([0.06, 0.08])  # slips: eps behind, in the direction of the slip
    assert new[0, 2] == pytest.approx(x[0, 2])  # free: carries its own
