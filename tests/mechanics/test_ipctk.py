"""Contact between meshes: forces are slopes of energies and straight across where it is flat; starts are safe."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.needs import needs
from helpers.small import dense, patch, slope, turn

from tacgen.fem.elements import facet_corners
from tacgen.fem.potential import Projection
from tacgen.geometry import surface_nets
from tacgen.geometry.analytic_sdf import BoxSdf, Shape, SphereSdf, Triangles
from tacgen.geometry.pose import Pose
from tacgen.mechanics.barrier import Contact
from tacgen.mechanics.ipctk import NODES, MeshContact, MeshFriction, Pair, lattice

ipctk = needs("ipctk")
Array = np.ndarray
DHAT = 0.3
POINTS, FACES, PATTERN = patch(4, 1.2)
FLAT = Triangles(
    np.array([[-9.0, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]]),
    np.array([[0, 2, 1], [0, 3, 2]]),
    np.tile([0.0, 0, -1], (4, 1)),
)


def bent(seed: int = 0, size: float = 0.03) -> Array:
    return POINTS + np.random.default_rng(seed).uniform(-size, size, POINTS.shape)


def against(shape: Shape, surface: Triangles, pose: Pose, offset: float = 0.04, crossings: bool = False) -> MeshContact:
    """Without `crossings` of edges, which a barrier as wide as these triangles sees too many of."""
    pair = Pair.of(PATTERN, POINTS, FACES.conn, surface)
    if not crossings:
        pair.collision.edge_areas = np.zeros(pair.collision.num_edges)
    return MeshContact(pair, Contact(pair.faces, shape, pose, DHAT, 0.7, offset), pose, DHAT, 0.7, offset)


@pytest.fixture(scope="module")
def ball() -> MeshContact:
    return turned_ball()


def turned_ball(crossings: bool = False) -> MeshContact:
    """A turned ball's triangles, some way into the barrier's range."""
    rotation = turn(4)
    position = np.array([0.1, -0.05, 0.9]) - rotation @ [0, 0, 0.8]
    surface = surface_nets.of_shape(SphereSdf(0.8), half=3, height=2, tolerance=0.01)
    return against(SphereSdf(0.8), surface, Pose(rotation, position), crossings=crossings)


@pytest.fixture(scope="module")
def plate() -> MeshContact:
    """Two big triangles, a little out of level."""
    lean = np.array([[1, 0, 0.03], [0, 1, -0.05], [-0.03, 0.05, 1.0]])
    q, r = np.linalg.qr(lean)
    return against(BoxSdf(18, 18, 0.1), FLAT, Pose(q * np.sign(np.diag(r)), np.array([0.3, 0.4, 0.14])))


def rubbing(contact: MeshContact, x: Array) -> MeshFriction:
    force = contact.pressure(x)[0]
    rng = np.random.default_rng(3)
    anchor = contact.faces.at(x) + 0.1 * contact.pair.spread(rng.normal(size=(9999, 3))) / contact.pair.share[..., None]
    return contact.friction(0.6, x, force, anchor, 0.15)


def test_the_points_stand_for_the_whole_face(ball: MeshContact) -> None:
    faces = ball.faces
    assert faces.areas.sum() == pytest.approx(1.44)
    assert faces.areas[:, :4].sum() == pytest.approx(NODES * 1.44)
    assert ball.pair.points == 25 + 4 * 16  # nodes are shared, quadrature points are not
    assert np.bincount(ball.pair.copy.ravel(), ball.pair.share.ravel()) == pytest.approx(np.ones(89))
    x = bent()
    assert (ball.pair.weights @ x)[ball.pair.copy] == pytest.approx(faces.at(x))


@pytest.mark.parametrize("nodes", [3, 4, 6])
def test_a_facet_is_covered_once(nodes: int) -> None:
    N, part, pieces = lattice(nodes)
    at = N @ facet_corners(nodes)
    a, b, c = np.moveaxis(at[pieces], 1, 0)
    area = np.linalg.det(np.stack([b - a, c - a], 1)) / 2
    assert area.min() > 0
    assert area.sum() == pytest.approx(4.0 if nodes == 4 else 0.5)
    assert set(pieces.ravel()) == set(range(len(N)))
    assert part.sum() == pytest.approx(1.0)
    assert N.sum(1) == pytest.approx(np.ones(len(N)))


@pytest.mark.slow
def test_gradient_is_the_slope_of_the_energy(plate: MeshContact) -> None:
    for contact in (plate, turned_ball(crossings=True)):
        x = bent()
        g = contact.gradient(x)
        assert np.abs(g).max() > 1e-3
        assert g.ravel() == pytest.approx(slope(contact.value, x, 1e-6), abs=1e-6 * np.abs(g).max())


def test_hessian_is_the_slope_of_the_gradient_where_the_indenter_is_flat(plate: MeshContact) -> None:
    x = bent()
    stiffness = dense(plate, x, PATTERN)
    size = np.abs(stiffness).max()
    assert size > 0.1
    by_differences = slope(lambda y: plate.gradient(y).ravel(), x, 1e-6)
    assert stiffness == pytest.approx(by_differences, abs=1e-5 * size)


def test_hessian_over_a_step_across_triangles(ball: MeshContact) -> None:
    """On a ball of triangles it is the mean over many of them, not that of one corner."""
    x = bent(size=0.0)
    p = np.zeros_like(x)
    p[:, 0] = 0.1  # several triangles along the face
    true = ((ball.gradient(x + p) - ball.gradient(x - p)) * p).sum() / 2
    model = p.ravel() @ dense(ball, x, PATTERN) @ p.ravel()
    assert model == pytest.approx(
        true, abs=0.25 * abs(p.ravel() @ dense(ball, x, PATTERN, Projection.FULL) @ p.ravel())
    )


@pytest.mark.parametrize("projection", [Projection.STRAINED, Projection.FULL])
@pytest.mark.parametrize("crossings", [False, True])
def test_projected_hessian_is_positive(projection: Projection, crossings: bool) -> None:
    values = np.linalg.eigvalsh(dense(turned_ball(crossings), bent(), PATTERN, projection))
    assert values.max() > 1e-2
    assert values.min() > -1e-12 * values.max()


def test_friction_gradient_and_hessian_are_slopes(ball: MeshContact) -> None:
    x = bent()
    friction, y = rubbing(ball, x), bent(1)
    g = friction.gradient(y)
    assert np.abs(g).max() > 1e-3
    assert g.ravel() == pytest.approx(slope(friction.value, y, 1e-6), abs=1e-6 * np.abs(g).max())
    stiffness = dense(friction, y, PATTERN)
    by_differences = slope(lambda z: friction.gradient(z).ravel(), y, 1e-6)
    assert stiffness == pytest.approx(by_differences, abs=1e-5 * np.abs(stiffness).max())


def test_forces_on_the_points_add_up_to_those_on_the_nodes(ball: MeshContact) -> None:
    x = bent()
    friction = rubbing(ball, x)
    force, normal, _ = ball.pressure(x)
    assert (force[..., None] * normal).sum((0, 1)) == pytest.approx(-ball.gradient(x).sum(0))
    assert ball.faces.scatter(friction.force(x), len(x)) == pytest.approx(-friction.gradient(x))
    sizes = np.linalg.norm(friction.force(x), axis=-1).sum()
    assert 0.05 * force.sum() < sizes <= 0.6 * force.sum() * 1.001


def test_the_mean_gap_is_weighted_by_force(plate: MeshContact) -> None:
    """On a flat plate every pair is a point and the plane: its gap is the shape's."""
    x = bent()
    force, _, gap = plate.pressure(x)
    assert plate.mean_gap(x) == pytest.approx((force * gap).sum() / force.sum(), rel=1e-6)
    assert plate.least(x) == pytest.approx(gap.min(), rel=1e-6)


def test_flat_contact_pushes_straight_across_whatever_the_triangles() -> None:
    """In random triangles, none of whose corners is at the rim of the face: nothing along it, at any point.

    Crossings of edges push along it and make it several times as stiff if they count by their areas: hence EDGE.
    """
    from scipy.spatial import Delaunay

    flat = np.random.default_rng(5).uniform(-2, 2, (900, 2))
    flat = flat[np.abs(np.abs(flat).max(1) - 0.6) > 0.05]
    flat = np.concatenate([flat, [[-3, -3], [3, -3], [3, 3], [-3, 3]]])
    triangles = Delaunay(flat).simplices[:, ::-1]
    down = np.tile([0.0, 0, -1], (len(flat), 1))
    surface = Triangles(np.column_stack([flat, np.zeros(len(flat))]), triangles, down)
    above = Pose(np.eye(3), np.array([0.0, 0.0, 0.015]))
    contact = replace(against(BoxSdf(6, 6, 0.1), surface, above, 0.0, crossings=True), dhat=0.03)
    g = contact.gradient(POINTS)
    assert np.abs(g[:, :2]).max() < 5e-3 * np.abs(g[:, 2]).max()
    assert np.abs(g.sum(0)[:2]).max() < 1e-3 * abs(g.sum(0)[2])

    V = contact._vertices(POINTS)
    ours = contact.pair.collision
    by_area = ipctk.CollisionMesh(ours.rest_positions, ours.edges, ours.faces)
    by_area.vertex_areas, by_area.can_collide = ours.vertex_areas, ours.can_collide
    with_edges = ipctk.NormalCollisions()
    with_edges.use_area_weighting = True
    with_edges.collision_set_type = ipctk.NormalCollisions.IMPROVED_MAX_APPROX
    with_edges.build(by_area, V, 0.03, 0.0, ipctk.LBVH())
    whole = contact._barrier.gradient(with_edges, by_area, V).reshape(-1, 3)
    along = np.abs(contact.pair.on_nodes(whole)[:, :2]).max()
    assert along > 0.03 * np.abs(contact.pair.on_nodes(whole)[:, 2]).max()
    assert contact.pair.on_nodes(whole)[:, 2].sum() > 2 * g[:, 2].sum()


def test_no_step_passes_a_thin_indenter(ball: MeshContact) -> None:
    p = np.zeros_like(POINTS)
    p[:, 2] = 50.0
    part = ball.max_step(POINTS, p)
    assert 0 < 50 * part < 0.2
    assert ball.max_step(POINTS, -p) == 1.0


def test_the_gel_follows_an_indenter_that_comes_down(ball: MeshContact) -> None:
    """Through air first; then the face goes with it, and what is held stays."""
    low = ball.moved(Pose(ball.pose.rotation, ball.pose.position - np.array([0.2, 0.1, 0.6])), ball.offset)
    stay, ahead = low.starts(POINTS, POINTS, ball.pose)
    fall = (stay - POINTS)[:, 2]
    assert fall == pytest.approx(np.full(25, fall[0]))
    assert -0.6 < fall[0] < -0.4
    for x in (stay, ahead):
        assert not ipctk.has_intersections(low.pair.collision, low._vertices(x), ipctk.LBVH())
        assert low.least(x) > 0
    high = Pose(ball.pose.rotation, ball.pose.position + np.array([0.2, 0.1, 0.6]))
    assert (ball.starts(POINTS, POINTS - np.array([0, 0, 0.1]), high)[0] == POINTS).all()  # nothing in the way


def test_an_indenter_in_the_gel_starts_above_it(ball: MeshContact) -> None:
    inside = Pose(ball.pose.rotation, ball.pose.position - np.array([0, 0, 0.5]))
    clear = ball.clear(inside, POINTS)
    assert (clear.position[:2] == inside.position[:2]).all()
    assert not ipctk.has_intersections(ball.pair.collision, ball.pair.at(POINTS, clear, 0.0), ipctk.LBVH())
