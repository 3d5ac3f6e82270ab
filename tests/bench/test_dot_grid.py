"""The camera's distance, found by how the plate bends rows of dots."""

import numpy as np
import pytest
from helpers import reality

from benchmarks import dot_grid, photographs, real_dots
from tacgen.optics.camera import PinholeCamera
from tacgen.recipe.background_photo import read

Array = np.ndarray


def grid(distance: float) -> Array:
    """Dots (63, 2) [px] of a turned 9 x 7 grid with steps of 2.0 and 1.9 mm, seen by the Mini's camera."""
    sensor = reality.sensor("gelsight_mini")
    eye = sensor.camera.model_copy(update={"distance_mm": distance})
    column, row = np.meshgrid(np.arange(-4, 5), np.arange(-3, 4))
    x, y, turn = 2.0 * column.ravel() + 0.3, 1.9 * row.ravel() - 0.2, np.radians(2.0)
    at = np.column_stack([x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn), 0 * x])
    return PinholeCamera.from_sensor(sensor.model_copy(update={"camera": eye})).project(at)


def test_dots_are_numbered_by_column_and_row() -> None:
    order = np.random.default_rng(1).permutation(63)
    numbers = dot_grid.numbered(grid(5.0)[order])
    assert len(np.unique(numbers, axis=0)) == 63
    np.testing.assert_array_equal(np.ptp(numbers, axis=0), [8, 6])


@pytest.mark.parametrize("distance", [4.0, 15.0])
def test_distance_axis_and_pitch_are_recovered(distance: float) -> None:
    sensor = reality.sensor("gelsight_mini")
    found = dot_grid.fitted(sensor, grid(distance))
    assert found.distance == pytest.approx(distance, rel=0.01)
    assert found.pitch == pytest.approx([2.0, 1.9], rel=1e-3)
    eye = sensor.camera
    assert found.axis == pytest.approx(np.array([160, 120]) - np.divide(eye.crop_mm, eye.mm_per_px), abs=0.5)
    assert found.off < 0.01
    assert dot_grid.fitted(sensor, grid(distance), distance * 2).off > 0.1


@reality.needs("gelsight_mini")
def test_rows_of_dots_bend_as_in_photographs() -> None:
    sensor, pitch = reality.sensor("gelsight_mini"), []
    for name in dot_grid.PICTURES:
        path = photographs.reference() / name
        if not path.is_file():
            pytest.skip(f"{path} is not there")
        seen = real_dots.dots(read(path))
        best, own = (dot_grid.fitted(sensor, seen, d) for d in (None, sensor.camera.distance_mm))
        assert own.off < 1.1 * best.off
        pitch.append(own.pitch)
    assert sensor.markers is not None
    assert np.mean(pitch, axis=0) == pytest.approx(np.array(sensor.markers.pitch_mm), rel=0.01)
