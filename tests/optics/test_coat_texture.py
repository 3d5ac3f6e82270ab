"""Grain, marks and wear of the coating: as strong and as coarse as asked, the same for a seed, and fixed to the gel."""

import numpy as np
import pytest
from helpers.tiny import PLAIN, sensor
from scipy.ndimage import gaussian_filter

from tacgen.optics import coat_texture
from tacgen.optics.coat_texture import relief, sampled, texture
from tacgen.optics.hertz_dent import BallDent
from tacgen.optics.surface_grid import Sheet
from tacgen.render.images import Renderer
from tacgen.sensor.model import Coating

Array = np.ndarray
SIZE, FINE = (24.0, 20.0), 0.02  # [mm]
GRAIN = {"contrast": 0.02, "length_mm": 0.2, "seed": 3, "source": "test"}
RELIEF = {"height_mm": 0.01, **{key: GRAIN[key] for key in ("length_mm", "seed", "source")}}


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


@pytest.mark.slow
def test_slopes_of_a_relief_are_those_of_its_height() -> None:
    """Grain of the same seed and length is the same field. The exponential correlation has slopes at all widths, so
    that differences see what pixels leave."""
    pixel = 0.2
    slopes = relief(Coating.model_validate({**PLAIN["coating"], "relief": RELIEF}), SIZE, pixel)
    assert slopes is not None
    height = 0.1 * (made(pixel, grain={**GRAIN, "contrast": 0.1}) - 1)
    across = (height[:, 2:] - height[:, :-2]) / (2 * SIZE[0] / height.shape[1])
    down = (height[2:] - height[:-2]) / (2 * SIZE[1] / height.shape[0])
    for found, wanted in ((slopes[0][:, 1:-1], across), (slopes[1][1:-1], down)):
        smooth = [gaussian_filter(one, 5.0)[20:-20, 20:-20] for one in (found, wanted)]
        assert smooth[0] == pytest.approx(smooth[1], abs=0.06 * smooth[1].std())


def test_a_relief_turns_the_normals_of_a_dent_as_if_its_face_had_moved_along_them() -> None:
    one = sensor()
    dent, sheet = BallDent(4.0, 1.5, (0.6, -0.4)), Sheet.over(one.gel, 0.02, (-0.3, 1.5, -1.3, 0.5))
    wide, tall, high, size = 2.0, 3.0, 1e-4, sheet.size
    x, y = ((np.arange(n) + 0.5) / n * side - side / 2 for n, side in zip((2400, 2000), size, strict=True))
    slopes = np.stack(np.broadcast_arrays(high * wide * np.cos(wide * x), -high * tall * np.sin(tall * y)[:, None]))
    now = sheet.at(dent)
    normals, field = sheet.normals(now), high * (np.sin(wide * sheet.rest[:, 0]) + np.cos(tall * sheet.rest[:, 1]))
    moved = sheet.normals(now - field[:, None] * normals)
    found = coat_texture.embossed(normals, np.ones(len(now)), sheet.rest, slopes, size)
    inner = np.hypot(*(sheet.rest - dent.center).T) < 0.7
    assert np.abs(moved - normals)[inner].max() > 1.5 * high
    # heights along the face are taken over rest positions, which a dent's slope draws together
    assert np.abs(found - moved)[inner, :2].max() < 0.1 * np.abs(moved - normals)[inner].max()


def test_a_relief_shows_where_something_touches_alone() -> None:
    coat = {**PLAIN["coating"], "relief": RELIEF}
    rough, plain = (Renderer(one, 64, 0, markers=False) for one in (sensor(coating=coat), sensor()))
    dent = BallDent(2.0, 1.0, (0.6, -0.4))
    assert np.array_equal(rough.flat(), plain.flat())
    made = [one.image(dent) for one in (rough, plain, rough)]
    assert np.array_equal(made[0], made[2])
    away = plain._view.look(dent).rest.reshape(*made[0].shape[:2], 2) - dent.center
    change, far = np.abs(made[0] - made[1]).max(axis=2), np.hypot(*np.moveaxis(away, 2, 0)) > 1.3
    assert change[far].max() < 1e-6
    assert change[~far].max() > 0.01 * plain.flat().max()
