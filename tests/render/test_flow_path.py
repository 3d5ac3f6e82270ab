"""Markers and flow of a sheared gel against Mitsuba's paths through the layers."""

import numpy as np
import pytest
from helpers import flow
from helpers.tiny import sensor

from tacgen.optics.camera import PinholeCamera
from tacgen.optics.drawn_face import DrawnFace
from tacgen.optics.surface_grid import Sheet, Untouched
from tacgen.render import mitsuba_variants


class Sheared:
    """A dent 0.6 mm deep in the middle of a shear of 0.5 mm, that fade together."""

    def at(self, xy: np.ndarray) -> np.ndarray:
        x, y = np.asarray(xy, float).T
        bump = np.exp(-((x - 0.5) ** 2 + (y + 0.3) ** 2) / 4)
        return np.column_stack([x + 0.5 * bump, y - 0.2 * bump, -0.6 * bump])


@pytest.mark.slow
def test_a_shear_of_half_a_millimetre_is_right_to_a_twentieth_of_a_pixel() -> None:
    model = sensor(camera={"mm_per_px": 0.08, "width_px": 100, "height_px": 80})
    error = flow.measure(model, Untouched(), Sheared(), mitsuba_variants.SCALAR_VARIANT, spp=100)
    assert error.moved > 6
    assert error.markers_most < 0.05
    assert error.flow_rms < 0.02
    assert error.flow_most < 0.1  # a tenth of it the noise of the paths


@pytest.mark.parametrize(
    "camera",
    [
        {"tilt_deg": (5, 0)},
        {"tilt_deg": (0, -5)},
        {"roll_deg": 7},
        {"crop_mm": (0.5, -0.3)},
        {"tilt_deg": (4, -3), "roll_deg": 5, "crop_mm": (0.4, -0.2), "center_mm": (0.3, 0.2)},
    ],
)
def test_a_camera_that_is_not_straight_sees_what_path_sees(camera: dict) -> None:
    model = sensor(camera=camera, gel={"corner_radius_mm": 0.0})
    sheet, dent = Sheet.over(model.gel, 0.1), Sheared()
    own, traced = (
        DrawnFace(sheet, dent, PinholeCamera.from_sensor(model)).behind(sheet.rest),
        flow.rest(model, sheet, dent, 64, mitsuba_variants.SCALAR_VARIANT),
    )
    off = (own - traced) / model.camera.mm_per_px
    assert np.sqrt(np.nanmean(off**2)) < 0.02
    straight = DrawnFace(sheet, dent, PinholeCamera.from_sensor(sensor())).behind(sheet.rest)
    assert np.nanmax(np.abs(straight - own)) > 0.25  # so it does say something


@pytest.mark.slow
@pytest.mark.parametrize("name", flow.DEPTHS)
def test_on_the_shipped_sensors(name: str) -> None:
    model, untouched, moved = flow.sheared(name)
    error = flow.measure(model, untouched, moved, mitsuba_variants.SCALAR_VARIANT, spp=100)
    assert error.moved > 5
    assert error.markers_most < 0.05
    assert error.flow_rms < 0.02
