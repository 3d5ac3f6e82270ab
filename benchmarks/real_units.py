"""A population of units against photographs of a unit that it was not fitted to.

`recipes/many_units.yaml` draws around the files of three real Minis. For each of these units a network for normals is
trained on dents of the drawn units that stem from the other two, and scored on the photographs of this one.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple, cast

import numpy as np

from benchmarks import mini_units
from benchmarks.results_page import Cell, Say, Table, columns
from tacgen.calibrate import likeness, normal_net, press_faces
from tacgen.calibrate.likeness import Comparison, PictureOfPress
from tacgen.calibrate.normal_net import NormalNet
from tacgen.recipe import assets, loading, plan
from tacgen.sensor.model import LitSensor

Array = np.ndarray
RECIPE = "many_units"
FILES = {  # folder of a unit's photographs: name of the sensor file that was fitted to them
    "gelsight_mini": "gelsight_mini",
    "gelsight_mini_unit2": "gelsight_mini_second",
    "gelsight_mini_dotted": "gelsight_mini_third",
}
DENTS = 4  # of each drawn unit
PARTS = 3  # into which a unit's presses are divided, to train on the others
HEADS = ("other units' population", "whole population", "own file", "own photographs, left out")
NOTE = (
    "Mean error of the normals inside the contact circles [deg], by a network trained on dents of the units that"
    f" {RECIPE} draws around the files of the two other units; around all three; of the file that was fitted to the"
    " unit itself (its presses seen); and on the unit's own photographs, each third of them left out once. Plate,"
    " lobes and colour matrix of all files were found on the first unit. Pixels that a dot hides are left out; the"
    " contact circles of the dotted unit were drawn by hand, up to 0.85 of the ball's radius."
)


class Samples(NamedTuple):
    """Pixels inside one contact circle, as a network sees them."""

    features: Array  # (n, 5)
    slopes: Array  # x and y of the unit normals (n, 2)

    @classmethod
    def of(cls, press: PictureOfPress) -> "Samples":
        """All pixels of a press."""
        return cls(press.features, press.slopes)

    @property
    def steepest(self) -> float:
        """Largest slope: hardly less than the contact radius over the ball's."""
        return float(np.linalg.norm(self.slopes, axis=1).max())


def off(net: NormalNet, presses: Iterable[Samples]) -> float:
    """Mean error of the normals [deg], each press weighing the same."""
    each = [normal_net.degrees_apart(one.slopes, net.normals(one.features)).mean() for one in presses]
    return float(np.mean(each))


def drawn(sensor: LitSensor, count: int, seed: int, deepest: float) -> list[Samples]:
    """Dents of a unit, up to a contact radius over the ball's."""
    return [Samples.of(one) for one in Comparison(sensor).dents(deepest, count, seed)]


def photographed(name: str, sensor: LitSensor) -> tuple[list[Samples], float, float]:
    """The presses of a unit, seen by the camera of a sensor file; the error of the flat face [deg]; and the contact
    radius over the ball's that dents reach which stand for them."""
    unit, compared = mini_units.unit(name), Comparison(sensor)
    presses = [
        mini_units.without(compared.photographed(press, press_faces.face(sensor, press, {}), unit.untouched), hidden)
        for press, hidden in zip(unit.presses, unit.hidden, strict=True)
    ]
    flat = float(np.mean([one.off(one.flat) for one in presses]))
    return [Samples.of(one) for one in presses], flat, compared.deepest(unit.presses)


def left_out(presses: Sequence[Samples]) -> float:
    """Error of networks trained on a unit's own photographs, each part of them left out once [deg]."""
    parts = [presses[k::PARTS] for k in range(PARTS)]
    nets = [NormalNet.trained([one for j, part in enumerate(parts) if j != k for one in part]) for k in range(PARTS)]
    each = [off(net, [one]) for net, part in zip(nets, parts, strict=True) for one in part]
    return float(np.mean(each))


def table(say: Say) -> Table:
    """Errors on each unit of networks trained without it, with it, and on it alone."""
    rows, shipped = plan.load(assets.recipe_path(RECIPE)).rows, sensor_of(FILES["gelsight_mini"])
    real = {name: photographed(name, shipped) for name in FILES}
    most = max(deepest for _, _, deepest in real.values())
    dents = [(row.sensor.name, drawn(cast(LitSensor, row.sensor), DENTS, row.index, most)) for row in rows]
    say(f"{len(rows)} units drawn")
    found: list[list[Cell]] = []
    for name, file in FILES.items():
        presses, flat, deepest = real[name]
        own = drawn(sensor_of(file), likeness.DENTS, 0, deepest)
        seen = [(unit, one) for unit, made in dents for one in made if one.steepest <= deepest]
        others, every = [one for unit, one in seen if unit != file], [one for _, one in seen]
        cells: list[Cell] = [name, len(presses), flat]
        cells += [off(NormalNet.trained(seen), presses) for seen in (others, every, own)]
        cells.append(left_out(presses))
        found.append(cells)
        say(f"{name}: {', '.join(f'{cell:.1f}' for cell in cells[2:] if isinstance(cell, float))}")
    heads = columns("unit", "presses", "flat: .1f", *(f"{what}: .1f" for what in HEADS))
    return Table("A population on a unit that it has not seen", heads, found, NOTE)


def sensor_of(name: str) -> LitSensor:
    """The sensor file of a unit, shipped or of the population."""
    beside = assets.recipe_path(RECIPE).parent / "units" / f"{name}.yaml"
    return cast(LitSensor, loading.read_sensor(beside if beside.is_file() else assets.sensor_path(name))[0])
