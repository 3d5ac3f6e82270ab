"""The expected error of the force by the mesh: its width of contact, its formula, and errors that were measured."""

import math

import numpy as np
import pytest

from tacgen.geometry.analytic_sdf import CapsuleSdf, Shape, SphereSdf, TorusSdf, WedgeSdf
from tacgen.geometry.outline import Pad
from tacgen.geometry.pose import Pose, about
from tacgen.mechanics.expected_error import FACTOR, FaceGrid, expected_force_error

PAD = Pad(25.0, 20.0)


def lowered(depth: float) -> np.ndarray:
    pose = np.eye(4)
    pose[2, 3] = -depth
    return pose


def test_the_width_of_a_disc_is_its_radius() -> None:
    radius, depth = 4.0, 0.8
    disc = math.sqrt(2 * radius * depth - depth**2)
    face = FaceGrid.of(PAD, 0.05)
    assert face.width(SphereSdf(radius), lowered(depth)) == pytest.approx(disc, rel=0.02)
    area, perimeter = face.overlap(SphereSdf(radius), lowered(depth))
    assert area == pytest.approx(math.pi * disc**2, rel=0.02)
    assert perimeter == pytest.approx(2 * math.pi * disc, rel=0.03)


def test_a_long_contact_is_as_wide_as_it_is_short() -> None:
    face = FaceGrid.of(PAD)
    ball, rod = (face.width(shape, lowered(0.5)) for shape in (SphereSdf(2), CapsuleSdf(2, 8)))
    assert ball < rod < 2 * ball


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
        assert face.overlap(shape, pose)[0] == pytest.approx(hit.sum() * face.step**2)


def test_without_contact_it_is_not_known() -> None:
    assert math.isnan(FaceGrid.of(PAD).width(SphereSdf(4), lowered(-0.1)))
    assert math.isnan(expected_force_error(0.36, math.nan))


def test_it_falls_with_the_edge_and_with_the_width() -> None:
    assert expected_force_error(1.0, 1.0) == pytest.approx(0.110)
    assert expected_force_error(0.5, 1.0) / expected_force_error(1.0, 1.0) == pytest.approx(0.5**1.8)
    assert expected_force_error(0.5, 4.0) / expected_force_error(0.5, 1.0) == pytest.approx(4**-0.45)


@pytest.mark.parametrize(
    ("width", "edge", "measured"),
    [(1.786, 1.2, 0.1274), (1.786, 0.6, 0.0392), (1.786, 0.42, 0.0179)],  # a torus on DIGIT, by scripts/edge_law.py
)
def test_it_is_within_its_factor_of_a_scene_that_the_fit_has_not_seen(
    width: float, edge: float, measured: float
) -> None:
    assert measured / FACTOR < expected_force_error(edge, width) < measured * FACTOR
