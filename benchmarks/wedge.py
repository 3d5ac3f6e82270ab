"""Forces from pictures of a GelSight Wedge: `tacgen calibrate unit` on one grip of a ball, judged on the other."""

import csv
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks import photographs
from benchmarks.results_page import ROOT, Cell, Say, Table, columns
from tacgen.calibrate import unit

FOLDER, TABLE = "gelsight_wedge", "forces.csv"
SENSOR = ROOT / "benchmarks" / "wedge_unit.yaml"
BALL = 42.7 / 2  # radius of a golf ball, the least that its rules allow [mm]
RATE = 30.0  # pictures a second
SIZE = 320, 248  # square pixels: the rectified pictures of 320 x 280 show 31 x 24 mm


def here() -> bool:
    """Whether the photographs are there."""
    return (photographs.reference() / FOLDER / TABLE).is_file()


def lay_out(out: Path) -> None:
    """Write the photographs and their table as `calibrate unit` takes them into `out`."""
    from PIL import Image

    folder = photographs.reference() / FOLDER
    lines = ["file,ball_radius_mm,force_n,recording,time_s,untouched"]
    for row in csv.DictReader((folder / TABLE).read_text(encoding="utf-8").splitlines()):
        plain = f"golf_{row['video']}_untouched.png"
        for name in (row["image"], plain):
            with Image.open(folder / name) as picture:
                picture.convert("RGB").resize(SIZE, Image.Resampling.LANCZOS).save(out / name)
        time = int(row["frame"]) / RATE
        lines.append(f"{row['image']},{BALL},{row['force_n']},grip {row['video']},{time:.4f},{plain}")
    (out / "presses.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def tables(say: Say) -> list[Table]:
    """Numbers of the unit with their intervals, and errors of forces that a fit has not seen."""
    with TemporaryDirectory() as scratch:
        lay_out(Path(scratch))
        made = unit.unit(str(SENSOR), Path(scratch), unit.Asked(lights=False))
    for line in made.lines():
        say(f"wedge: {line}")
    young, fitted = made.sensor.gel.layers[0].model_dump()["youngs_modulus_mpa"], made.fitted
    found: list[list[Cell]] = [
        ["gel thickness [mm]", *(getattr(fitted.thickness, key) for key in ("value", "low", "high")),
         made.sensor.gel.thickness_mm],
        ["Young's modulus [MPa]", *(young * getattr(fitted.modulus, key) for key in ("value", "low", "high")), young],
        ["zero of the gauge [N]", *(getattr(fitted.zero, key) for key in ("value", "low", "high")), None],
    ]  # fmt: skip
    errors: list[list[Cell]] = [
        [one.name, len(one.force), one.mae(one.floor), one.mae(one.predicted), one.mae(one.foreign),
         one.mae(one.unaligned), one.mae(one.ceiling)] for one in made.judged
    ]  # fmt: skip
    heads = ("judged on", "pictures", "mean of the other grip's forces [N]: .2f", "from pictures [N]: .2f",
             "with the other grip's colours [N]: .2f",
             "without alignment in time [N]: .2f", "rising curve through the judged [N]: .2f")  # fmt: skip
    return [
        Table("A GelSight Wedge by a golf ball", columns("", "found: .3g", "low: .3g", "high: .3g", "published: .3g"),
              found, "With 95 % intervals, of both grips; published by those who used the unit, the modulus from its"
              " hardness. The ball's dimples are not in the model."),
        Table("Forces on a GelSight Wedge", columns(*heads), errors,
              "Mean absolute error of forces up to 25 N, each grip judged by the fit to the other. The gauge lags by up"
              " to three pictures, differently in each grip: the lag of the judged grip is fitted to its own forces,"
              " one number; beside it without alignment. The judged pictures, without their forces, tell the contrast"
              " where this grip pressed; beside it with the contrast of the other grip, 1.2 mm away. The gauge's own"
              " scatter is 1 to 1.5 N."),
    ]  # fmt: skip
