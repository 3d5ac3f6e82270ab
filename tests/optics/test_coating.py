"""Dots, lights and the camera's response."""

import numpy as np
import pytest
from helpers.tiny import sensor

from tacgen.optics import camera_response, coating, housing, mitsuba_dicts
from tacgen.optics.camera_view import CameraView
from tacgen.optics.surface_grid import Sheet, Untouched
from tacgen.sensor.markers import HexagonalMarkers

MIXED = ((1.0, -0.2, -0.3), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def test_dots_lie_on_their_grid_and_cover_their_area():
    markers = sensor().markers
    centers = coating.centers(markers)
    assert centers.shape == (9, 2)
    assert centers[0] == pytest.approx([-2.4, -2.0])
    assert coating.paint(markers, centers, 0.02) == pytest.approx(np.ones(9))
    picture = coating.mask(markers, (12.0, 10.0), 0.02)
    assert picture.mean() * 120.0 == pytest.approx(9 * np.pi * 0.45**2, rel=5e-3)
    assert coating.paint(markers, np.array([[4.8, 0.0]]), 0.02) == 0.0  # where a fourth column would be


def test_a_lattice_may_lie_beside_the_middle_of_the_pad():
    plain = sensor().markers
    moved, by = plain.model_copy(update={"offset_mm": (0.5, -0.2)}), np.array([0.5, -0.2])
    assert coating.centers(moved) == pytest.approx(coating.centers(plain) + by)
    xy = np.random.default_rng(0).uniform(-4, 4, (500, 2))
    assert coating.paint(moved, xy + by, 0.1) == pytest.approx(coating.paint(plain, xy, 0.1), abs=1e-9)
    assert coating.paint(moved, coating.centers(moved), 0.1) == pytest.approx(np.ones(9))


def hexagonal(rings: int, pitch_mm: float, diameter_mm: float) -> HexagonalMarkers:
    return HexagonalMarkers(
        layout="hexagonal", rings=rings, pitch_mm=pitch_mm, diameter_mm=diameter_mm, albedo=0.1, source="test"
    )


def test_hexagonal_dots_stand_in_rings_and_are_numbered_row_by_row():
    centers = coating.centers(hexagonal(6, 2.5, 1.0))
    assert len(centers) == 127  # of a TacTip
    around = np.exp(1j * np.pi / 3 * np.arange(6))
    side, along = np.meshgrid(np.arange(6), np.arange(1, 7))  # places k < n of a side of the ring n, from its corner
    ring = (along * around[:, None, None] + side * (around * np.exp(2j * np.pi / 3))[:, None, None])[:, side < along]
    expected = 2.5 * np.append(ring.ravel(), 0)
    off = np.abs(expected[:, None] - (centers @ [1, 1j]))
    assert (off.min(axis=1) < 1e-12).all()
    assert len(set(off.argmin(axis=1))) == 127
    assert centers[0] == pytest.approx([-7.5, -7.5 * np.sqrt(3)])
    assert centers[63] == pytest.approx([0, 0], abs=1e-12)
    order = np.lexsort((centers[:, 0], centers[:, 1].round(9)))
    assert (order == np.arange(127)).all()


@pytest.mark.parametrize("rings", [1, 2, 6])
def test_paint_is_that_of_the_nearest_dot(rings: int):
    markers = hexagonal(rings, 2.0, 1.9)
    reach = 2 * rings + 3
    xy = np.random.default_rng(0).uniform(-reach, reach, (20_000, 2))
    xy[0] = np.nan
    away = np.linalg.norm(xy[:, None] - coating.centers(markers), axis=-1).min(axis=1)
    for edge in (0.2, 1.5):  # of the wide one neighbouring dots' rims overlap
        expected = np.nan_to_num(np.clip((0.95 - away) / edge + 0.5, 0, 1))  # none beside the gel
        assert coating.paint(markers, xy, edge) == pytest.approx(expected, abs=1e-12)
    picture = coating.mask(markers, (2 * reach, 2 * reach), 0.02)
    assert picture.mean() * 4 * reach**2 == pytest.approx(len(coating.centers(markers)) * np.pi * 0.95**2, rel=5e-3)


def test_a_rectangle_keeps_size_place_and_front():
    matrix = mitsuba_dicts.rectangle((1, 2, 3), (0, 0, -2), (0, 1, 0), (4.0, 6.0))
    corners = np.array([[x, y, 0, 1] for x in (-1, 1) for y in (-1, 1)]) @ matrix.T
    assert np.ptp(corners[:, :3], axis=0) == pytest.approx([4.0, 6.0, 0.0])
    assert corners[:, :3].mean(axis=0) == pytest.approx([1, 2, 3])
    assert matrix[:3, 2] == pytest.approx([0, 0, -1])
    assert np.linalg.det(matrix[:3, :3]) > 0
    with pytest.raises(ValueError, match="parallel"):
        housing.frame((0, 0, 1), (0, 0, -1))


def test_equal_indices_leave_no_interface():
    assert set(mitsuba_dicts.interfaces(sensor())) == {"into_plate", "into_gel"}
    assert set(mitsuba_dicts.interfaces(sensor(plate={"refractive_index": 1.41}))) == {"into_plate"}


def test_response_is_srgb_or_linear_with_a_vignette():
    camera, plain = sensor().camera, sensor(camera={"response": "linear"}).camera
    light = np.array([0.0, 0.0031308, 0.2140, 1.0, 7.0])
    assert camera_response.encoded(light, camera) == pytest.approx([0, 0.04045, 0.5, 1, 1], abs=2e-4)
    assert camera_response.encoded(light, plain) == pytest.approx([0, 0.0031308, 0.2140, 1, 1])
    for eye in (camera, plain):
        assert camera_response.linear(camera_response.encoded(light[:4], eye), eye) == pytest.approx(
            light[:4], abs=1e-6
        )
        rise = camera_response.encoded(light[1:3] + 1e-6, eye) - camera_response.encoded(light[1:3] - 1e-6, eye)
        assert camera_response.slope(light[1:3], eye) == pytest.approx(rise / 2e-6, rel=0.05)
    fall = camera_response.vignette(camera)
    assert fall.max() == pytest.approx(1.0, abs=1e-3)
    r2 = ((19.5**2 + 15.5**2) * 0.04) / 81.0
    assert fall[0, 0] == pytest.approx([1 / (1 + r2) ** 2] * 3)
    picture = camera_response.develop(np.full((32, 40, 3), 0.2140), camera)
    assert picture.dtype == np.uint8
    assert picture[16, 20, 0] in (127, 128)
    assert camera_response.develop(np.full((32, 40, 3), 0.2140), plain)[16, 20, 0] in (54, 55)


def test_stray_light_is_even_but_for_the_vignette_and_dots_stay_dark_in_it():
    model = sensor(camera={"ambient": (0.1, 0.2, 0.3), "exposure": 2.0, "colour_matrix": MIXED})
    light = camera_response.stray(model.camera)
    assert camera_response.expose(np.broadcast_to(light, (32, 40, 3)), model.camera) == pytest.approx(
        [0.1, 0.2, 0.3] * camera_response.vignette(model.camera)
    )
    dark = model.model_copy(update={"leds": tuple(x.model_copy(update={"radiance": (0, 0, 0)}) for x in model.leds)})
    coat = 0.8 * np.array(model.coating.albedo) + 0.2 * coating.METAL_REFLECTANCE
    for samples in (1, 2):
        view, seen = CameraView(dark, Sheet.over(dark.gel, 0.2), True, samples), np.ones((32, 40, 3))
        at = view.look(Untouched())
        view.add_even(seen, at, light)
        bare = np.broadcast_to(light, (len(at.paint), 3)).copy()
        assert seen == pytest.approx(1 + view.dimmed(at, bare))
        assert (seen[16, 20] - 1) / light == pytest.approx(0.03 / coat, rel=1e-6)


def test_colours_of_the_counts_mix_the_sensors_own_and_each_falls_off_by_itself():
    camera = sensor(camera={"vignette_mm": (6.0, 9.0, 20.0), "colour_matrix": MIXED, "exposure": 0.5}).camera
    light = camera_response.expose(np.broadcast_to([0.8, 0.6, 0.4], (32, 40, 3)), camera)
    even = camera_response.unexposed(light, camera)
    assert even == pytest.approx(np.broadcast_to([0.8, 0.6, 0.4], even.shape), rel=1e-12)
    r2 = (19.5**2 + 15.5**2) * 0.04
    fall = [1 / (1 + r2 / r0**2) ** 2 for r0 in (6.0, 9.0, 20.0)]
    assert light[0, 0] == pytest.approx(np.array([0.8 - 0.12 - 0.12, 0.6, 0.4]) * fall / 2)


def test_out_of_focus_an_edge_is_as_wide_as_the_file_says_whatever_the_pixels():
    edge = np.repeat(np.repeat(np.where(np.arange(80) < 40, 0.2, 0.8)[None, :, None], 20, 0), 3, 2)
    for mm_per_px in (0.05, 0.1):
        camera = sensor(camera={"blur_mm": 0.2, "mm_per_px": mm_per_px}).camera
        line = camera_response.blurred(edge, camera)[10, :, 1]
        spread = np.diff(line) / 0.6  # its derivative is the line's image, a Gaussian
        x = (np.arange(79) - 39) * mm_per_px
        assert line[[0, -1]] == pytest.approx([0.2, 0.8], abs=1e-6)
        assert np.sqrt((spread * x**2).sum()) == pytest.approx(0.2, rel=0.02)
    sharp = sensor().camera
    assert camera_response.blurred(edge, sharp) is edge
