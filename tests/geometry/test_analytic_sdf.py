"""Signed distances of all indenters, over random sizes and turned points, and their triangles."""

import numpy as np
import pytest
import trimesh
from helpers.meshes import differences
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from tacgen.geometry import surface_nets
from tacgen.geometry.analytic_sdf import BoxSdf, CapsuleSdf, ConeSdf, CylinderSdf, Shape, SphereSdf, TorusSdf, WedgeSdf
from tacgen.geometry.surface_nets import Triangles

Array = np.ndarray


def between(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_subnormal=False)


ANGLE = between(np.radians(10), np.radians(80))
KINDS: dict[str, st.SearchStrategy[Shape]] = {
    "sphere": st.builds(SphereSdf, between(0.2, 8)),
    "capsule": st.builds(CapsuleSdf, between(0.2, 4), between(0.1, 8)),
    "torus": st.builds(lambda tube, hole: TorusSdf(tube + hole, tube), between(0.2, 2), between(0.1, 4)),
    "cylinder": st.builds(lambda fillet, flat: CylinderSdf(fillet + flat, fillet), between(0.05, 1), between(0.1, 4)),
    "cylinder with two ends": st.builds(
        lambda fillet, flat, long: CylinderSdf(fillet + flat, fillet, 2 * fillet + long),
        between(0.05, 1), between(0.1, 4), between(0.1, 6),
    ),
    "box": st.builds(
        lambda fillet, x, y: BoxSdf(2 * fillet + x, 2 * fillet + y, fillet), between(0.05, 1), *[between(0.1, 6)] * 2
    ),
    "cone": st.builds(ConeSdf, ANGLE, between(0.05, 2)),
    "wedge": st.builds(lambda a, tip, flat: WedgeSdf(a, tip, 2 * tip + flat), ANGLE, between(0.05, 1), between(0.1, 6)),
}  # fmt: skip
SHAPES = st.one_of(*KINDS.values())
SPHERE = SphereSdf(4.0)
EACH: dict[Shape, float] = {  # and its smallest radius
    SPHERE: 4.0, CapsuleSdf(1.5, 4.0): 1.5, TorusSdf(3.0, 0.8): 0.8, CylinderSdf(2.0, 0.2): 0.2,
    CylinderSdf(2.0, 0.2, 3.0): 0.2, BoxSdf(3.0, 5.0, 0.3): 0.3, ConeSdf(np.radians(40), 0.3): 0.3,
    WedgeSdf(np.radians(30), 0.2, 4.0): 0.2,
}  # fmt: skip
SEED = st.integers(0, 2**32 - 1)


def cloud(seed: int, n: int = 60) -> Array:
    """Points all around the lower end of an indenter, inside and outside."""
    return np.random.default_rng(seed).uniform([-9, -9, -3], [9, 9, 9], (n, 3))


def smooth_ones(shape: Shape, p: Array, h: float) -> Array:
    """The points outside that are not within a few h of where curvature jumps or distance has a crease."""
    steps = 3 * h * np.concatenate([np.eye(3), -np.eye(3), [[1, 1, 1], [-1, -1, -1], [1, -1, 1]]])
    H = shape.distance(p)[2]
    around = np.array([shape.distance(p + s)[2] for s in steps])
    even = np.abs(around - H).max((0, 2, 3)) < 1e-2 * (1 + np.abs(H).max((1, 2)))
    return np.asarray(p[even & (shape.distance(p)[0] > 0)])


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=10, deadline=None)
@given(data=st.data(), seed=SEED)
def test_the_value_alone_is_the_distance(kind: str, data: st.DataObject, seed: int) -> None:
    shape, p = data.draw(KINDS[kind]), cloud(seed)
    assert (shape.value(p) == shape.distance(p)[0]).all()
    assert all((one == other).all() for one, other in zip(shape.gradient(p), shape.distance(p)[:2], strict=True))


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=12, deadline=None)
@given(data=st.data(), seed=SEED)
def test_gradient_and_hessian_are_slopes(kind: str, data: st.DataObject, seed: int) -> None:
    shape = data.draw(KINDS[kind])
    h = 1e-5
    p = smooth_ones(shape, cloud(seed), h)
    assume(len(p) > 5)
    _, n, H = shape.distance(p)
    assert np.linalg.norm(n, axis=1) == pytest.approx(np.ones(len(p)), abs=1e-12)
    slopes, bends = differences(shape, p, h)
    scale = 1 + np.abs(H).max((1, 2))[:, None, None]
    assert n == pytest.approx(slopes, abs=1e-6)
    assert H / scale == pytest.approx(bends / scale, abs=1e-5)
    assert H - H.swapaxes(1, 2) == pytest.approx(np.zeros_like(H), abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(shape=SHAPES, seed=SEED, reach=between(1e-6, 5))
def test_distance_is_1_lipschitz(shape: Shape, seed: int, reach: float) -> None:
    """Newton's longest safe step rests on this, inside as well as outside."""
    a = cloud(seed)
    b = a + reach * np.random.default_rng(seed + 1).normal(size=a.shape)
    change = np.abs(shape.distance(a)[0] - shape.distance(b)[0])
    assert (change <= np.linalg.norm(a - b, axis=1) + 1e-12).all()


@settings(max_examples=40, deadline=None)
@given(shape=SHAPES, seed=SEED)
def test_its_lowest_point_is_on_the_plane(shape: Shape, seed: int) -> None:
    contact = [0.0, 0.0, 0.0] if not isinstance(shape, TorusSdf) else [shape.radius, 0.0, 0.0]
    d, n, _ = shape.distance(np.array([contact]))
    assert d[0] == pytest.approx(0, abs=1e-12)
    assert n[0] == pytest.approx([0, 0, -1], abs=1e-9)
    p = cloud(seed)
    p[:, 2] = -np.abs(p[:, 2])
    assert (shape.distance(p)[0] >= -p[:, 2] - 1e-12).all()


def surface(shape: Shape, seed: int) -> Array:
    """Points on the surface, found by walking along the gradient from those around it."""
    p = cloud(seed, 1000)
    for _ in range(3):
        d, n, _ = shape.distance(p)
        p = p - d[:, None] * n
    return np.asarray(p[np.abs(shape.distance(p)[0]) < 1e-9])


@settings(max_examples=10, deadline=None)
@given(shape=SHAPES, seed=SEED, down=between(0, np.pi), around=between(0, 2 * np.pi))
@example(shape=SPHERE, seed=0, down=0.0, around=0.0)
def test_support_is_how_far_it_extends(shape: Shape, seed: int, down: float, around: float) -> None:
    """Bounded from both sides: no point of the surface is beyond, and a climb along it gets there."""
    direction = np.array([np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), -np.cos(down)])
    support = shape.support(direction)
    at = surface(shape, seed)
    assert len(at) > 50
    assert (at @ direction).max() <= support + 1e-9
    here, reached = at[(at @ direction).argmax()], []
    for _ in range(1000):  # climb: a step that way, then back onto the surface
        here = here + 0.1 * direction
        d, n, _ = shape.distance(here[None])
        here = here - d[0] * n[0]
        reached.append(here @ direction)
    if np.isinf(support):
        assert reached[-1] > reached[len(reached) // 2] + 1e-9
    else:
        assert reached[-1] == pytest.approx(support, abs=0.01 * (1 + abs(support)))


@settings(max_examples=40, deadline=None)
@given(shape=SHAPES, seed=SEED)
def test_points_inside_are_pushed_out(shape: Shape, seed: int) -> None:
    """The gradient is the way out, all the way: after |d| along it a point is out, and further out beyond."""
    p = cloud(seed, 400)
    d, n, _ = shape.distance(p)
    p, d, n = p[d < 0], d[d < 0], n[d < 0]
    assert np.linalg.norm(n, axis=1) == pytest.approx(np.ones(len(p)), abs=1e-12)
    assert shape.distance(p - d[:, None] * n)[0] == pytest.approx(np.zeros(len(p)), abs=1e-9)
    assert shape.distance(p - (d - 0.1)[:, None] * n)[0] == pytest.approx(np.full(len(p), 0.1), abs=1e-9)


@pytest.mark.parametrize("shape", EACH, ids=lambda s: type(s).__name__)
def test_its_centre_is_inside_and_has_a_distance(shape: Shape) -> None:
    """On axes of symmetry the distance has no gradient; some unit vector must be given all the same."""
    axis = np.array([[0.0, 0.0, z] for z in (0.1, shape.smallest_radius, 1.0, 2.0)])
    d, n, H = shape.distance(axis)
    assert np.isfinite(d).all()
    assert np.isfinite(H).all()
    assert np.linalg.norm(n, axis=1) == pytest.approx(np.ones(4), abs=1e-12)
    if not isinstance(shape, TorusSdf):
        assert (d < 0).all()


def test_known_distances() -> None:
    p, side, end = (3.0, 4.0, 1.0), (5.0, 0.0, 5.0), (0.0, 5.0, 3.0)
    tip = 0.2 * (np.sqrt(2) - 1)  # by which the tip of the sharp one of 45 deg would be below z = 0
    wedge = WedgeSdf(np.pi / 4, 0.2, 4.0)
    for shape, at, distance in (
        (SphereSdf(1.0), p, 4.0),
        (CapsuleSdf(1.0, 4.0), p, np.hypot(1, 4) - 1),
        (TorusSdf(2.0, 1.0), p, 3 - 1),
        (CylinderSdf(2.0, 0.5), p, 3.0),
        (BoxSdf(2.0, 2.0, 0.5), p, np.hypot(2.5, 3.5) - 0.5),
        (ConeSdf(np.pi / 4, 0.2), side, -tip / np.sqrt(2)),
        (wedge, side, -tip / np.sqrt(2)),
        (wedge, end, 3.0),
    ):
        assert shape.value(np.array([at])) == pytest.approx(distance, rel=1e-9), shape


def test_shape_sizes_that_the_solver_relies_on() -> None:
    for shape, radius in EACH.items():
        assert shape.smallest_radius == radius
        assert shape.reach >= radius


def solid(found: Triangles) -> trimesh.Trimesh:
    return trimesh.Trimesh(found.vertices, found.triangles, process=False)


@pytest.mark.parametrize("shape", [*list(EACH)[:-1], SphereSdf(0.3), WedgeSdf(0.5, 0.2, 8.0)], ids=repr)
def test_triangles_lie_on_the_shape(shape: Shape) -> None:
    found = surface_nets.of_shape(shape, half=12, height=4, tolerance=0.01)
    mesh = solid(found)
    assert np.abs(shape.value(found.vertices)).max() < 1e-9
    for middle in (mesh.triangles_center, found.vertices[mesh.edges_unique].mean(1)):
        assert np.abs(shape.distance(middle)[0]).max() <= 0.01
    assert (mesh.face_normals * shape.distance(mesh.triangles_center)[1]).sum(1).min() > 0.4
    assert mesh.is_winding_consistent
    assert np.degrees(mesh.face_angles).min() > 2
    assert found.vertices[:, 2].min() < 0.01
    open_edges = trimesh.grouping.group_rows(mesh.edges_sorted, require_count=1)
    assert (found.vertices[mesh.edges[open_edges]][..., 2] > 3.9).all()  # cut off only where the gel cannot be
    assert mesh.is_watertight == (shape.support(np.array([0, 0, 1.0])) < 4)


def test_finer_where_it_is_rounder() -> None:
    found = surface_nets.of_shape(BoxSdf(8.0, 8.0, 0.2), half=12, height=3, tolerance=0.003)
    area = solid(found).area_faces
    flat = (found.vertices[found.triangles][:, :, 2] < 1e-9).all(1)
    assert area[flat].max() > 30 * np.median(area)
    assert len(area) < 20_000
