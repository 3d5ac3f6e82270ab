"""Grain, marks and wear of the coating: as strong and as coarse as asked, the same for a seed, and fixed to the gel."""

import numpy as np
import pytest
from helpers.tiny import PLAIN, sensor

from tacgen.optics import coat_texture
from tacgen.optics.coat_texture import sampled, texture
from tacgen.optics.hertz_dent import BallDent
from tacgen.render.images import Renderer
from tacgen.sensor.model import Coating

Array = np.ndarray
SIZE, FINE = (24.0, 20.0), 0.02  # [mm]
GRAIN = {"contrast": 0.02, "length_mm": 0.2, "seed": 3, "source": "test"}


def made(pixel: float = FINE, **parts: object) -> Array:
    field = texture(Coating.model_validate({**PLAIN["coating"], **parts}), SIZE, pixel)
    assert field is not None
    return field


def test_an_even_coating_has_no_texture() -> None:
    assert texture(Coating.model_validate(PLAIN["coating"]), SIZE, FINE) is None


@pytest.mark.slow
@pytest.mark.parametrize("length", [0.1, 0.4])
def test_grain_has_the_contrast_and_the_length_that_are_asked_for(length: float) -> None:
    grain = made(grain={**GRAIN, "length_mm": length}) - 1
    assert grain.mean() == pytest.approx(0, abs=0.002)
    assert grain.std() == pytest.approx(0.02, rel=0.06)
    for axis in (0, 1):
        steps = round(length / (SIZE[1 - axis] / grain.shape[axis]))
        a, b = (np.take(grain, range(k, grain.shape[axis] - steps + k), axis) for k in (0, steps))
        assert (a * b).mean() / grain.var() == pytest.approx(np.exp(-1), abs=0.05)


def test_pixels_larger_than_the_grain_average_it() -> None:
    grain = {**GRAIN, "length_mm": 0.05}
    cell = made(pixel=0.4, grain=grain)
    fine = made(grain=grain)
    n = round(0.4 / (SIZE[0] / fine.shape[1]))
    averaged = fine[: fine.shape[0] // n * n, : fine.shape[1] // n * n].reshape(fine.shape[0] // n, n, -1, n)
    assert cell.std() == pytest.approx(averaged.mean(axis=(1, 3)).std(), rel=0.1)
    assert cell.std() < 0.4 * fine.std()


@pytest.mark.slow
def test_seeds_give_patterns_of_their_own_and_more_marks_leave_the_first_ones() -> None:
    assert np.array_equal(made(grain=GRAIN), made(grain=GRAIN))
    one, other = made(grain=GRAIN), made(grain={**GRAIN, "seed": 4})
    assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.05
    few, more = (made(marks={"specks": n, "seed": 1, "source": "test"}) for n in (5, 9))
    assert (more[few < 1] <= few[few < 1]).all()
    assert (more < 1).sum() > (few < 1).sum()


def test_marks_are_as_many_as_dark_and_as_large_as_asked_for() -> None:
    from scipy.ndimage import label

    marks = {"specks": 12, "speck_mm": 0.4, "depth": 0.3, "seed": 2, "source": "test"}
    field = made(marks=marks)
    assert label(field < 1)[1] == 12
    assert field.max() == 1
    assert 0.7 <= field.min() < 0.8
    area = (1 - field[field < 1]).size * FINE**2 / 4 / 12  # nodes are half a pixel apart
    assert np.pi * 0.1**2 / 4 < area < np.pi * 0.4**2 / 4 * 1.2
    assert made(marks={**marks, "bright": 1.0}).min() == 1
    scratch = made(marks={"scratches": 1, "scratch_mm": 3.0, "scratch_width_mm": 0.1, "seed": 5, "source": "test"})
    y, x = np.nonzero(scratch < 1)
    long = np.hypot(np.ptp(x), np.ptp(y)) * FINE / 2
    assert 0.75 < long < 3.2
    assert len(x) * FINE**2 / 4 == pytest.approx(0.1 * long, rel=0.4)


def test_wear_takes_the_reflectance_away_in_the_middle() -> None:
    worn = made(wear={"loss": 0.25, "radius_mm": 2.0, "center_mm": (3.0, -2.0), "source": "test"})
    places = np.array([[3.0, -2.0], [5.0, -2.0], [-9.0, 8.0], [np.nan, 0.0]])
    expected = [0.75, 1 - 0.25 * np.exp(-0.5), 1.0, 1.0]
    assert sampled(worn, SIZE, places) == pytest.approx(expected, abs=1e-3)


@pytest.mark.slow
def test_the_pattern_moves_with_the_gel() -> None:
    """A face that is shifted sideways shows the same pattern at other pixels."""
    coat = {**PLAIN["coating"], "grain": {**GRAIN, "contrast": 0.1, "length_mm": 0.5}}
    grainy, plain = sensor(coating=coat), sensor()

    class Shifted:
        def __init__(self, by: float) -> None:
            self.by = by

        def at(self, xy: Array) -> Array:
            return np.column_stack([xy[:, 0] + self.by, xy[:, 1], np.zeros(len(xy))])

    pixel = plain.camera.mm_per_px
    patterns = []
    for by in (0.0, 3 * pixel):
        rough, even = (Renderer(one, 64, 0, markers=False).image(Shifted(by)) for one in (grainy, plain))
        patterns.append((rough / np.maximum(even, 1e-9))[8:-8, 8:-8, 0])
    assert patterns[0].std() > 0.05
    assert np.corrcoef(patterns[1][:, 3:].ravel(), patterns[0][:, :-3].ravel())[0, 1] > 0.98
    assert np.corrcoef(patterns[1].ravel(), patterns[0].ravel())[0, 1] < 0.7


def test_pictures_with_and_without_differ_by_the_pattern_alone() -> None:
    coat = {**PLAIN["coating"], "wear": {"loss": 0.2, "radius_mm": 1e6, "source": "test"}}
    dent = BallDent(2.0, 1.0, (0.6, -0.4))
    worn, plain = (Renderer(one, 64, 0, markers=True).image(dent) for one in (sensor(coating=coat), sensor()))
    assert worn == pytest.approx(0.8 * plain, rel=1e-5)


def test_the_field_of_a_fine_camera_stays_small() -> None:
    assert made(pixel=0.001, grain=GRAIN).shape == (
        20 / coat_texture.MIN_TEXTURE_SPACING_MM,
        24 / coat_texture.MIN_TEXTURE_SPACING_MM,
    )
