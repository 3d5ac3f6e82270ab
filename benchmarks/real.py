"""Comparison of rendered pictures with photographs of real units."""

from collections.abc import Iterator
from dataclasses import replace
from typing import cast

import numpy as np

from benchmarks import mini_units, normal_errors, photographs, real_dots, real_grain, real_rim, real_units, wedge
from benchmarks.photographs import Unit
from benchmarks.results_page import Absent, Cell, Level, Result, Say, Table, columns
from tacgen.calibrate import likeness, press_faces
from tacgen.calibrate.likeness import AROUND, Comparison, near
from tacgen.optics.camera_view import CameraView
from tacgen.optics.surface_grid import Surface
from tacgen.recipe import assets, loading
from tacgen.render.images import Renderer
from tacgen.sensor.model import LitSensor

Array = np.ndarray
ABOUT = (
    "Rendered pictures against photographs of balls pressed into one real unit of each sensor. Normals: mean angle"
    " inside the contact circle between the ball's normals and those of a network (smoothed change of colour and"
    " position to slopes, three layers as in the SDK of the Mini's maker) trained on rendered dents; beside it, of the"
    " same network on the same presses rendered with the camera's noise (what a perfect sensor file would reach), of a"
    " network trained on the unit's other presses, of one trained on these as rendered (what so few presses teach), and"
    " of the flat face. Contrast: change of colour per slope of the"
    " ball, rendered over real. The LEDs of the shipped files were fitted to some of these presses, as stated there."
    " SSIM of whole pictures hardly shows these differences; it is given with a lower reference, the untouched"
    " photograph, and an upper one."
)
CLEAR = ("gelsight_mini", "digit")
HEADS = ("contrast red: .2f", "green: .2f", "blue: .2f", "turned red [deg]: .0f", "green [deg]: .0f", "blue [deg]: .0f",
         "correlation red: .2f", "of green: .2f", "of blue: .2f")  # fmt: skip
SPP = 64
OTHERS = (3.0, 5.0)  # radii [mm] of the balls from which the table of grey to depth for 9DTact is made
CONTACT = 2.4  # radius [mm] around the centre within which the ball is certainly in contact


def bench(level: Level, say: Say) -> Result:
    """Every sensor with photographs. Raises Absent if there are none."""
    units = {name: unit for name in photographs.UNTOUCHED if (unit := photographs.unit(name))}
    if not units:
        raise Absent(f"no photographs in {photographs.reference()} (set TACGEN_REFERENCE)")
    normals: list[list[Cell]] = []
    colours: list[list[Cell]] = []
    similar: list[list[Cell]] = []
    for name, unit in units.items():
        sensor = cast(LitSensor, loading.read_sensor(assets.sensor_path(name))[0])
        if name not in CLEAR:
            continue
        compared = Comparison(sensor)
        faces = [press_faces.face(sensor, press, {}) for press in unit.presses]
        like = compared.likeness(unit.presses, faces, unit.untouched)
        real = [compared.photographed(p, f, unit.untouched) for p, f in zip(unit.presses, faces, strict=True)]
        random = np.random.default_rng(0)
        made = [compared.rendered(p, f, random) for p, f in zip(unit.presses, faces, strict=True)]
        others = [float(np.mean(list(_left_out(one)))) if level != "smoke" else None for one in (real, made)]
        normals.append([name, len(real), like.flat, like.normals, like.noisy, *others])
        colours.append([name, *map(float, (*like.contrast, *like.direction, *like.correlation))])
        say(f"{name}: {like}")
        similar += [[name, *row] for row in _similar(sensor, unit)] if level != "smoke" else []
    heads = columns(
        "sensor",
        "presses",
        "flat [deg]: .1f",
        "rendered to real [deg]: .1f",
        "rendered to rendered [deg]: .1f",
        "real to real, left out [deg]: .1f",
        "rendered to rendered, left out [deg]: .1f",
    )
    tables = [Table("Normals inside the contact circle", heads, normals),
              Table("Change per slope, rendered over real", columns("sensor", *HEADS), colours,
                    "Medians over presses; correlation of the change within 1.7 contact radii.")]  # fmt: skip
    if "gelsight_mini" in units and level != "smoke":
        mini = cast(LitSensor, loading.read_sensor(assets.sensor_path("gelsight_mini"))[0])
        tables += real_rim.tables(mini, units["gelsight_mini"], say)
        tables += filter(None, [real_dots.table(mini, level, say)])
        if mini_units.here():
            tables += [normal_errors.table(say), real_units.table(say), real_grain.table(mini, say)]
    if "ninedtact" in units and level != "smoke":
        tables.append(_depth(units["ninedtact"], say))
    if level != "smoke" and wedge.here():
        tables += wedge.tables(say)
    if similar:
        heads = columns("sensor", "picture", "rendered: .3f", "floor: .3f", "ceiling: .3f")
        note = "Around the dent; floor: the untouched photograph, ceiling: the press itself with noise added."
        tables.append(Table("SSIM", heads, similar, note))
    return Result(ABOUT, tables)


def _left_out(real: list[likeness.PictureOfPress]) -> Iterator[float]:
    """Error [deg] for each press of a network trained on all others."""
    for k, one in enumerate(real):
        yield one.off(likeness.learned(real[:k] + real[k + 1 :]).normals(one.features))


def _similar(sensor: LitSensor, unit: Unit) -> Iterator[list[Cell]]:
    """Structural similarity of the rendered picture, of the untouched photograph, and of the photograph with the
    camera's noise added again."""
    from skimage.metrics import structural_similarity

    renderer, random = Renderer(sensor, SPP, 0, markers=False), np.random.default_rng(0)
    flat = renderer.develop(renderer.flat()).astype(float)
    noise = renderer.develop(renderer.flat(), random).astype(float) - flat

    def alike(a: Array, b: Array, where: Array) -> float:
        how = {"channel_axis": 2, "full": True, "gaussian_weights": True, "sigma": 1.5, "data_range": 255}
        full = structural_similarity(a, b, **how)[1]  # type: ignore[no-untyped-call]
        return float(full.mean(axis=2)[where].mean())

    for press in unit.presses:
        where = near(press, AROUND)
        made = renderer.develop(renderer.image(press_faces.face(sensor, press, {})), random)
        again = np.clip(press.picture + noise, 0, 255).astype(np.uint8)
        yield [press.name, *(alike(press.picture, other, where) for other in (made, unit.untouched, again))]


def _depth(unit: Unit, say: Say) -> Table:
    """9DTact's press: depth from the decrease of grey, by a table from rendered presses of other balls, and by the
    unit's own table (gray_to_depth.csv)."""
    sensor = cast(LitSensor, loading.read_sensor(assets.sensor_path("ninedtact"))[0])
    renderer, (press,) = Renderer(sensor, SPP, 0, markers=False), unit.presses
    view, level = CameraView(sensor, renderer.sheet, markers=False), renderer.develop(renderer.flat()).astype(float)

    def deep(face: Surface) -> Array:
        at = view.look(face).position
        return np.asarray((renderer.untouched.at(at[:, :2])[:, 2] - at[:, 2]).reshape(view.shape))

    grey, known = [], []
    for ball in OTHERS:
        other = replace(press, ball=ball)
        for face in press_faces.solved(sensor, other, [0.6, 1.2, 1.8], {}):
            grey.append((level - renderer.develop(renderer.image(face))).mean(axis=2).ravel())
            known.append(deep(face).ravel())
    steps = np.arange(0.0, 70.0, 2.0)
    which = np.digitize(np.concatenate(grey), steps)
    rendered = [np.median(np.concatenate(known)[which == k + 1]) if (which == k + 1).any() else np.nan
                for k in range(len(steps))]  # fmt: skip
    (face,) = press_faces.solved(sensor, press, [cast(float, press.depth)], {})
    truth, seen = deep(face), (unit.untouched.astype(float) - press.picture).mean(axis=2)
    where = likeness.circle(truth.shape, press.center, CONTACT / sensor.camera.mm_per_px)
    own = np.loadtxt(unit.folder / "gray_to_depth.csv", delimiter=",", skiprows=1)

    def off(steps: Array, table: Array) -> float:
        found = np.interp(seen[where], steps[np.isfinite(table)], table[np.isfinite(table)])
        return float(np.sqrt(np.mean((found - truth[where]) ** 2)))

    made = (level - renderer.develop(renderer.image(face))).mean(axis=2)
    real, ours = (photographs.radial_profile(c, press.center, sensor.camera.mm_per_px) for c in (seen, made))
    profile = float(np.sqrt(np.mean((ours - real) ** 2)) / np.abs(real).max())
    row = [
        float(np.sqrt(np.mean(truth[where] ** 2))),
        off(steps + 1.0, np.array(rendered)),
        off(*own.T[:, 1:]),
        profile,
    ]
    say(
        f"ninedtact: depth off by {row[1]:.3f} mm, by its own table {row[2]:.3f}; profile {100 * profile:.1f} % of peak"
    )
    heads = columns(
        "sensor", "flat [mm]: .3f", "rendered to real [mm]: .3f", "real to real [mm]: .3f", "profile off, of peak: .1%"
    )
    note = (
        f"Within {CONTACT:g} mm of the centre, rms; the gain by thickness was fitted to this press. Profile: change of"
        " grey in rings of 0.2 mm to 9 mm around the centre, rms of rendered less photographed, over the largest."
    )
    return Table("Depth from grey", heads, [["ninedtact", *row]], note)
