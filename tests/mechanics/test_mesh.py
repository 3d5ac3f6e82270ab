"""Grids: what is fine, what grows, what is named; for any footprint."""

import math
from itertools import pairwise

import numpy as np
import pytest
from helpers import presses
from helpers.presses import poses, scene
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from tacgen.base.errors import UserError
from tacgen.fem.elements import elements, facet_areas
from tacgen.fem.materials import NeoHooke
from tacgen.geometry.analytic_sdf import CapsuleSdf, SphereSdf, TorusSdf
from tacgen.geometry.gel import GelBody, GelLayer
from tacgen.geometry.pose import Pose, about
from tacgen.mechanics import mesh

LAW = NeoHooke(0.05, 0.4)


def gel(*thicknesses: float, corner: float = 0.0) -> GelBody:
    """12 x 10 mm, layers from the base up."""
    return GelBody(12.0, 10.0, corner, layers=tuple(GelLayer(t, LAW, 0.15) for t in thicknesses))


@settings(max_examples=200, deadline=None)
@given(
    half=st.floats(3, 20),
    edge=st.floats(0.1, 1.0),
    middle=st.floats(-1, 1),
    width=st.floats(0, 1),
    growth=st.floats(1.1, 2.0),
)
def test_graded_intervals(half: float, edge: float, middle: float, width: float, growth: float) -> None:
    """The fine part is a footprint about a place on the pad, an edge or more to each side of it."""
    coarsest, centre = 3.0, middle * half
    fine = (centre - edge - width * half, centre + edge + width * half)
    x = mesh.graded(-half, half, fine, edge, growth, coarsest)
    steps = np.diff(x)
    assert x[[0, -1]] == pytest.approx([-half, half], abs=1e-9)
    assert steps.max() <= max(coarsest, edge * (1 + 1e-9))
    inside = (x[1:] > fine[0] + 1e-9) & (x[:-1] < fine[1] - 1e-9)
    assert steps[inside].max() <= edge * (1 + 1e-9)
    assert steps.min() > 0.3 * edge  # no slivers
    bound = growth * np.maximum(steps[:-1], edge) * (1 + 1e-9)
    assert (steps[1:] <= bound).all()
    assert (steps[:-1] <= growth * np.maximum(steps[1:], edge) * (1 + 1e-9)).all()


@settings(max_examples=100, deadline=None)
@given(layers=st.lists(st.floats(0.05, 4.0), min_size=1, max_size=4), edge=st.floats(0.1, 1.0))
def test_every_interface_is_a_grid_height(layers: list[float], edge: float) -> None:
    z, layer = mesh.heights(gel(*layers), edge, 1.3, 1.0)
    assert len(layer) == len(z) - 1
    assert (np.diff(z) > 0).all()
    assert np.diff(z).max() <= 1.0 + 1e-9
    assert z[-1] == 0
    bounds = np.cumsum([0, *layers]) - sum(layers)
    for number, (low, high) in enumerate(pairwise(bounds)):
        here = np.flatnonzero(layer == number)
        assert z[here[0]] == pytest.approx(low, abs=1e-9)
        assert z[here[-1] + 1] == pytest.approx(high, abs=1e-9)
    assert np.diff(z)[-1] <= edge * (1 + 1e-9)  # fine at the face


def test_a_pad_of_two_layers() -> None:
    pad = gel(2.0, 0.7)
    made = mesh.build(pad, (-2, 2, -1, 1), 0.5)
    x = made.points
    assert x.min(0) == pytest.approx([-6, -5, -2.7])
    assert x.max(0) == pytest.approx([6, 5, 0])
    volume = elements(x, made.cells).weights.sum(1)  # refuses cells that are inside out
    assert volume.sum() == pytest.approx(12 * 10 * 2.7)
    assert [volume[made.layer == k].sum() for k in (0, 1)] == pytest.approx([240, 84])
    centre = x[made.cells].mean(1)
    assert (centre[made.layer == 0, 2] < -0.7).all()
    assert (centre[made.layer == 1, 2] > -0.7).all()
    assert len(np.unique(made.cells)) == len(x)  # no node is left over


def test_facets_are_named_and_seen_from_outside() -> None:
    made = mesh.build(gel(2.0, 0.7), (-2, 2, -1, 1), 0.5)
    assert set(made.facets) == {"bonded", "coated"}
    for name, z, out in (("bonded", -2.7, -1.0), ("coated", 0.0, 1.0)):
        quads = made.facets[name]
        area, normal = facet_areas(made.points, quads)
        assert area.sum() == pytest.approx(120)
        assert made.points[np.unique(quads), 2] == pytest.approx(z)
        assert normal[..., 2] == pytest.approx(out)
        assert len(np.unique(np.sort(quads), axis=0)) == len(quads)


def test_cells_under_the_footprint_are_fine() -> None:
    made = mesh.build(gel(2.0), (1.0, 3.0, -2.0, -1.0), 0.5)
    corners = made.points[made.facets["coated"]][..., :2]
    size, centre = np.ptp(corners, axis=1), corners.mean(1)
    inside = (np.abs(centre - [2.0, -1.5]) < [1.0, 0.5]).all(1)
    assert inside.sum() == 8
    assert size[inside].max() <= 0.5 + 1e-9
    assert size.max() > 1.0


def test_a_press_in_the_middle_has_a_mesh_that_mirrors_in_x_and_y() -> None:
    """On a pad of the Mini's sides, of which an edge is no part: what is not even in the mesh is not in the maps."""
    made = scene(SphereSdf(4.0), poses([(0.0, 0.0, -1.0)]), pad=presses.gel(25.25, 20.75, 4.0), edge=0.36)
    x0, x1, y0, y1 = mesh.footprint(made)
    assert (x0, y0) == pytest.approx((-x1, -y1), abs=1e-12)
    points = mesh.of(made).points
    for mirror in ([-1, 1, 1], [1, -1, 1]):
        assert cKDTree(points).query(points * mirror)[0].max() < 1e-12


def test_what_a_thin_indenter_leaves_below_the_face_is_fine_too() -> None:
    """A ring of 1 mm, pressed by 2 mm in one frame, is nowhere in the untouched face at the end."""
    made = scene(TorusSdf(3.0, 0.5), poses([(0.0, 0.0, -2.0)]), edge=0.4)
    x0, x1, y0, y1 = mesh.footprint(made)
    assert min(-x0, x1, -y0, y1) >= 3.0


def test_a_turning_path_touches_what_lies_inside_at_any_of_its_poses() -> None:
    """Around a corner of the face, which itself hardly moves in the indenter's frame."""
    path = poses([(-6.0, -5.0, -0.4)] * 6)
    for k, pose in enumerate(path):
        pose[:3, :3] = about(np.eye(3)[2], 0.2 * k)
    made = scene(CapsuleSdf(1.0, 16.0), path, pad=gel(2.0), edge=0.6)
    step = made.edge / mesh.FACE_POINTS_PER_EDGE
    x, y = (np.linspace(-size / 2, size / 2, math.ceil(size / step) + 1) for size in (12.0, 10.0))
    face = np.stack([*np.meshgrid(x, y), np.zeros((len(y), len(x)))], -1).reshape(-1, 3)
    inside = np.any([made.shape.value(Pose.of(pose).local(face)) < 0 for pose in path], axis=0)
    assert mesh.touched(made) == pytest.approx(face[inside])


def test_cells_lie_alike_around_the_start_of_a_slide() -> None:
    path = poses([(0.0, 0.0, -1.0), (1.0, 0.0, -1.0)])
    made = scene(SphereSdf(4.0), path, pad=presses.gel(25.25, 20.75, 4.0), edge=0.36)
    points = mesh.of(made).points
    near = points[(np.abs(points[:, :2]) < 3.0).all(1)]
    assert len(near) > 1000
    assert cKDTree(points).query(near * [-1, 1, 1])[0].max() < 1e-9


def test_columns_outside_the_rounded_outline_are_left_out() -> None:
    pad = gel(2.0, corner=2.5)
    made = mesh.build(pad, (-6, 6, -5, 5), 0.25)
    centre = made.points[made.cells].mean(1)
    assert pad.contains(centre[:, 0], centre[:, 1]).all()
    area = facet_areas(made.points, made.facets["coated"])[0].sum()
    assert area == pytest.approx(120 - (4 - np.pi) * 2.5**2, rel=5e-3)
    assert facet_areas(made.points, made.facets["bonded"])[0].sum() == pytest.approx(area)
    assert elements(made.points, made.cells).weights.sum() == pytest.approx(2 * area)
    assert np.abs(made.points[:, :2]).max(0) == pytest.approx([6, 5])


def test_a_mesh_that_no_machine_could_solve_is_refused() -> None:
    pad = gel(3.0)
    with pytest.raises(UserError, match=r"quality.edge_mm: 0.01 mm .* gives .* nodes"):
        mesh.build(pad, (-4.0, 4.0, -4.0, 4.0), 0.01)


def test_a_pad_ten_times_as_large_has_as_many_nodes() -> None:
    small, large = gel(3.0), GelBody(120.0, 100.0, layers=(GelLayer(30.0, LAW, 0.15),))
    one = mesh.build(small, (-2.0, 2.0, -2.0, 2.0), 0.8)
    ten = mesh.build(large, (-20.0, 20.0, -20.0, 20.0), 8.0)
    assert len(ten.points) == len(one.points)
