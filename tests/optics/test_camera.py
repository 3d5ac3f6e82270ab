"""The layered camera against Snell's law, a brute-force ray and its own inverse."""

import numpy as np
import pytest
from helpers.tiny import sensor
from hypothesis import given, settings
from hypothesis import strategies as st

from tacgen.optics.camera import PinholeCamera, Stack

MINI = Stack((17.0, 5.0, 4.0), (1.0, 1.49, 1.41))


def camera(stack: Stack = MINI, mm_per_px: float = 0.0634) -> PinholeCamera:
    return PinholeCamera(stack, (0.3, -0.2), stack.effective_depth / mm_per_px, (240, 320))


def march(stack: Stack, slope: np.ndarray, z: float) -> np.ndarray:
    """Trace one ray of given slope (2,) in air from the pinhole to height z by vector refraction; (2,) [mm]."""
    d = np.array([*slope, 1.0]) / np.sqrt(1 + slope @ slope)
    p = np.array([0.0, 0.0, -sum(stack.thicknesses)])
    for i, top in enumerate(stack.tops):
        last = i == len(stack.indices) - 1
        p = p + d * ((z if last else top) - p[2]) / d[2]
        if not last:
            eta = stack.indices[i] / stack.indices[i + 1]
            normal = np.array([0.0, 0.0, 1.0])
            cos = d @ normal
            d = eta * d + (np.sqrt(1 - eta**2 * (1 - cos**2)) - eta * cos) * normal
    return p[:2]


@pytest.mark.parametrize("z", [0.0, -1.3, 0.4])
def test_project_agrees_with_a_ray_traced_by_vector_refraction(z):
    eye = camera()
    for slope in np.array([[0.0, 0.0], [0.3, 0.1], [-0.5, 0.7], [1.5, -2.0]]):
        hit = march(eye.stack, slope, z) + eye.center
        pixel = eye.project([[*hit, z]])[0]
        assert pixel == pytest.approx(slope * eye.focal_px + [160, 120], abs=1e-8)


thickness = st.floats(0.05, 40.0)
index = st.floats(1.0, 2.4)


@settings(max_examples=150, deadline=None)
@given(
    st.lists(st.tuples(thickness, index), min_size=1, max_size=4),
    thickness,
    st.floats(-2000, 2000),
    st.floats(-2000, 2000),
    st.floats(0, 1.3),
    st.tuples(*[st.floats(-0.3, 0.3)] * 3),
    st.floats(0.5, 2.0),
)
def test_rays_then_project_returns_the_pixel_for_any_stack(layers, distance, px, py, way, turn, aspect):
    stack = Stack((distance, *(t for t, _ in layers)), (1.0, *(n for _, n in layers)))
    px, py = (px, py) if turn == (0, 0, 0) else (px / 10, py / 20)  # a turned one must not look along the plate
    eye = PinholeCamera(stack, (1.0, 2.0), 300.0, (240, 320), (20.0, -30.0), turn[:2], turn[2], aspect)
    origin, direction = eye.rays([[px, py]])
    point = origin + way * direction * layers[-1][0] / direction[:, 2:]
    assert eye.project(point)[0] == pytest.approx([px, py], abs=1e-6)


def test_scale_at_the_image_centre_is_the_stated_one():
    eye = camera()
    a, b = eye.project([[0.3, -0.2, 0.0], [0.301, -0.2, 0.0]])
    assert a == pytest.approx([160.0, 120.0], abs=1e-12)
    assert (b - a) / 0.001 == pytest.approx([1 / 0.0634, 0.0], rel=1e-6)


def test_a_point_behind_the_pinhole_is_refused():
    with pytest.raises(ValueError, match="pinhole"):
        camera().project([[0.0, 0.0, -30.0]])


def test_pixels_that_are_not_square_show_the_same_points_in_fewer_rows():
    """11.7 pixels a mm across and 10.8 down, of a camera that is turned and looks beside the middle."""
    eye = {"mm_per_px": 1 / 11.7, "crop_mm": [0.4, -0.3], "tilt_deg": [3, -2], "roll_deg": 5}
    square, flat = (PinholeCamera.from_sensor(sensor(camera={**eye, **more})) for more in (
        {"height_px": 117}, {"height_px": 108, "pixel_aspect": 11.7 / 10.8}))  # fmt: skip
    points = np.random.default_rng(0).uniform([-3, -3, -1], [3, 3, 0], (20, 3))
    assert flat.project(points) == pytest.approx(square.project(points) * [1, 10.8 / 11.7], abs=1e-9)
    for one, other in zip(flat.rays([[10.0, 54.0]]), square.rays([[10.0, 58.5]]), strict=True):
        assert one == pytest.approx(other, abs=1e-12)
