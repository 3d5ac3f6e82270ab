"""Fit a shipped sensor file to the reference photographs of a real unit, by `tacgen calibrate optics`.

    python scripts/calibrate_optics.py gelsight_mini [../shared/reference/gelsight_mini] [-o mine.yaml]

All this does is to lay the photographs out as that command wants them: background.png and presses.csv. Of DIGIT's
presses nobody wrote down the contact circles; those below were found together with its lights.
"""

import argparse
import csv
import tempfile
from collections.abc import Iterable
from pathlib import Path

from tacgen import calibrate

ROOT = Path(__file__).resolve().parents[1]
UNTOUCHED = {"ninedtact": "reference_rectified.png"}
DIGIT_BALL = 1.9  # [mm]
DIGIT = {  # middle and radius of the contact [px]
    "sphere_0001.png": (142.5, 147.6, 34.9),
    "sphere_0005.png": (118.1, 196.1, 35.8),
    "sphere_0010.png": (99.7, 92.2, 36.0),
    "sphere_0017.png": (79.4, 175.2, 35.1),
    "sphere_0024.png": (102.4, 221.1, 34.8),
    "sphere_0036.png": (163.5, 228.4, 35.3),
}
NINE_PRESS = ("ball_R4mm_rectified.png", 4.0, 245.0, 189.5, 1.78)  # radius [mm], place [px], depth [mm]
Row = tuple[str, float, float, float, float]


def presses(name: str, folder: Path) -> tuple[str, Iterable[Row]]:
    """The last column's name, and a row for each press."""
    if name == "gelsight_mini":
        rows = csv.DictReader((folder / "circles.csv").read_text().splitlines())
        return "contact_radius_px", [
            (row["image"], float(row["ball_diameter_mm"]) / 2, float(row["cx_px"]), float(row["cy_px"]),
             float(row["contact_radius_px"])) for row in rows
        ]  # fmt: skip
    if name == "digit":
        return "contact_radius_px", [(file, DIGIT_BALL, *circle) for file, circle in DIGIT.items()]
    return "depth_mm", [NINE_PRESS]


def lay_out(name: str, folder: Path, into: Path) -> None:
    """background.png and presses.csv in a folder of links to photographs."""
    into.mkdir()
    for path in folder.iterdir():
        if path.name == UNTOUCHED.get(name, "background.png"):
            (into / "background.png").symlink_to(path.resolve())
        elif path.suffix == ".png" and path.name != "background.png":
            (into / path.name).symlink_to(path.resolve())
    last, rows = presses(name, folder)
    with (into / "presses.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("file", "ball_radius_mm", "x_px", "y_px", last), *rows])


def main() -> None:
    """Fit, and say how well."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sensor", choices=("gelsight_mini", "digit", "ninedtact"))
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("-o", "--out", type=Path)
    parser.add_argument("--start", help="the sensor file to start from; the shipped one if not given")
    parser.add_argument("--tolerance-mm", type=float, default=0.5)
    parser.add_argument("--tolerance-deg", type=float, default=5.0)
    parser.add_argument("--steps", type=int, default=10)
    asked = parser.parse_args()
    how = calibrate.Asked(asked.tolerance_mm, asked.tolerance_deg, bare=True, steps=asked.steps)
    with tempfile.TemporaryDirectory() as scratch:
        into = Path(scratch) / "reference"
        lay_out(asked.sensor, asked.folder or ROOT.parent / "shared/reference" / asked.sensor, into)
        found = calibrate.optics(asked.start or asked.sensor, into, how)
    print("\n".join(found.lines()))
    if asked.out:
        found.write(asked.out)


if __name__ == "__main__":
    main()
