"""Where the samples of a map lie in mm, behind cameras that look straight, lean and turn, on flat gels and domes."""

from pathlib import Path

import numpy as np
import pytest
from helpers import small_recipe

import tacgen
from tacgen.batch import pipeline
from tacgen.optics.camera import PinholeCamera

BALL = 2.5, -1.5  # x, y [mm]
LEANS = "sensor_overrides={camera.tilt_deg: [7, -5], camera.roll_deg: 15}"


@pytest.mark.parametrize("more", [("sensor=gelsight_mini",), ("sensor=digit",), ("sensor=gelsight_mini", LEANS)])
def test_a_ball_presses_where_its_map_says(tmp_path: Path, more: tuple[str, ...]) -> None:
    sets = (f"start={{x_mm: {BALL[0]}, y_mm: {BALL[1]}}}", "outputs=[traction, force_map, height]", *more)
    frames = tacgen.read(pipeline.run_scene(small_recipe.row(small_recipe.PRESS, *sets), tmp_path).path)
    dome = frames.sensor.gel.dome
    # a ball of 4 mm touches a dome where their normals meet
    bends = (1.0, 1.0) if dome is None else (r / (r + 4) for r in (dome.radius_x_mm, dome.radius_y_mm))
    touches = [at * bend for at, bend in zip(BALL, bends, strict=True)]
    weight = frames.pressure[-1].astype(float) * frames.area[-1]
    x, y = frames.x_mm, frames.y_mm
    assert x.shape == y.shape == weight.shape
    assert np.nansum(weight * x) / weight.sum() == pytest.approx(touches[0], abs=0.08)
    assert np.nansum(weight * y) / weight.sum() == pytest.approx(touches[1], abs=0.08)
    points = np.stack([x, y, frames["/reference/height"]], -1)
    gel = ~np.isnan(points).any(-1)
    assert np.array_equal(np.isnan(x), np.isnan(y))
    assert np.array_equal(np.isnan(x), np.isnan(frames["/reference/height"]))
    rows, columns = np.indices(x.shape) + 0.5
    there = PinholeCamera.from_sensor(frames.sensor).project(points[gel])
    assert np.abs(there - np.stack([columns, rows], -1)[gel]).max() < 0.05, "the camera sees them there [px]"


def test_positions_are_there_with_maps_alone(tmp_path: Path) -> None:
    frames = tacgen.read(pipeline.run_scene(small_recipe.row(), tmp_path).path)
    assert "/reference/x_mm" not in frames.bundle
    with pytest.raises(AttributeError, match="not among the outputs of this scene"):
        _ = frames.x_mm
