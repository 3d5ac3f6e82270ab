"""Quadrature on facets of every kind: what it integrates, contact on it, and how forces are shared to be drawn."""

import numpy as np
import pytest
from helpers.small import full, patch, slope

from tacgen.fem.elements import facet_areas, facet_corners, facet_hats, facet_points, facet_shares, triangles
from tacgen.geometry.analytic_sdf import SphereSdf
from tacgen.geometry.pose import Pose
from tacgen.mechanics.barrier import Contact
from tacgen.mechanics.coupled import CoupledContact

Array = np.ndarray
KINDS = pytest.mark.parametrize("nodes", [4, 3, 6])


@KINDS
def test_areas_and_normals_of_a_bent_patch(nodes: int) -> None:
    """z = x^2 / 2 on a square of side 1: quadratic triangles lie on it, flat ones come near."""
    points, faces, _ = patch(6, 1.0, nodes)
    assert faces.areas.sum() == pytest.approx(1.0)
    points[:, 2] = points[:, 0] ** 2 / 2
    area, normal = facet_areas(points, faces.conn)
    exact = np.sqrt(1.25) / 2 + np.arcsinh(0.5)
    assert area.sum() == pytest.approx(exact, rel=1e-6 if nodes == 6 else 2e-3)
    x = faces.at(points)[..., 0]
    true = np.stack([-x, 0 * x, np.ones_like(x)], -1) / np.sqrt(1 + x**2)[..., None]
    assert (normal * true).sum(-1).min() > (1 - 1e-12 if nodes == 6 else 0.99)


def test_more_points_a_side_integrate_higher_powers() -> None:
    """u^4 v^4 over [-1, 1]^2 is 4/25: three Gauss points are exact to degree 5, two to degree 3."""
    for along, exact in ((2, False), (3, True)):
        N, _, weights = facet_points(4, along)
        u, v = (N @ facet_corners(4)).T
        assert bool(abs(weights @ (u**4 * v**4) - 4 / 25) < 1e-12) == exact
        assert weights.sum() == pytest.approx(4)


@KINDS
def test_a_force_is_shared_evenly_and_wholly(nodes: int) -> None:
    N, _, weights = facet_points(nodes)
    hats = facet_shares(N, weights[None])
    assert hats.min() >= 0
    assert hats.sum(1) == pytest.approx(1.0)
    place = np.random.default_rng(0).normal(size=(3, 2))  # any linear function is kept
    at = np.concatenate([place, (place + place[[1, 2, 0]]) / 2])[:nodes]
    at = np.array([[0, 0], [2, 0], [2, 1], [0, 1.0]]) if nodes == 4 else at
    assert hats @ at == pytest.approx(N @ at)
    share = weights @ hats / weights.sum()
    pieces = at[triangles(np.arange(nodes)[None])]
    turned = np.linalg.det(pieces[:, 1:] - pieces[:, :1])
    assert (turned * turned[0] > 0).all()
    even = np.bincount(triangles(np.arange(nodes)[None]).ravel(), np.repeat(np.abs(turned), 3)) / 3
    if nodes == 4:
        even[:] = 1
    assert share == pytest.approx(even / even.sum())  # a uniform pressure stays one


@KINDS
def test_hats_are_one_at_their_node_and_straight_on_the_pieces(nodes: int) -> None:
    corners = facet_corners(nodes)
    assert facet_hats(nodes, corners) == pytest.approx(np.eye(nodes))
    if nodes != 4:
        for piece in corners[triangles(np.arange(nodes)[None])]:
            inside = np.array([0.2, 0.3, 0.5]) @ piece
            mean = np.array([0.2, 0.3, 0.5]) @ facet_hats(nodes, piece)
            assert facet_hats(nodes, inside[None])[0] == pytest.approx(mean)


@KINDS
def test_contact_derivatives(nodes: int) -> None:
    points, faces, pat = patch(2, 1.2, nodes)
    x = points + np.random.default_rng(3).uniform(-0.05, 0.05, points.shape)
    contact = Contact(faces, SphereSdf(0.8), Pose(np.eye(3), np.array([0.1, 0.0, 0.02])), 0.3, 0.7, 0.04)
    coupled = CoupledContact(contact, 0.0, faces.at(x), 0.1)
    found = coupled.evaluate(x)
    assert found.gap.min() > 0

    def gradient(y: Array) -> Array:
        return -faces.scatter(coupled.evaluate(y).force, len(y)).ravel()

    g = gradient(x)
    assert np.abs(g).max() > 1e-3
    assert g == pytest.approx(slope(lambda y: coupled.merit(y, found), x, 1e-6), abs=1e-7)
    data = np.zeros(len(pat.indices))
    faces.add_blocks(np.arange(len(found.tangent)), found.tangent, data)
    assert full(pat, data) == pytest.approx(slope(gradient, x, 1e-6), abs=1e-5)
    assert g.reshape(x.shape).sum(0) == pytest.approx(faces.shared(-found.force, len(x)).sum(0))
