"""Contact with friction as one set of forces: the tangent is their slope, whatever the shape, stuck or slipping."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.small import patch, slope, turn

from tacgen.fem.assembly import add_dense_blocks
from tacgen.geometry.analytic_sdf import BoxSdf, Shape, SphereSdf, TorusSdf
from tacgen.geometry.pose import Pose
from tacgen.geometry.sdf_grid import Field
from tacgen.mechanics.barrier import Contact, barrier
from tacgen.mechanics.coupled import ContactForces, CoupledContact
from tacgen.mechanics.measures import slip
from tacgen.physics.contact import PARABOLA_GAP_RATIO

Array = np.ndarray
DHAT, EPS, KAPPA, FRICTION = 0.3, 0.1, 0.7, 0.6
POINTS, FACES, PATTERN = patch(3, 1.8)
SLIPS = EPS * np.array([0.0, 1e-3, 0.4, 0.9, 1 - 1e-7, 1.0, 1 + 1e-7, 1.1, 4.0])  # stuck, at the change, slipping


def rounded_block(p: Array) -> Array:
    """Signed distance of a box of 1.4 x 1.2 x 1 mm on z = 0 whose edges have a radius of .3 mm."""
    q = np.abs(p - [0, 0, 0.5]) - [0.4, 0.3, 0.2]
    return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0) - 0.3


def spline() -> Field:
    ticks = [np.arange(-1.4, 1.45, 0.1), np.arange(-1.4, 1.45, 0.1), np.arange(-0.8, 1.25, 0.1)]
    grid = np.stack(np.meshgrid(*ticks, indexing="ij"), -1)
    return Field.through(rounded_block(grid), [-1.4, -1.4, -0.8], 0.1, smallest_radius=0.3, corners=np.eye(3))


SHAPES: dict[str, Shape] = {
    "sphere": SphereSdf(0.8),
    "box": BoxSdf(1.4, 1.2, 0.3),
    "torus": TorusSdf(0.6, 0.35),
    "spline": spline(),
}
ALL = pytest.mark.parametrize("name", SHAPES)


def bent(seed: int = 0, size: float = 0.05) -> Array:
    """The patch bent, x (n, 3)."""
    return POINTS + np.random.default_rng(seed).uniform(-size, size, POINTS.shape)


def against(name: str, x: Array, friction: float = FRICTION, seed: int = 0, least: float = 0.01) -> CoupledContact:
    """A leaning indenter lowered until the smallest gap is `least` [mm]; anchors are off by SLIPS, and off the face."""
    rng = np.random.default_rng(seed)
    q, r = np.linalg.qr(np.eye(3) + 0.2 * turn(4))
    rotation = q * np.sign(np.diag(r))
    contact = Contact(FACES, SHAPES[name], Pose(rotation, np.zeros(3)), DHAT, KAPPA, 0.02)
    low, high = -0.3, 2.0
    for _ in range(50):
        middle = (low + high) / 2
        contact = contact.moved(Pose(rotation, np.array([0.05, -0.03, middle])), 0.02)
        low, high = (middle, high) if contact.least(x) < least else (low, middle)
    n = CoupledContact(contact, 0.0, FACES.at(x), EPS).evaluate(x).normal
    along = np.cross(n, rng.normal(size=n.shape))
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    slip = rng.permutation(np.resize(SLIPS, n[..., :1].size)).reshape(n[..., :1].shape)
    anchor = FACES.at(x) - slip * along + rng.uniform(-0.1, 0.1, n[..., :1].shape) * n
    return CoupledContact(contact, friction, anchor, EPS)


def slopes(coupled: CoupledContact, x: Array, h: float = 1e-6) -> Array:
    """-df/dx (f, q, 3, 3) at each point by central differences: all points are moved at once, each feels its own."""
    columns = []
    for step in h * np.eye(3):
        columns.append((coupled.evaluate(x - step).force - coupled.evaluate(x + step).force) / (2 * h))
    return np.stack(columns, -1)


def kinds(coupled: CoupledContact, forces: ContactForces) -> list[int]:
    """How many points that touch stick, change, slip, and are in each piece of the barrier."""
    length, on = np.linalg.norm(slip(forces.at, coupled.anchor, forces.normal), axis=-1), forces.N > 0
    stuck, slips = length < 0.99 * EPS, length > 1.01 * EPS
    soft = forces.gap < PARABOLA_GAP_RATIO * DHAT
    return [int((on & which).sum()) for which in (stuck, ~stuck & ~slips, slips, soft, ~soft)]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("friction", [FRICTION, 0.0])
@ALL
def test_the_tangent_is_the_slope_of_the_force(name: str, friction: float, seed: int) -> None:
    x = bent(seed)
    coupled = against(name, x, friction, seed)
    found = coupled.evaluate(x)
    stuck, changing, slipping, soft, usual = kinds(coupled, found)
    assert min(stuck, changing, slipping, soft) >= 3
    assert usual >= 3 or name == "torus"
    size = np.abs(found.tangent).max()
    assert size > 0.1
    assert found.tangent == pytest.approx(slopes(coupled, x), abs=2e-5 * size)
    free = found.N == 0
    assert free.any() or name == "torus"
    assert not found.tangent[free].any()
    assert not found.definite[free].any()
    assert not found.force[free].any()


@ALL
def test_where_points_overlap_the_tangent_is_that_of_a_plane(name: str) -> None:
    x = bent()
    coupled = against(name, x, least=-0.2)
    found = coupled.evaluate(x)
    flat = coupled.evaluate(x, found.seen._replace(H=np.zeros_like(found.seen.H)))
    over = found.gap < 0
    assert over.sum() >= 3
    assert found.force == pytest.approx(flat.force)
    assert found.tangent[over] == pytest.approx(flat.tangent[over])
    assert found.tangent[~over] != pytest.approx(flat.tangent[~over])


@pytest.mark.parametrize("nodes", [4, 6])
def test_at_the_nodes_too_it_is_the_slope_and_not_its_transpose(nodes: int) -> None:
    points, faces, _ = patch(2, 1.8, nodes)
    x = points + np.random.default_rng(1).uniform(-0.05, 0.05, points.shape)
    contact = Contact(faces, SphereSdf(0.8), Pose(np.eye(3), np.array([0.03, 0.01, 0.02])), DHAT, KAPPA)
    coupled = CoupledContact(contact, FRICTION, faces.at(x) - [0.06, -0.03, 0.04], EPS)

    def nodal(y: Array) -> Array:
        return -faces.scatter(coupled.evaluate(y).force, len(y)).ravel()

    K = np.zeros((x.size, x.size))
    add_dense_blocks(coupled.evaluate(x).tangent, faces.N, np.arange(x.size).reshape(-1, 3)[faces.conn], K)
    by_differences = slope(nodal, x, 1e-6).T  # (of each force, along each dof)
    size = np.abs(K).max()
    assert pytest.approx(by_differences, abs=1e-5 * size) == K
    assert np.abs(K - K.T).max() > 0.1 * size


@pytest.mark.parametrize("friction", [FRICTION, 0.0])
@ALL
def test_the_definite_part_is_symmetric_and_never_negative(name: str, friction: float) -> None:
    x = bent(2)
    coupled = against(name, x, friction, 2)
    found = coupled.evaluate(x)
    D = found.definite[found.N > 0]
    assert pytest.approx(D.swapaxes(1, 2), abs=1e-14) == D
    values = np.linalg.eigvalsh(D)
    assert values.min() > -1e-12 * values.max()
    assert (values[:, 2] > 1e-3).all()  # stiff across the face, at every point that touches
    stuck = np.linalg.norm(slip(found.at, coupled.anchor, found.normal), axis=-1)[found.N > 0] < 0.95 * EPS
    assert friction == 0 or (values[stuck, 0] > 1e-6).all()  # and along it, until it slips
    exact = found.tangent[found.N > 0]
    assert np.linalg.eigvalsh(exact + exact.swapaxes(1, 2)).min() < -1e-3  # which alone would not do


@ALL
def test_the_definite_part_is_the_merit_functions_hessian_less_the_indenters_curvature(name: str) -> None:
    x = bent(2)
    coupled = against(name, x, FRICTION, 2)
    found, c = coupled.evaluate(x), coupled.contact
    _, slope, _ = barrier(found.gap, c.dhat)
    H = found.definite + (c.kappa * c.faces.areas * slope)[..., None, None] * found.seen.H
    for seed in range(5):
        p, h = np.random.default_rng(seed).normal(size=x.shape), 1e-4
        way = FACES.at(p)
        merits = [coupled.merit(x + t * p, found) for t in (-h, 0.0, h)]
        wanted = (merits[0] - 2 * merits[1] + merits[2]) / h**2
        assert np.einsum("fqi,fqij,fqj->", way, H, way) == pytest.approx(wanted, rel=2e-3)


@ALL
def test_friction_obeys_coulomb_at_every_point_and_opposes_slip(name: str) -> None:
    x = bent(3)
    coupled = against(name, x, seed=3)
    found = coupled.evaluate(x)
    rub = found.force - found.N[..., None] * found.normal
    size, u = np.linalg.norm(rub, axis=-1), slip(found.at, coupled.anchor, found.normal)
    length = np.linalg.norm(u, axis=-1)
    limit = FRICTION * found.N
    assert (found.N >= 0).all()
    assert (size <= limit * (1 + 1e-9) + 1e-15).all()
    slips = (length >= EPS) & (found.N > 0)
    assert size[slips] == pytest.approx(limit[slips])
    assert (size[(length < 0.95 * EPS) & (found.N > 0)] < 0.999 * limit[(length < 0.95 * EPS) & (found.N > 0)]).all()
    assert (rub * u).sum(-1) == pytest.approx(-size * length, abs=1e-14)
    assert (rub * found.normal).sum(-1) == pytest.approx(np.zeros(size.shape), abs=1e-14)
    assert (u * found.normal).sum(-1) == pytest.approx(np.zeros(size.shape), abs=1e-14)


@pytest.mark.parametrize("friction", [FRICTION, 0.0])
@ALL
def test_where_its_forces_were_frozen_the_merits_slope_is_the_force(name: str, friction: float) -> None:
    x = bent(4)
    coupled = against(name, x, friction, 4)
    frozen = coupled.evaluate(x)
    g = -FACES.scatter(frozen.force, len(x))
    by_differences = slope(lambda y: coupled.merit(y, frozen), x, 1e-6).reshape(x.shape)
    assert g == pytest.approx(by_differences, abs=1e-6 * np.abs(g).max())
    barrier_alone = -FACES.scatter(frozen.N[..., None] * frozen.normal, len(x))
    assert friction == 0 or by_differences != pytest.approx(barrier_alone, abs=0.02 * np.abs(g).max())


def test_a_stiffer_barrier_pushes_as_much_harder_and_a_smaller_indenter_leaves_as_much_more_room() -> None:
    x = bent()
    coupled = against("sphere", x)
    found = coupled.evaluate(x)
    twice = coupled.stiffened(2.0).evaluate(x)
    assert twice.force == pytest.approx(2 * found.force)
    assert twice.tangent == pytest.approx(2 * found.tangent)
    assert coupled.shrunk(0.12).evaluate(x).gap == pytest.approx(found.gap + 0.1)
    assert found.mean_gap == pytest.approx((found.N * found.gap).sum() / found.N.sum())
    smaller = coupled.shrunk(0.12)
    assert smaller.evaluate(x, found.seen).force == pytest.approx(smaller.evaluate(x).force)
    away = replace(coupled, contact=coupled.contact.moved(Pose(np.eye(3), np.array([0.0, 0.0, 9.0])), 0.0))
    assert np.isnan(away.evaluate(x).mean_gap)
    assert not away.evaluate(x).force.any()
