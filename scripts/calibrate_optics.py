"""Fit the optical numbers of a sensor file to photographs of a real unit, and print them.

    python scripts/calibrate_optics.py gelsight_mini ../shared/reference/gelsight_mini
    python scripts/calibrate_optics.py digit ../shared/reference/digit
    python scripts/calibrate_optics.py ninedtact ../shared/reference/ninedtact

Light is linear in the LEDs' power, so radiances and stray light follow from a non-negative least-squares fit for each
trial of the rest. What is searched, and on which photographs, is in calibrate_mini, calibrate_digit and
calibrate_thickness.
"""

import sys
import tempfile
from pathlib import Path

import calibrate_digit
import calibrate_mini
import calibrate_thickness

from tacgen import assets, load


def _thickness() -> None:
    with tempfile.TemporaryDirectory() as scratch:
        sensor = load.read_sensor(assets.sensor_path("ninedtact"))[0]
        calibrate_thickness.fit(sensor, Path(sys.argv[1]), Path(scratch), 300)


FITS = {"gelsight_mini": calibrate_mini.main, "digit": calibrate_digit.main, "ninedtact": _thickness}

if __name__ == "__main__":
    if len(sys.argv) < 3 or sys.argv[1] not in FITS:
        sys.exit(f"{__doc__}\none of {', '.join(FITS)}, and a folder")
    FITS[sys.argv.pop(1)]()
