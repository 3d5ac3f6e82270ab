"""Triangles of indenters: on the surface, facing outward, and with what is sharp followed by vertices."""

import numpy as np
import pytest
import trimesh

from tacgen.geometry import surface_nets
from tacgen.geometry.analytic_sdf import (
    BoxSdf,
    CapsuleSdf,
    ConeSdf,
    CylinderSdf,
    Shape,
    SphereSdf,
    TorusSdf,
    Triangles,
    WedgeSdf,
)

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
    d, n, _ = shape.distance(found.vertices)
    assert np.abs(d).max() < 1e-9
    assert found.outward == pytest.approx(n)
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


def cube() -> trimesh.Trimesh:
    return trimesh.creation.box((4.0, 4.0, 4.0), transform=trimesh.transformations.translation_matrix([0, 0, 2]))


def test_sharp_edges_are_followed_by_vertices() -> None:
    box = cube()
    found = surface_nets.of_mesh(box.vertices, box.faces, height=5.0, spacing=0.5)
    mesh = solid(found)
    assert mesh.volume == pytest.approx(64)
    sharp = mesh.face_adjacency_edges[mesh.face_adjacency_angles > 0.1]
    assert len(sharp) >= 12 * 8
    assert np.linalg.norm(np.diff(found.vertices[sharp], axis=1), axis=-1).max() <= 0.5
    assert len(surface_nets.of_mesh(box.vertices, box.faces, height=5.0, spacing=9.0).triangles) == 12


def test_what_is_out_of_reach_is_left_out() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=2.0)
    ball.apply_translation([0, 0, 2])
    found = surface_nets.of_mesh(ball.vertices, ball.faces, height=1.0, spacing=9.0)
    assert len(found.triangles) < len(ball.faces) / 3
    assert found.vertices[found.triangles][:, :, 2].min(1).max() < 1.0
    assert len(found.vertices) == len(np.unique(found.triangles))


def test_a_body_shrinks_by_what_it_is_asked_to() -> None:
    """Faces move in parallel, at edges and corners too."""
    box = cube()
    found = surface_nets.of_mesh(box.vertices, box.faces, height=5.0, spacing=0.5)
    smaller = trimesh.Trimesh(found.vertices - 0.1 * found.outward, found.triangles, process=False)
    assert smaller.bounds == pytest.approx(np.array([[-1.9, -1.9, 0.1], [1.9, 1.9, 3.9]]))
    assert smaller.volume == pytest.approx(3.8**3)
