"""Pixels that are not square, and dots beside the middle: the picture is that of square pixels, resized."""

import numpy as np
import pytest
from helpers.tiny import PLAIN, cloudy, sensor

from tacgen.calibrate.render_comparison import circle
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.hertz_dent import BallDent
from tacgen.render import images, tensor_drawing, traced_maps
from tacgen.sensor import optics_checks
from tacgen.sensor.model import Sensor

EYE = {"blur_mm": 0.3, "vignette_mm": 6.0, "crop_mm": [0.5, -0.3], "height_px": 32}
DOTS = {**PLAIN["markers"], "offset_mm": [0.6, -0.4]}
DENT = BallDent(2.0, 1.0, (0.6, -0.4))


def made(aspect: float | None, height: int) -> Sensor:
    return sensor(camera={**EYE, "pixel_aspect": aspect, "height_px": height}, markers=DOTS)


def picture(one: Sensor, face: BallDent) -> np.ndarray:
    renderer = images.Renderer(one, 4, 0, True)
    return renderer.develop(renderer.image(face)).astype(float)


def test_a_picture_of_half_as_many_rows_is_the_whole_one_resized() -> None:
    whole, half = (picture(made(*how), DENT) for how in ((None, 32), (2.0, 16)))
    resized = whole.reshape(16, 2, 40, 3).mean(axis=1)
    assert np.abs(half - resized).mean() < 1.5
    assert np.abs(half - resized).mean() < 0.2 * np.abs(picture(made(None, 16), DENT) - resized).mean()


def test_a_contact_circle_is_an_ellipse_in_such_a_picture() -> None:
    square, flat = (PinholeCamera.from_sensor(made(*how)) for how in ((None, 32), (2.0, 16)))
    one, other = BallDent.seen(square, 2.0, (22.0, 14.0), 4.0), BallDent.seen(flat, 2.0, (22.0, 7.0), 4.0)
    assert other.contact == pytest.approx(one.contact, abs=1e-9)
    assert other.center == pytest.approx(one.center, abs=1e-9)
    inside = (
        circle((32, 40), (22.0, 14.0), 4.0),
        circle((16, 40), (22.0, 7.0), 4.0, 2.0),
    )
    assert 2 * inside[1].sum() == pytest.approx(inside[0].sum(), rel=0.1)


def test_fits_and_tables_have_square_pixels_and_others_are_refused() -> None:
    coarse = traced_maps.zoomed(made(2.0, 16), 20).camera
    assert (coarse.width_px, coarse.height_px, coarse.pixel_mm) == (20, 16, (0.4, 0.4))
    assert not tensor_drawing.drawable(images.Renderer(made(2.0, 16), 1, 0, True))
    (wrong,) = optics_checks.problems(cloudy(camera={"pixel_aspect": 1.1, "vignette_mm": None}))
    assert wrong.path == ("camera", "pixel_aspect")
