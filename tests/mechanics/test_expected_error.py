"""The expected error of the force by the mesh: its width of contact, its formula, and errors that were measured."""

import math

import numpy as np
import pytest
import trimesh
from helpers.meshes import ball, field_of

from tacgen.base.errors import UserError
from tacgen.geometry.analytic_sdf import CapsuleSdf, ConeSdf, Shape, SphereSdf, TorusSdf, WedgeSdf
from tacgen.geometry.outline import Pad
from tacgen.geometry.pose import Pose, about
from tacgen.mechanics.expected_error import (
    ERROR_ESTIMATE_FACTOR,
    MAX_EXPECTED_ERROR,
    Expected,
    expected_force_error,
    frame_error,
)
from tacgen.mechanics.face_overlap import MIN_OVERLAP_POINTS, FaceGrid, Overlap

PAD = Pad(25.0, 20.0)


def lowered(depth: float) -> np.ndarray:
    pose = np.eye(4)
    pose[2, 3] = -depth
    return pose


def test_the_width_of_a_disc_is_its_radius() -> None:
    radius, depth = 4.0, 0.8
    disc = math.sqrt(2 * radius * depth - depth**2)
    face = FaceGrid.of(PAD, 0.05)
    assert face.overlap(SphereSdf(radius), lowered(depth)).width == pytest.approx(disc, rel=0.02)
    area, perimeter = face.overlap(SphereSdf(radius), lowered(depth))
    assert area == pytest.approx(math.pi * disc**2, rel=0.02)
    assert perimeter == pytest.approx(2 * math.pi * disc, rel=0.03)


@pytest.mark.parametrize("shape", [SphereSdf(0.3), CapsuleSdf(1, 6), TorusSdf(6, 0.5), WedgeSdf(0.8, 0.2, 9.0)])
def test_the_overlap_is_that_of_all_points(shape: Shape) -> None:
    """Though only blocks near the indenter are looked at; on a domed face."""
    pad = Pad(25.0, 20.0, radii=(30.0, 40.0))
    face, pose = FaceGrid.of(pad, 0.11), np.eye(4)
    for angle, x, y in ((0.3, 1.3, -2.1), (1.9, 11.0, 8.0)):
        pose[:3, 3] = x, y, float(pad.top(x, y)) - 0.3
        pose[:3, :3] = about(np.eye(3)[0], 0.2) @ about(np.eye(3)[2], angle)
        hit = face.inside & (shape.value(Pose.of(pose).local(face.points)) < 0)
        assert hit.any()
        few = hit.sum() < MIN_OVERLAP_POINTS  # counted on a finer grid
        assert face.overlap(shape, pose).area == pytest.approx(hit.sum() * face.step**2, rel=0.2 if few else 1e-9)


def disc(radius: float) -> Overlap:
    return Overlap(math.pi * radius**2, 2 * math.pi * radius)


def strip(width: float, length: float) -> Overlap:
    return Overlap(width * length, 2 * (width + length))


@pytest.mark.parametrize("radius", [0.02, 0.1, 0.3])
def test_a_contact_narrower_than_the_grid_is_measured(radius: float) -> None:
    """Points are .2 mm apart; wherever the tip is between them."""
    for x, y in ((0.0, 0.0), (0.07, 0.13)):
        pose = lowered(0.4)
        pose[:2, 3] = x, y
        found = FaceGrid.of(PAD).overlap(ConeSdf(math.atan(radius / 0.4), 1e-4), pose)
        assert found.width == pytest.approx(radius, rel=0.15)


def test_without_contact_it_is_not_known() -> None:
    assert FaceGrid.of(PAD).overlap(SphereSdf(4), lowered(-0.1)) == (0, 0)
    assert math.isnan(frame_error(PAD, SphereSdf(4), lowered(-0.1), 0.36))


def test_of_smooth_shapes_it_falls_with_the_edge_and_with_the_width() -> None:
    def smooth(edge: float, radius: float) -> float:
        return expected_force_error(edge, disc(radius), math.inf)

    assert smooth(1.0, 1.0) == pytest.approx(0.110)
    assert smooth(0.5, 1.0) / smooth(1.0, 1.0) == pytest.approx(0.5**1.8)
    assert smooth(0.5, 4.0) / smooth(0.5, 1.0) == pytest.approx(4**-0.45)


def test_sharp_edges_add_to_it() -> None:
    """Fully from two thirds of a radius on; of tips more than of edges as wide."""
    smooth, sharp = (expected_force_error(0.36, disc(1.0), radius) for radius in (math.inf, 0.0))
    assert sharp - smooth == pytest.approx(0.2 * 0.36 / math.pi**0.25)
    assert expected_force_error(0.36, disc(1.0), 1.5 * 0.36) == pytest.approx(sharp)
    assert expected_force_error(0.36, disc(1.0), 2 * 1.5 * 0.36) - smooth == pytest.approx((sharp - smooth) / 2)
    assert expected_force_error(0.36, disc(0.3), 0.0) > 1.5 * expected_force_error(0.36, strip(0.6, 8.0), 0.0)


@pytest.mark.parametrize(
    ("contact", "radius", "edge", "measured"),
    [
        # a torus on DIGIT, by scripts/edge_law.py, last in commit f8101efd
        (disc(1.786), 1.4, 1.2, 0.1274),
        (disc(1.786), 1.4, 0.6, 0.0392),
        (disc(1.786), 1.4, 0.42, 0.0179),
        # by benchmarks/sharp.py: a cone of 11.3 deg, 1.5 mm deep, a block on its corner and a box of 5 x 3 mm
        (disc(0.3), 0.0, 0.36, 0.23),
        (Overlap(0.94, 4.4), 0.0, 0.36, 0.137),
        (strip(3.0, 5.0), 0.2, 0.36, 0.040),
        (strip(3.0, 5.0), 0.2, 0.6, 0.104),
    ],
)
def test_it_is_within_its_factor_of_what_was_measured(
    contact: Overlap, radius: float, edge: float, measured: float
) -> None:
    times = expected_force_error(edge, contact, radius) / measured
    assert 1 / ERROR_ESTIMATE_FACTOR < times < ERROR_ESTIMATE_FACTOR


def test_of_a_mesh_the_radius_is_that_of_the_part_that_touches() -> None:
    """A hemisphere: the gel does not reach its sharp rim."""
    corners = ball(4).vertices
    half = trimesh.convex.convex_hull(corners[corners[:, 2] < 1e-9])
    field = field_of(half, 0.3, height=5.0, half=20.0)
    assert field.smallest_radius == pytest.approx(0.02)  # within the height that a press can reach
    assert FaceGrid.of(PAD).radius(field, lowered(0.8)) > 3
    lying = lowered(0.5)
    lying[:3, :3] = about(np.array([1.0, 0, 0]), math.pi / 2)
    lying[2, 3] = 3.5
    assert FaceGrid.of(PAD).radius(field, lying) == pytest.approx(0.02)


def test_what_no_frame_can_resolve_is_refused_with_an_edge_that_can() -> None:
    contact = disc(0.12)
    told = Expected(expected_force_error(0.6, contact, 0.05), 0.6, contact, 0.05)
    assert told.error > MAX_EXPECTED_ERROR
    said = r"quality: edges of 0\.6 mm are too long for a contact 0\.12 mm wide"
    with pytest.raises(UserError, match=said) as refused:
        told.refuse()
    fine = float(refused.value.lines[0].partition("edge_mm: ")[2].rstrip("}"))
    assert expected_force_error(fine, contact, 0.05) < MAX_EXPECTED_ERROR
    Expected(0.49, 0.6, contact, 0.05).refuse()
