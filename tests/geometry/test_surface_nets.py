"""Triangles of analytic shapes: on the surface, facing outward."""

import numpy as np
import pytest
import trimesh

from tacgen.geometry import surface_nets
from tacgen.geometry.analytic_sdf import BoxSdf, CapsuleSdf, ConeSdf, CylinderSdf, Shape, SphereSdf, TorusSdf, WedgeSdf
from tacgen.geometry.surface_nets import Triangles

SHAPES: list[Shape] = [
    SphereSdf(4.0), SphereSdf(0.3), CylinderSdf(3.0, 0.2), BoxSdf(4.0, 3.0, 0.2), ConeSdf(0.5, 0.1),
    WedgeSdf(0.5, 0.2, 8.0),
    CapsuleSdf(0.5, 5.0), TorusSdf(4.0, 0.6),
]  # fmt: skip


def solid(found: Triangles) -> trimesh.Trimesh:
    return trimesh.Trimesh(found.vertices, found.triangles, process=False)


@pytest.mark.parametrize("shape", SHAPES, ids=repr)
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
