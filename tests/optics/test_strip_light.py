"""The sum over strips against closed forms."""

import numpy as np
import pytest
from helpers import light_paths
from helpers.tiny import sensor

from tacgen.optics import strip_light, strip_light_table
from tacgen.optics.camera import PinholeCamera, Stack
from tacgen.optics.shadows import Terrain
from tacgen.sensor.model import Led

LEVEL = Terrain.of(np.zeros((5, 5)), (20.0, 20.0))
NOTHING = strip_light.Panels.of([])  # in the way


def received(at, normal, lobe=0, depth=10.0, index=1.0):
    """Matt light of a small strip on a level spot at the origin, `depth` mm of this index above a mirror."""
    strip = strip_light.StripPoints(*(np.array([value]) for value in (at, normal, 1e-3, 0.01, 0, lobe)))
    slab = strip_light.Slab(np.array([-depth]), np.array([np.inf]), np.array([index]))
    spot, down = np.array([[0.0, 0.0, 0.0]]), np.array([[0.0, 0.0, -1.0]])
    return strip_light.gather(spot, down, down, strip, 1, slab, NOTHING, 0.4, LEVEL)[0, 0, 0]


def test_a_small_strip_obeys_the_inverse_square_law():
    """It faces the spot; index 1 has no mirror image."""
    assert received([3.0, 0.0, -4.0], [-0.6, 0.0, 0.8]) == pytest.approx(1e-3 * 0.8 / 25.0 / np.pi, rel=1e-6)


def test_a_strip_has_pieces_by_the_angle_at_which_it_is_seen():
    """All that a long one has, one if it is short, and the same area."""
    long, short = sensor().leds[0].model_copy(update={"center_mm": (-9.0, 0.0, -2.0)}), {"size_mm": (1.0, 1.0)}
    leds = long, long.model_copy(update=short)
    made = sensor().model_copy(update={"leds": leds})
    columns = strip_light_table.Columns.of(made, 6, LEVEL)
    assert [list(columns.strip).count(k) for k in (0, 1)] == [6, 1]
    points = strip_light.points(leds, 2, 2, [6, 1])
    assert [points.area[points.strip == k].sum() for k in (0, 1)] == pytest.approx(
        [np.prod(led.size_mm) for led in leds]
    )


def test_a_lobe_takes_light_off_the_normal_away():
    even, narrow = (received([3.0, 0.0, -4.0], [0.0, 0.0, 1.0], lobe) for lobe in (0, 3))
    assert narrow == pytest.approx(0.8**3 * even, rel=1e-6)


def test_a_mirror_image_adds_what_fresnel_reflects():
    """The strip faces away: only its image shines on the spot."""
    n, d = 1.5, np.hypot(1.0, 10.0)
    expected = 1e-3 * (10.0 / d) ** 2 / d**2 / np.pi * (1 - passed(n / d, n, 1.0))
    assert received([1.0, 0.0, -2.0], [0.0, 0.0, -1.0], depth=6.0, index=n) == pytest.approx(expected, rel=1e-6)


def passed(k, n1, n2):
    return strip_light.transmission(np.array([k]), [n1, n2])[0]


def test_fresnel_at_normal_incidence_and_beyond_the_critical_angle():
    assert 1 - passed(0.0, 1.5, 1.0) == pytest.approx(0.04, rel=1e-12)
    assert passed(1.01, 1.5, 1.0) == 0.0
    assert passed(0.5, 1.0, 1.5) == pytest.approx(passed(0.5, 1.5, 1.0))


@pytest.mark.parametrize("rho", [1e-6, 0.5, 5.0, 50.0])
def test_a_connection_travels_as_far_as_asked(rho):
    lengths, indices = np.array([5.0, 4.0]), np.array([1.49, 1.41])
    k, derivative = light_paths.connect(rho, lengths, indices)
    travel = (lengths * k / np.sqrt(indices**2 - k * k)).sum()
    assert travel == pytest.approx(rho, rel=1e-7)
    dk = 1e-6 * (1.41 - k)
    nearby = (lengths * (k + dk) / np.sqrt(indices**2 - (k + dk) ** 2)).sum()
    assert (nearby - travel) / dk == pytest.approx(derivative, rel=1e-4)


def test_camera_and_light_bend_alike():
    stack = Stack((12.0, 5.0, 4.0), (1.0, 1.49, 1.41))
    x = PinholeCamera(stack, (0.0, 0.0), 1.0, (0, 0)).project([[6.0, 0.0, 0.0]])[0, 0]
    k, _ = light_paths.connect(6.0, stack.thicknesses, stack.indices)
    assert k == pytest.approx(x / np.sqrt(1 + x * x), rel=1e-7)


def test_a_rough_mirror_reflects_nearly_all_and_never_more():
    rng = np.random.default_rng(1)
    for cos in (1.0, 0.6):
        wi = np.array([np.sqrt(1 - cos * cos), 0.0, cos])
        u, v = rng.random((2, 40000))
        co, phi = np.sqrt(u), 2 * np.pi * v  # cosine-weighted directions
        wo = np.column_stack([np.sqrt(1 - u) * np.cos(phi), np.sqrt(1 - u) * np.sin(phi), co])
        total = np.mean(np.pi * light_paths.ggx(wo @ wi, cos, co, 0.3) / co)
        assert 0.8 < total < 1.02


@pytest.mark.parametrize(("normal", "image"), [([0.6, 0.0, -0.8], 1), ([-1.0, 0.0, 0.0], 0), ([-1.0, 0.0, 0.0], 1)])
def test_a_strip_stands_in_the_way_where_a_fine_walk_meets_it(normal, image):
    """Two layers; the way is bent at the one between, and mirrored under it."""
    slab = strip_light.Slab(np.array([-8.0, -4.0]), np.array([-4.0, np.inf]), np.array([1.49, 1.41]))
    source = np.array([-9.0, 0.5, -6.0])
    rng, seen = np.random.default_rng(5), set()
    for _ in range(60):
        p, middle = np.array([*rng.uniform(-5, 5, 2), 0.0]), rng.uniform([-8, -2, -7.5], [0, 2, -0.5])
        led = Led(name="in the way", center_mm=middle, normal=normal, size_mm=(4, 2), radiance=(1, 1, 1), source="test")
        panels = strip_light.Panels.of([led])
        found, k = light_paths.shaded(panels, p, source, image, slab)
        met = walked(panels, p, source, image, slab, k)
        if met is not None:
            seen.add(met)
            assert found == met
    assert seen == {True, False}


def walked(panels, p, source, image, slab, k):
    """The same by points every 0.002 mm of height; None where the way only just misses or meets the rectangle."""
    rho = np.hypot(*(source - p)[:2])
    z = np.arange(p[2], slab.bottoms[0] if image else source[2], -0.002)
    z = np.append(z, np.arange(slab.bottoms[0], source[2], 0.002)) if image else z
    n = np.where(z < slab.bottoms[1], *slab.indices)
    r = np.cumsum(0.002 * k / np.sqrt(n * n - k * k))
    assert r[-1] == pytest.approx(rho, abs=0.01)
    way = np.column_stack([p[:2] + r[:, None] / rho * (source - p)[:2], z])
    off = (way - panels.middle[0]) @ np.array([panels.normal[0], panels.along[0] / 4, panels.up[0]]).T
    inside = np.maximum(np.abs(off[:, 1]), np.abs(off[:, 2]))  # along and up, 1 at the rims
    near = np.abs(off[:, 0]) < 0.01
    if not near.any():
        return False
    least = inside[near].min()
    return None if abs(least - 1) < 0.05 else bool(least < 1)
