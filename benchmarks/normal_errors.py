"""Where the error of normals in photographs comes from.

    python -m benchmarks.normal_errors

A network that is trained on dents of the unit's sensor file judges rendered presses at the places of the photographed
ones, with one source of error after the other: without noise, with the camera's, with the coating's grain too, and
solved faces whose contact circles are found in the picture as they are in photographs. It then judges the photographed
presses, and these without a part of their error: with the centres moved, and without the misfit (photographed less
rendered change of colour) that a polynomial in the slopes describes. Light from wrong directions leaves such a misfit,
marks on the coating and noise do not.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks import mini_units, photographs, real_grain, real_units
from benchmarks.mini_units import MiniUnit
from benchmarks.results_page import Cell, Say, Table, columns
from tacgen.calibrate import normal_net, press_faces
from tacgen.calibrate.likeness import Comparison, PictureOfPress
from tacgen.calibrate.normal_net import NormalNet
from tacgen.calibrate.photos import PhotographedPress
from tacgen.optics.hertz_dent import BallDent
from tacgen.optics.surface_grid import Surface
from tacgen.sensor.imperfections import Grain
from tacgen.sensor.model import LitSensor

Array = np.ndarray
MISFITS = ("mean", "linear", "quadratic")  # parts of the misfit, by the order of the polynomial
HEADS = (
    "rendered, no noise: .1f",
    "and the camera's noise: .1f",
    "and grain: .1f",
    "and circles found: .1f",
    "these, centres shifted: .1f",
    "photographs: .1f",
    "photographs, centres shifted: .1f",
    "their shift, rms [px]: .1f",
    *(f"less the {part} misfit: .1f" for part in MISFITS),
)
NOTE = (
    "Mean error of normals inside the contact circles [deg], by a network trained on dents of the file that was fitted"
    " to the unit. Grain: as measured (below). Circles found: faces solved at `draft`, as deep as the photographed"
    " presses, whose circles are then found in the picture; DIGIT's are not found so. Centres shifted: each circle is"
    " moved to where the ball's normals fit the network's best, which removes errors of labels, and of lights where"
    " they look alike. Less the misfit: each photographed press without what a polynomial of this order in the slopes,"
    " fitted to photographed less rendered change inside its circle, describes: smooth errors of the light."
)


def table(say: Say) -> Table:
    """A row for each unit whose photographs are there."""
    rows: list[list[Cell]] = []
    units = [(real_units.sensor_of(file), mini_units.unit(name)) for name, file in real_units.FILES.items()]
    if digit := photographs.unit("digit"):
        seen = tuple(np.zeros(digit.untouched.shape[:2], bool) for _ in digit.presses)
        units.append((real_units.sensor_of("digit"), MiniUnit("digit", digit.untouched, digit.presses, seen)))
    for sensor, unit in units:
        cells = sources(sensor, unit)
        rows.append([unit.name, *cells])
        say(f"{unit.name}: " + ", ".join(f"{head.split(':')[0]} {cell:.1f}" for head, cell in
                                         zip(HEADS, cells, strict=True) if cell is not None))  # fmt: skip
    return Table("Where the error of normals comes from", columns("unit", *HEADS), rows, NOTE)


def sources(sensor: LitSensor, unit: MiniUnit) -> list[float | None]:
    """The errors of a unit in the order of HEADS; None where a source is not known."""
    bare, random = Comparison(sensor), np.random.default_rng(0)
    faces = [press_faces.face(sensor, press, {}) for press in unit.presses]
    net = bare.net(unit.presses)

    def seen(made: Sequence[PictureOfPress]) -> list[PictureOfPress]:
        return [mini_units.without(one, hidden) for one, hidden in zip(made, unit.hidden, strict=True)]

    pairs = list(zip(unit.presses, faces, strict=True))
    clean, noisy = (seen([bare.rendered(p, f, r) for p, f in pairs]) for r in (None, random))
    real = seen([bare.photographed(p, f, unit.untouched) for p, f in pairs])
    grainy, found = None, None
    if unit.name in mini_units.FOLDERS:
        contrast, length = real_grain.fitted(real_grain.spectrum(unit.pictures, np.any(unit.hidden, axis=0)))
        grain = Grain(contrast=contrast / 100, length_mm=length * sensor.camera.mm_per_px, source="fitted")
        coat = sensor.coating.model_copy(update={"grain": grain})
        compared = Comparison(sensor.model_copy(update={"coating": coat}))
        grainy = seen([compared.rendered(p, f, random) for p, f in pairs])
        solved = [_found(compared, p, f, h, random) for (p, f), h in zip(pairs, unit.hidden, strict=True)]
        found = seen(solved)
    errors = [None if one is None else _off(net, one) for one in (clean, noisy, grainy, found)]
    moved = None if found is None else np.mean([shifted(net, one)[0] for one in found])
    better = [shifted(net, one) for one in real]
    shift = np.sqrt(np.mean([np.square(away).sum() for _, away in better]))
    less = [
        _off(net, [without(*pair, order) for pair in zip(real, clean, strict=True)]) for order in range(len(MISFITS))
    ]
    return [*errors, moved, _off(net, real), np.mean([e for e, _ in better]), shift, *less]


def without(real: PictureOfPress, made: PictureOfPress, order: int) -> PictureOfPress:
    """A photographed press without the polynomial in the slopes that fits photographed less rendered change [counts]
    inside the contact."""
    x, y = (real.slopes - real.flat).T
    table = np.column_stack([x**i * y**j for i in range(order + 1) for j in range(order + 1 - i)])
    off, change = (real.change - made.change)[real.where], real.change.copy()
    change[real.where] -= table @ np.linalg.lstsq(table, off, rcond=None)[0]
    return replace(real, change=change)


def shifted(net: NormalNet, press: PictureOfPress) -> tuple[float, Array]:
    """Error of a press [deg] whose centre is moved to where the ball's normals fit the network's best, and the
    motion (x, y) [px]."""
    y, x = np.nonzero(press.where)
    table = np.column_stack([np.ones(len(x)), x - x.mean(), y - y.mean()])
    per_pixel = np.linalg.lstsq(table, press.slopes, rcond=None)[0][1:]
    seen = net.normals(press.features)
    off = (press.slopes - seen).mean(axis=0)
    away = np.linalg.solve(per_pixel.T, off)
    return float(normal_net.degrees_apart(press.slopes - off, seen).mean()), away


def _found(
    compared: Comparison, press: PhotographedPress, face: Surface, hidden: Array, random: np.random.Generator
) -> PictureOfPress:
    """A rendered solved press, as deep as a formula's dent, with the contact circle that its picture shows."""
    assert isinstance(face, BallDent)
    depth = -float(face.at(np.array([face.center]))[0, 2])
    (solved,) = press_faces.solved(compared.sensor, press, [depth], {}, "draft")
    picture = compared.picture(solved, random)
    circle = mini_units.refined(replace(press, picture=picture), compared.flat, hidden)
    return compared.photographed(circle, press_faces.face(compared.sensor, circle, {}), compared.flat)


def _off(net: NormalNet, presses: Sequence[PictureOfPress]) -> float:
    return float(np.mean([one.off(net.normals(one.features)) for one in presses]))


if __name__ == "__main__":
    table(print)
