"""Measurements that a person gives to `calibrate`: damaged ones end in a line, or in a result of finite numbers."""

import json
import shutil
from pathlib import Path
from random import Random

import numpy as np
import pytest
from helpers.command import tacgen_
from helpers.small_recipe import HEAD
from helpers.tiny import sensor
from PIL import Image
from ruamel.yaml import YAML

from hostile import attempts
from hostile.mutations import damaged_input, files
from tacgen.base.errors import UserError
from tacgen.calibrate import force_curves

NUMBERS = (
    *("nan", "inf", "-inf", "", " ", "0", "-1", "1e308", "-1e308", "1e-308", "1e-9", "1e9", "3.99", "0.5,1", "x"),
    *("1e400", "0x10", "1;2", '"1', "1\n", "79.9", "0.02", "2.2", "99"),
)
SIZES = ((1, 1), (80, 63), (64, 80), (1, 64), (800, 640))


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photographs of the tiny sensor and forces of a ball, sound both."""
    folder = tmp_path_factory.mktemp("measurements")
    for name in ("images", "forces"):
        (folder / name).mkdir()
    made = sensor(camera={"mm_per_px": 0.1, "width_px": 80, "height_px": 64}, markers=None)
    with (folder / "sensor.yaml").open("w") as file:
        YAML().dump(json.loads(made.model_dump_json(exclude_none=True)), file)
    picture = np.full((64, 80, 3), 90, np.uint8) + np.arange(80, dtype=np.uint8)[:, None]
    Image.fromarray(picture).save(folder / "images" / "background.png")
    y, x = np.mgrid[:64, :80]
    picture[np.hypot(x - 40, y - 30) < 15] += 25
    Image.fromarray(picture).save(folder / "images" / "press.png")
    (folder / "images" / "presses.csv").write_text(
        "file,ball_radius_mm,x_px,y_px,contact_radius_px\npress.png,4,40,30,15\npress.png,4,41,30,14.5\n"
    )
    rows = [f"{d},{0.9 * d**1.5:.4f},{t}" for t, d in enumerate((0.2, 0.4, 0.6, 0.8, 0.8, 0.8))]
    (folder / "forces" / "forces.csv").write_text("\n".join(["depth_mm,force_n,time_s", *rows]) + "\n")
    (folder / "press.yaml").write_text(f"{HEAD}  - press: {{depth_mm: 1, frames: 1}}\n")
    return folder


def spoilt(rng: Random, folder: Path) -> str:
    """A cell, a row, a picture or any bytes of a folder of measurements."""
    table, kind = files(folder, ".csv")[0], rng.choice(("cell", "cell", "cell", "row", "picture", "bytes"))
    lines = [line.split(",") for line in table.read_text().splitlines()]
    if kind == "cell":
        line, column = rng.randrange(1, len(lines)), rng.randrange(len(lines[0]))
        lines[line][column] = rng.choice(NUMBERS)
        said = f"line {line + 1}, column {column}: {lines[line][column]!r}"
    elif kind == "row":
        line = rng.randrange(len(lines))
        lines[line] = rng.choice(([], lines[line][:-1], [*lines[line], "1"], lines[-1]))
        said = f"row {line + 1}: {lines[line]}"
    elif kind == "picture" and (pictures := files(folder, ".png")):
        path, how = rng.choice(pictures), rng.choice(("size", "gone", "grey", "other"))
        size = rng.choice(SIZES) if how == "size" else (80, 64)
        path.unlink()
        if how == "other":
            Image.fromarray(np.random.default_rng(rng.randrange(99)).integers(0, 200, (64, 80, 3), np.uint8)).save(path)
        elif how != "gone":
            Image.new(rng.choice(("RGB", "L", "1", "RGBA")), size, rng.choice((0, 1))).save(path)
        return f"{path.name} {how} {size}"
    else:
        return damaged_input(rng, folder)
    table.write_text("\n".join(",".join(cells) for cells in lines) + "\n")
    return said


def calibrated(source: Path, folder: Path) -> str:
    """Calibrate to what lies in `folder`: "accepted", or "wrong" if the result holds numbers that are not finite."""
    if folder.name.startswith("images"):
        args = ["optics", "--sensor", str(source / "sensor.yaml"), "--images", str(folder), "--tolerance-mm", "0"]
    else:
        args = ["material", "--sensor", "gelsight_mini", "--recipe", str(source / "press.yaml"), "--data",
                str(folder / "forces.csv"), "--prony", str(len(folder.name) % 2)]  # fmt: skip
    done = tacgen_("calibrate", *args, "--json")
    if done.exit_code == 2:
        raise UserError(done.stderr)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return "wrong" if any(word in done.stdout for word in ("NaN", "Infinity")) else "accepted"


@pytest.mark.parametrize(("kind", "count"), [("images", 4), ("forces", 8)])
def test_damaged_measurements(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, count: int
) -> None:
    """Solved forces are replaced by a formula, and the network that judges normals hardly learns."""
    for name, few in (
        ("render_comparison.TRAINING_DENTS", 2),
        ("normal_net.ENSEMBLE_SIZE", 1),
        ("normal_net.MAX_LBFGS_STEPS", 2),
        ("steps.MAX_WORKERS", 1),  # other processes would know none of this
    ):
        monkeypatch.setattr(f"tacgen.calibrate.{name}", few)
    monkeypatch.setattr(force_curves, "solved", lambda row, depths: np.maximum(depths, 0) ** 1.5)
    calibrated(source, source / kind)  # what it imports and compiles, each child has
    bad, outcomes = [], set()
    for seed in range(count):
        folder, note = tmp_path / f"{kind}{'x' * (seed % 2)}{seed}", tmp_path / f"note{seed}"
        shutil.copytree(source / kind, folder)
        said = spoilt(Random(seed), folder)
        found = attempts.contained(lambda folder=folder: calibrated(source, folder), note)
        outcomes.add(found)
        if found not in attempts.GOOD:
            bad.append(f"{seed}: {said[:200]}: {found} {note.read_text() if note.exists() else ''}")
    assert bad == []
    assert outcomes == set(attempts.GOOD)
