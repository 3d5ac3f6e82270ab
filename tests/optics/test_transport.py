"""The sum over strips against closed forms."""

import numpy as np
import pytest

from tacgen.optics import transport
from tacgen.optics.horizon import Terrain
from tacgen.optics.layers import Stack

LEVEL = Terrain.of(np.zeros((5, 5)), (20.0, 20.0)).parts


def test_a_small_strip_obeys_the_inverse_square_law():
    p, q = np.array([[0.0, 0.0, 0.0]]), np.array([[3.0, 0.0, -4.0]])
    toward = np.array([[-0.6, 0.0, 0.8]])  # the strip faces the point
    area, down = np.array([1e-3]), np.array([[0.0, 0.0, -1.0]])
    slab = (np.array([-10.0]), np.array([np.inf]), np.array([1.0]))  # index 1: no mirror image
    light = (q, toward, area, np.array([0.01]), np.array([0]), 1)
    got = transport.gather(p, down, down, *light, *slab, 0.4, LEVEL)
    assert got[0, 0, 0] == pytest.approx(1e-3 * 0.8 / 25.0 / np.pi, rel=1e-6)


def test_a_mirror_image_adds_what_fresnel_reflects():
    n, depth = 1.5, 6.0
    p, down = np.array([[0.0, 0.0, 0.0]]), np.array([[0.0, 0.0, -1.0]])
    q, normal = np.array([[1.0, 0.0, -2.0]]), np.array([[0.0, 0.0, -1.0]])  # faces away: only its image shines on p
    slab = (np.array([-depth]), np.array([np.inf]), np.array([n]))
    light = (q, normal, np.array([1e-3]), np.array([0.01]), np.array([0]), 1)
    got = transport.gather(p, down, down, *light, *slab, 0.4, LEVEL)
    d = np.hypot(1.0, 10.0)
    k = n / d
    expected = 1e-3 * (10.0 / d) ** 2 / d**2 / np.pi * (1 - transport.fresnel_transmission(k, n, 1.0))
    assert got[0, 0, 0] == pytest.approx(expected, rel=1e-6)


def test_fresnel_at_normal_incidence_and_beyond_the_critical_angle():
    assert 1 - transport.fresnel_transmission(0.0, 1.5, 1.0) == pytest.approx(0.04, rel=1e-12)
    assert transport.fresnel_transmission(1.01, 1.5, 1.0) == 0.0
    assert transport.fresnel_transmission(0.5, 1.0, 1.5) == pytest.approx(transport.fresnel_transmission(0.5, 1.5, 1.0))


@pytest.mark.parametrize("rho", [1e-6, 0.5, 5.0, 50.0])
def test_a_connection_travels_as_far_as_asked(rho):
    lengths, indices = np.array([5.0, 4.0]), np.array([1.49, 1.41])
    k, derivative = transport.connect(rho, lengths, indices)
    travel = (lengths * k / np.sqrt(indices**2 - k * k)).sum()
    assert travel == pytest.approx(rho, rel=1e-7)
    dk = 1e-6 * (1.41 - k)
    nearby = (lengths * (k + dk) / np.sqrt(indices**2 - (k + dk) ** 2)).sum()
    assert (nearby - travel) / dk == pytest.approx(derivative, rel=1e-4)


def test_camera_and_light_bend_alike():
    stack = Stack((12.0, 5.0, 4.0), (1.0, 1.49, 1.41))
    x = stack.slope(np.array([6.0]), np.array([0.0]))[0]
    k, _ = transport.connect(6.0, np.array(stack.thicknesses), np.array(stack.indices))
    assert k == pytest.approx(x / np.sqrt(1 + x * x), rel=1e-7)


def test_a_rough_mirror_reflects_nearly_all_and_never_more():
    rng = np.random.default_rng(1)
    for cos in (1.0, 0.6):
        wi = np.array([np.sqrt(1 - cos * cos), 0.0, cos])
        u, v = rng.random((2, 40000))
        co, phi = np.sqrt(u), 2 * np.pi * v  # cosine-weighted directions
        wo = np.column_stack([np.sqrt(1 - u) * np.cos(phi), np.sqrt(1 - u) * np.sin(phi), co])
        total = np.mean([np.pi * transport.ggx(o @ wi, cos, c, 0.3) / c for o, c in zip(wo, co, strict=True)])
        assert 0.8 < total < 1.02


def test_a_ridge_takes_a_strips_light_away():
    p, down = np.array([[-3.0, 0.0, 0.0]]), np.array([[0.0, 0.0, -1.0]])
    light = (np.array([[4.0, 0.0, -0.8]]), np.array([[-1.0, 0.0, 0.0]]), np.array([1e-3]), np.array([0.05]))
    slab = (np.array([-10.0]), np.array([np.inf]), np.array([1.0]))
    flat, size = np.zeros((101, 101)), (10.0, 10.0)
    ridge = flat.copy()
    ridge[:, 50:53] = -1.2
    clear, shaded = (
        transport.gather(p, down, down, *light, np.array([0]), 1, *slab, 0.4, Terrain.of(heights, size).parts)[0, 0, 0]
        for heights in (flat, ridge)
    )
    assert clear > 0.0
    assert shaded == 0.0
