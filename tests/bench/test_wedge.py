"""The Wedge part of the bench `real` is left out where its photographs are not."""

from pathlib import Path

import pytest

from benchmarks import photographs, real
from tacgen.calibrate import photos as reading
from tacgen.recipe import loading


def test_it_is_left_out_without_photographs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TACGEN_REFERENCE", str(tmp_path))
    assert not real.wedge_here()


@pytest.mark.slow
def test_its_sensor_file_and_table_are_what_the_calibration_takes(tmp_path: Path) -> None:
    sensor, _ = loading.read_sensor(real.WEDGE_UNIT)
    assert (sensor.camera.width_px, sensor.camera.height_px) == real.WEDGE_SIZE
    if not real.wedge_here():
        pytest.skip(f"no photographs in {photographs.reference()}")
    real.wedge_laid_out(tmp_path)
    photos = reading.read_gauged(tmp_path, sensor.camera)
    assert len(photos.presses) == 43
    assert photos.recordings == ["grip 0", "grip 1"]
    assert max(press.force for press in photos.presses) == pytest.approx(25.35)
