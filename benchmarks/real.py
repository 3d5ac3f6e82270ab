"""Comparison of rendered pictures with photographs of real units.

Beside normals, colours and 9DTact's depth: normals by a population without the unit that is judged, and forces from
pictures of a GelSight Wedge, by `tacgen calibrate unit` on one grip of a ball, judged on the other.
"""

import csv
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import cast

import numpy as np

from benchmarks import grain, photographs
from benchmarks.photographs import MINIS, RECIPE, SENSORS, Unit, sensor_of
from benchmarks.results_page import ROOT, Absent, Cell, Level, Result, Say, Table, columns
from tacgen.calibrate import render_comparison, solved_presses, untouched_drift
from tacgen.calibrate import unit as calibration
from tacgen.calibrate.normal_net import NormalNet
from tacgen.calibrate.render_comparison import Comparison, PressPixels, learned
from tacgen.optics.camera_view import CameraView
from tacgen.optics.surface_grid import Surface
from tacgen.recipe import assets, plan
from tacgen.render.images import Renderer
from tacgen.sensor.model import LitSensor

Array = np.ndarray
ABOUT = (
    "Rendered pictures against photographs of balls pressed into one real unit of each sensor. Normals: mean angle"
    " between the ball's normals and those of the surface that a network trained on rendered dents finds, without the"
    " drift of the untouched picture that photographs show far from contacts; beside it on the pictures as they are,"
    " on the same presses rendered with noise (a perfect sensor file), by networks trained on the unit's other presses,"
    " and of the flat face. Contrast: change of colour per slope, rendered over real. LEDs were fitted to some of these"
    " presses."
)
HEADS = ("contrast red: .2f", "green: .2f", "blue: .2f", "turned red [deg]: .0f", "green [deg]: .0f", "blue [deg]: .0f",
         "correlation red: .2f", "of green: .2f", "of blue: .2f")  # fmt: skip
PAIRS = ("rendered to real", "with drift", "rendered to rendered", "real to real, left out")
SPP = 64
OTHERS = (3.0, 5.0)  # radii [mm] of the balls from which the table of grey to depth for 9DTact is made
CONTACT = 2.4  # radius [mm] around the centre within which the ball is certainly in contact
FILES = dict(zip(MINIS, ("gelsight_mini", "gelsight_mini_second", "gelsight_mini_third"), strict=True))
DENTS = 4  # of each drawn unit
PARTS = 3  # into which a unit's presses are divided, to train on the others
TRAINED = ("other units' population", "own file", "own photographs, left out")
NOTE = (
    f"Mean error of the normals [deg], by a network trained on the units that {RECIPE} draws around the files of the"
    " two other units; on the file that was fitted to the unit itself; and on two thirds of the unit's own photographs."
    " Plate, lobes and colour matrix of all files were found on the first unit; contact circles were drawn by hand and"
    " refined by another unit's lamps."
)

WEDGE, FORCES = "gelsight_wedge", "forces.csv"
WEDGE_UNIT = ROOT / "benchmarks" / "wedge_unit.yaml"
GOLF_BALL = 42.7 / 2  # radius of a golf ball, the least that its rules allow [mm]
RATE = 30.0  # pictures a second
WEDGE_SIZE = 320, 248  # square pixels: the rectified pictures of 320 x 280 show 31 x 24 mm


def bench(level: Level, say: Say) -> Result:
    """Every sensor with photographs. Raises Absent if there are none."""
    units = {name: one for name in SENSORS if (one := photographs.unit(name))}
    if not units:
        raise Absent(f"no photographs in {photographs.reference()} (set TACGEN_REFERENCE)")
    clear = {name: one for name, one in units.items() if name != "ninedtact"}
    tables = _pictures(clear, level, say)
    whole = level != "smoke"
    if whole and all(map(photographs.there, MINIS)):
        tables += [population(say), grain.table({name: sensor_of(FILES[name]) for name in MINIS[:2]})]
    if "ninedtact" in units and whole:
        tables.append(_depth(units["ninedtact"], say))
    if whole and (photographs.reference() / WEDGE / FORCES).is_file():
        tables += wedge_tables(say)
    return Result(ABOUT, tables)


def _pictures(units: dict[str, Unit], level: Level, say: Say) -> list[Table]:
    """Errors of normals, and changes of colour, of sensors with clear gels."""
    normals, colours = list[list[Cell]](), list[list[Cell]]()
    for name, one in units.items():
        sensor = sensor_of(name)
        compared, presses = Comparison(sensor), untouched_drift.removed(one.presses, one.untouched)
        faces = [solved_presses.face(sensor, press, {}) for press in presses]
        net = compared.net(presses)
        like = compared.likeness(presses, faces, one.untouched, net)
        drifted, real = (
            [compared.photographed(*pair, one.untouched).pixels for pair in zip(some, faces, strict=True)]
            for some in (one.presses, presses)
        )
        as_is = off(net, drifted)
        lost = None
        if level != "smoke":  # networks trained on all other presses
            lost = float(np.mean([a.off(learned(b for b in real if b is not a)) for a in real]))
        normals.append([name, len(real), like.flat, like.normals, as_is, like.noisy, lost])
        colours.append([name, *map(float, (*like.contrast, *like.direction, *like.correlation))])
        say(f"{name}: {like}")
    heads = columns("sensor", "presses", "flat [deg]: .1f", *(f"{what} [deg]: .1f" for what in PAIRS))
    note = "Medians over presses; correlation of the change within 1.7 contact radii."
    return [Table("Normals inside the contact circle", heads, normals),
            Table("Change per slope, rendered over real", columns("sensor", *HEADS), colours, note)]  # fmt: skip


def _depth(unit: Unit, say: Say) -> Table:
    """9DTact's press: depth from the decrease of grey, by a table from rendered presses of other balls, and by the
    unit's own table (gray_to_depth.csv)."""
    sensor = sensor_of("ninedtact")
    renderer, (press,) = Renderer(sensor, SPP, 0, markers=False), unit.presses
    view, level = CameraView(sensor, renderer.sheet, markers=False), renderer.develop(renderer.flat()).astype(float)

    def deep(face: Surface) -> Array:
        at = view.look(face).position
        return np.asarray((renderer.untouched.at(at[:, :2])[:, 2] - at[:, 2]).reshape(view.shape))

    grey, known = [], []
    for ball in OTHERS:
        other = replace(press, ball=ball)
        for face in solved_presses.solved(sensor, other, [0.6, 1.2, 1.8], {}):
            grey.append((level - renderer.develop(renderer.image(face))).mean(axis=2).ravel())
            known.append(deep(face).ravel())
    steps = np.arange(0.0, 70.0, 2.0)
    which = np.digitize(np.concatenate(grey), steps)
    rendered = [np.median(np.concatenate(known)[which == k + 1]) if (which == k + 1).any() else np.nan
                for k in range(len(steps))]  # fmt: skip
    (face,) = solved_presses.solved(sensor, press, [cast(float, press.depth)], {})
    truth, seen = deep(face), (unit.untouched.astype(float) - press.picture).mean(axis=2)
    where = render_comparison.circle(truth.shape, press.center, CONTACT / sensor.camera.mm_per_px)
    own = np.loadtxt(unit.folder / "gray_to_depth.csv", delimiter=",", skiprows=1)

    def off(steps: Array, table: Array) -> float:
        found = np.interp(seen[where], steps[np.isfinite(table)], table[np.isfinite(table)])
        return float(np.sqrt(np.mean((found - truth[where]) ** 2)))

    pair = seen, (level - renderer.develop(renderer.image(face))).mean(axis=2)
    there, ours = (photographs.radial_profile(c, press.center, sensor.camera.mm_per_px) for c in pair)
    profile = float(np.sqrt(np.mean((ours - there) ** 2)) / np.abs(there).max())
    flat, real = float(np.sqrt(np.mean(truth[where] ** 2))), off(*own.T[:, 1:])
    made = off(steps + 1.0, np.array(rendered))
    say(f"ninedtact: depth off by {made:.3f} mm, by its own table {real:.3f}; profile {100 * profile:.1f} % of peak")
    heads = columns("sensor", *(f"{what} [mm]: .3f" for what in ("flat", "rendered to real", "real to real")),
                    "profile off, of peak: .1%")  # fmt: skip
    note = (
        f"Within {CONTACT:g} mm of the centre, rms; the gain by thickness was fitted to this press. Profile: change of"
        " grey in rings of 0.2 mm to 9 mm around the centre, rms of rendered less photographed, over the largest."
    )
    return Table("Depth from grey", heads, [["ninedtact", flat, made, real, profile]], note)


def off(net: NormalNet, presses: Iterable[PressPixels]) -> float:
    """Mean error of the normals [deg], each press weighing the same."""
    return float(np.mean([one.off(net) for one in presses]))


def drawn(sensor: LitSensor, count: int, seed: int, deepest: float) -> list[PressPixels]:
    """Dents of a unit, up to a contact radius over the ball's."""
    return [one.pixels for one in Comparison(sensor).dents(deepest, count, seed)]


def photographed(name: str, sensor: LitSensor) -> tuple[list[PressPixels], float, float]:
    """The presses of a unit, seen by the camera of a sensor file; the error of the flat face [deg]; and the contact
    radius over the ball's that dents reach which stand for them."""
    unit, compared = photographs.unit(name), Comparison(sensor)
    assert unit is not None
    faces = [solved_presses.face(sensor, press, {}) for press in unit.presses]
    seen = [compared.photographed(*pair, unit.untouched) for pair in zip(unit.presses, faces, strict=True)]
    presses = [photographs.without(*pair) for pair in zip(seen, unit.hidden, strict=True)]
    flat = float(np.mean([one.steep for one in presses]))
    return [one.pixels for one in presses], flat, compared.deepest(unit.presses)


def left_out(presses: Sequence[PressPixels]) -> float:
    """Error of networks trained on a unit's own photographs, each part of them left out once [deg]."""
    parts = [presses[k::PARTS] for k in range(PARTS)]
    nets = [learned([one for j, part in enumerate(parts) if j != k for one in part]) for k in range(PARTS)]
    each = [one.off(net) for net, part in zip(nets, parts, strict=True) for one in part]
    return float(np.mean(each))


def population(say: Say) -> Table:
    """Errors on each unit of networks trained on the others' population, and on it alone."""
    rows, shipped = plan.load(assets.recipe_path(RECIPE)).rows, sensor_of(FILES["gelsight_mini"])
    real = {name: photographed(name, shipped) for name in FILES}
    most = max(deepest for _, _, deepest in real.values())
    dents = [(row.sensor.name, drawn(cast(LitSensor, row.sensor), DENTS, row.index, most)) for row in rows]
    found: list[list[Cell]] = []
    for name, file in FILES.items():
        presses, flat, deepest = real[name]
        own = drawn(sensor_of(file), render_comparison.TRAINING_DENTS, 0, deepest)
        seen = [(unit, one) for unit, made in dents for one in made if one.steepest <= deepest]
        nets = [learned(dents) for dents in ([one for unit, one in seen if unit != file], own)]
        cells: list[Cell] = [name, len(presses), flat, *(off(net, presses) for net in nets), left_out(presses)]
        found.append(cells)
        say(f"{name}: {', '.join(f'{cell:.1f}' for cell in cells[2:] if isinstance(cell, float))}")
    heads = columns("unit", "presses", "flat: .1f", *(f"{what}: .1f" for what in TRAINED))
    return Table("A population on a unit that it has not seen", heads, found, NOTE)


def wedge_laid_out(out: Path) -> None:
    """Write the photographs and their table as `calibrate unit` takes them into `out`."""
    from PIL import Image

    folder = photographs.reference() / WEDGE
    lines = ["file,ball_radius_mm,force_n,recording,time_s,untouched"]
    for row in csv.DictReader((folder / FORCES).read_text(encoding="utf-8").splitlines()):
        plain = f"golf_{row['video']}_untouched.png"
        for name in (row["image"], plain):
            with Image.open(folder / name) as picture:
                picture.convert("RGB").resize(WEDGE_SIZE, Image.Resampling.LANCZOS).save(out / name)
        time = int(row["frame"]) / RATE
        lines.append(f"{row['image']},{GOLF_BALL},{row['force_n']},grip {row['video']},{time:.4f},{plain}")
    (out / "presses.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def wedge_tables(say: Say) -> list[Table]:
    """Numbers of the unit with their intervals, and errors of forces that a fit has not seen."""
    with TemporaryDirectory() as scratch:
        wedge_laid_out(Path(scratch))
        made = calibration.unit(str(WEDGE_UNIT), Path(scratch), calibration.Asked(lights=False))
    for line in made.lines():
        say(f"wedge: {line}")
    young, fitted = made.sensor.gel.layers[0].model_dump()["youngs_modulus_mpa"], made.fitted
    thick = "gel thickness [mm]", fitted.thickness, 1.0, made.sensor.gel.thickness_mm
    each = (
        thick,
        ("Young's modulus [MPa]", fitted.modulus, young, young),
        ("zero of the gauge [N]", fitted.zero, 1, None),
    )
    found: list[list[Cell]] = [[name, *(unit * one for one in (of.value, of.low, of.high)), published]
                               for name, of, unit, published in each]  # fmt: skip
    errors: list[list[Cell]] = [
        [one.name, len(one.force), one.mae(one.floor), one.mae(one.predicted), one.mae(one.foreign),
         one.mae(one.unaligned), one.mae(one.ceiling)] for one in made.judged
    ]  # fmt: skip
    heads = ("judged on", "pictures", *(f"{what} [N]: .2f" for what in (
        "mean of the other grip's forces", "from pictures", "with the other grip's colours",
        "without alignment in time", "rising curve through the judged")))  # fmt: skip
    return [
        Table("A GelSight Wedge by a golf ball", columns("", "found: .3g", "low: .3g", "high: .3g", "published: .3g"),
              found, "With 95 % intervals, of both grips; published by those who used the unit, the modulus from its"
              " hardness. The ball's dimples are not in the model."),
        Table("Forces on a GelSight Wedge", columns(*heads), errors,
              "Mean absolute error of forces up to 25 N, each grip judged by the fit to the other; the lag of the"
              " judged grip's gauge is fitted to its own forces. The judged pictures, without their forces, tell the"
              " contrast; beside it with that of the other grip. The gauge's own scatter is 1 to 1.5 N."),
    ]  # fmt: skip
