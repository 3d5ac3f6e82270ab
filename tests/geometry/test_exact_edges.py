"""Sharp edges and tips of meshes against the closed forms of the same bodies with round ones."""

import math

import numpy as np
import pytest
import trimesh
from helpers.meshes import ball, box, differences, field_of

from benchmarks import sharp
from tacgen.geometry.analytic_sdf import BoxSdf, ConeSdf, WedgeSdf
from tacgen.geometry.exact_edges import SharpField
from tacgen.geometry.sdf_grid import Field
from tacgen.physics.edges import MAX_CONTACT_RADII

Array = np.ndarray
RADIUS, CELL = 0.02, 0.15
HALF = math.radians(15)

pytestmark = pytest.mark.usefixtures("own_cache")


def around(low: float, high: float, count: int = 2000) -> Array:
    """Points near the lowest point of an indenter."""
    rng = np.random.default_rng(0)
    return np.column_stack([rng.uniform(-0.4, 0.4, (count, 2)), rng.uniform(low, high, count)])


# a body opened by a ball: its tip recedes by what the ball does not reach
OPENED = {
    "wedge": (sharp.wedge(15), WedgeSdf(HALF, RADIUS, 8.0), RADIUS * (1 / math.sin(HALF) - 1), 1e-9),
    # 64 flat sides: they lie inside the cone by 1.2 thousandths of its radius
    "cone": (sharp.cone(40), ConeSdf(math.radians(40), RADIUS), RADIUS * (1 / math.sin(math.radians(40)) - 1), 1e-3),
    "edges of a flat face": (box(0.5, 0.4, 3), BoxSdf(0.5, 0.4, RADIUS), 0.0, 1e-9),
}


@pytest.mark.parametrize("name", OPENED)
def test_distance_normal_and_curvature_are_the_opened_bodys(name: str) -> None:
    """On cells seven times as long as its radius; everywhere that contact can act."""
    mesh, closed_form, recedes, off = OPENED[name]
    found, p = field_of(mesh, CELL), around(-0.1, 0.5)
    assert isinstance(found, SharpField)
    d, n, H = closed_form.distance(p - [0, 0, recedes])
    near = (np.abs(d) < RADIUS * 0.99) & (np.abs(p[:, 1]) < 3)
    assert near.sum() > 50
    got, slope, bend = (part[near] for part in found.distance(p))
    assert got == pytest.approx(d[near], abs=off)
    if off < 1e-6:
        assert slope == pytest.approx(n[near], abs=1e-6)
        assert bend == pytest.approx(H[near], abs=1e-4 / RADIUS)


def tube() -> trimesh.Trimesh:
    """Thinner than a cell, with creases of 15 deg inside."""
    return trimesh.creation.annulus(r_min=0.25, r_max=0.35, height=3, sections=24)


SHAPES = [lambda: sharp.wedge(15), lambda: sharp.block((4, 4, 4), (1, 1, 1)), tube]


@pytest.mark.parametrize("make", SHAPES)
def test_gradient_and_hessian_are_slopes(make) -> None:
    """Also where the exact distance passes into the spline."""
    found, p, h = field_of(make(), CELL), around(-0.2, 0.8, 3000), 1e-6
    p = p[found.value(p) < MAX_CONTACT_RADII / 2 * RADIUS]  # farther away nothing needs them
    assert len(p) > 50
    _, g, H = found.distance(p)
    slopes, bends = differences(found, p, h)
    smooth = np.linalg.norm(bends - H, axis=(1, 2)) < 1  # the distance bends at once behind an edge's last face
    assert smooth.mean() > 0.97
    off = np.abs(g - slopes).max(1)
    assert (off < 1e-6).mean() > 0.998
    assert off.max() * 2 * h < 1e-3 * RADIUS  # where a corner comes nearest the distance may jump, by nanometres
    assert np.linalg.norm(g, axis=1).max() > 0.99
    assert H[smooth] == pytest.approx(bends[smooth], abs=2e-3 * np.abs(H).max())


def test_a_smooth_body_stays_a_spline() -> None:
    assert type(field_of(ball(4), CELL)) is Field


def test_a_tip_is_found_where_no_edge_is_sharp() -> None:
    """The sides of a cone of 64 triangles meet at 4 deg."""
    found = field_of(sharp.cone(40), CELL)
    assert found.smallest_radius == pytest.approx(RADIUS)
    assert found.convex is not None
    assert np.abs(found.convex.tips - [0, 0, 0]).sum(1).min() == pytest.approx(0, abs=1e-9)
    assert field_of(ball(4), CELL).smallest_radius > 3
    beside = found.convex.smallest(lambda at: (at[:, 2] > 0.3) & (at[:, 2] < 4))
    assert beside > 10 * RADIUS  # that part of the cone is smooth


def test_overlapping_bodies_are_one() -> None:
    """Edges of one that lie inside the other are no surface."""
    block, other = box(2, 2, 2), box(2, 2, 2)
    other.apply_translation([0.3, 0.3, 0])
    found = field_of(trimesh.util.concatenate([block, other]), 0.1, 2)
    inner = np.array([[0.85, 0.85, 0.15], [-0.85, -0.85, 0.15]])  # beside a vertical edge of the other body
    assert (found.value(inner) < -0.1).all()
    floor = np.column_stack([np.linspace(-0.9, 0.9, 30), np.linspace(-0.9, 0.9, 30), np.full(30, -0.01)])
    assert found.value(floor) == pytest.approx(0.01, abs=1e-6)


def test_beside_a_crease_the_normal_turns_and_does_not_jump() -> None:
    """Around the rim of a tube's bore, as close as contact comes; without that the solver zigzags across the crease."""
    found = field_of(tube(), CELL)
    turn = np.linspace(0, np.pi, 20_001)
    for radius, z in ((0.24, 0.3), (0.242, -0.006)):
        ring = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(len(turn), z)])
        d, n, H = found.distance(ring)
        assert (np.abs(d) < RADIUS).all()
        turned = np.linalg.norm(np.diff(n, axis=0), axis=1)
        apart = np.linalg.norm(np.diff(ring, axis=0), axis=1)
        assert (turned < 6 / RADIUS * apart).all()
        assert turned.sum() == pytest.approx(np.pi, rel=0.3)
        assert np.linalg.norm(H, axis=(1, 2)).max() < 6 / RADIUS
