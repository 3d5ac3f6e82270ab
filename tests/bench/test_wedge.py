"""The Wedge part of the bench `real`: its photographs as `calibrate unit` takes them."""

from pathlib import Path

import pytest

from benchmarks import photographs, real
from tacgen.calibrate import photos as reading
from tacgen.recipe import loading


@pytest.mark.slow
def test_its_sensor_file_and_table_are_what_the_calibration_takes(tmp_path: Path) -> None:
    sensor, _ = loading.read_sensor(real.WEDGE_UNIT)
    assert (sensor.camera.width_px, sensor.camera.height_px) == real.WEDGE_SIZE
    if not (photographs.reference() / real.WEDGE / real.FORCES).is_file():
        pytest.skip(f"no photographs in {photographs.reference()}")
    real.wedge_laid_out(tmp_path)
    photos = reading.read_gauged(tmp_path, sensor.camera)
    assert len(photos.presses) == 43
    assert photos.recordings == ["grip 0", "grip 1"]
    assert max(press.force for press in photos.presses) == pytest.approx(25.35)
