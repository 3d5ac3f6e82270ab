"""Calibration of the moduli of a sensor file to measured forces of presses."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base.errors import UserError
from tacgen.calibrate import force_curves, material_fit, solved_presses
from tacgen.calibrate.material_fit import MaterialFit, modulus_in_range
from tacgen.calibrate.sensor_fit import Evidence, SensorFit, digits, moduli
from tacgen.recipe import assets, plan
from tacgen.recipe.row import Row
from tacgen.report import fit_figures
from tacgen.report.sheet import counted
from tacgen.sensor.layers import IsochoricLayer
from tacgen.sensor.yaml_source import KeyPath, at, format_path, parse_path

MIN_REPORTED_CORRELATION = 0.5  # smallest correlation that is reported
MAX_PRINTED_FORCES = 12  # rows of the table that are printed
SECOND_PARAMETER_VALUES = 5  # values of the second parameter for which curves are solved
MATERIAL_MEASURE_HINTS = {
    "modulus": "measure the force at more depths, also at deeper ones",
    "zero": "measure small depths as well as large ones, or give --no-zero",
    "second": "measure what depends on it, such as larger depths, or leave --second out",
    "g": "record faster presses and the force while the depth is held, or ask for fewer terms by --prony",
    "tau": "record the force more often and longer while the depth is held, or ask for fewer terms by --prony",
}
MAX_PARAMETER_VALUE = 1e6  # of the ends of the second parameter's range
MATERIAL_SOURCE = "by tacgen calibrate material"


@dataclass(frozen=True)
class Unknowns:
    """Unknowns of the fit besides the modulus."""

    zero: bool = True  # the depth of first touch
    second: str = ""  # PATH=LOW:HIGH, a number of the recipe, or under `sensor.` of the sensor file
    terms: int = 0  # number of terms of a Prony series

    @property
    def path(self) -> str:
        """The path of the second parameter; empty if none."""
        return self.second.partition("=")[0].strip()


@dataclass(frozen=True)
class Material(SensorFit):
    """A fit, and simpler fits for comparison."""

    asked: Unknowns
    fitted: MaterialFit
    simpler: dict[str, MaterialFit]

    def lines(self) -> Iterator[str]:
        """Report in text."""
        measured, worst = self.fitted.measured, 100 * self.fitted.worst
        count, deepest = counted(len(measured.depth), "force"), f"{measured.depth.max():g} mm"
        yield f"{self.sensor.name}: fitted to {count} down to {deepest} ({measured.name})"
        for e in self.fitted.estimates:
            yield f"  {e.told(*self._named(e.name))}"
        names = [self._named(e.name)[0] for e in self.fitted.estimates]
        for (i, first), (j, other) in combinations(enumerate(names), 2):
            if abs(r := self.fitted.correlation[i, j]) >= MIN_REPORTED_CORRELATION:
                yield f"  correlation of {first} and {other}: {r:.2f}"
        yield f"forces are off by {worst:.1f} % at most:"
        rows = list(zip(measured.depth, measured.force, self.fitted.force, self.fitted.off, strict=True))
        for depth, force, model, off in rows[:: -(-len(rows) // MAX_PRINTED_FORCES)]:
            yield f"  {depth:g} mm: {force:.4g} N, fitted {model:.4g} N, {100 * off:+.1f} %"
        for name, fit in self.simpler.items():
            yield f"{name} alone: off by {100 * fit.worst:.1f} % at most, modulus {fit['modulus']:.4g} times the file's"
        yield from self.fitted.estimate("modulus").told_of(self.changes)
        for key, value in self.changes.items():
            if key[-1] != "source" and not str(key[-1]).endswith("_mpa"):
                yield f"{format_path(key)}: {value}"

    def plain(self) -> dict[str, Any]:
        """Report as JSON values."""
        estimates = {
            self._named(e.name)[0]: {"value": e.value, "low": e.low, "high": e.high, "bound": e.bound}
            for e in self.fitted.estimates
        }
        return {
            "sensor": self.sensor.name, "estimates": estimates, "force_n": self.fitted.force.tolist(),
            "off": self.fitted.off.tolist(), "correlation": self.fitted.correlation.tolist(),
            "simpler": {name: {"modulus": fit["modulus"], "worst": fit.worst} for name, fit in self.simpler.items()},
            "changes": self.changed,
        }  # fmt: skip

    def evidence(self) -> Evidence:
        """The forces."""
        return Evidence(force=(self.fitted.force, self.fitted.measured.force, 1.0))

    def draw(self, out: Path) -> None:
        """Plot forces and residuals into `out`."""
        measured = self.fitted.measured
        fit_figures.forces_over_depth(measured.depth, measured.force, self.fitted.force, self.fitted.off, out)

    def _named(self, name: str) -> tuple[str, str]:
        """The displayed name of a parameter, and the unit after its value."""
        plain = {"modulus": ("modulus", " times the file's"), "zero": ("zero", " mm: first touch is above the table's")}
        second = self.asked.path
        return plain.get(name) or ((second, "") if name == "second" else (name, " s" if name[0] == "t" else ""))


def _changes(row: Row, second: str, fitted: MaterialFit) -> dict[KeyPath, Any]:
    """Changed values of the sensor file by path; `second`: the path of the second parameter."""
    out: dict[KeyPath, Any] = {}
    if second.startswith("sensor."):
        out[parse_path(second)[1:]] = digits(fitted["second"])
    factor = fitted.estimate("modulus")
    count = sum(e.name.startswith("tau") for e in fitted.estimates)
    terms = [(digits(fitted[f"g{i}"]), digits(fitted[f"tau{i}"])) for i in range(1, count + 1)]
    series = [{"g": g, "tau_s": tau} for g, tau in terms]
    for k, layer in enumerate(row.sensor.gel.layers):
        here: KeyPath = ("gel", "layers", k)
        for key in moduli(layer):
            out[*here, key] = digits(factor.value * out.get((*here, key), getattr(layer, key)))
        if series and isinstance(layer, IsochoricLayer):
            out[*here, "prony"] = series
        by = f"fitted to measured forces of a {row.recipe.indenter.shape} ({fitted.measured.name}) {MATERIAL_SOURCE}"
        out[*here, "source"] = f"{layer.source}; moduli {factor.times}, {by}"
    return out


def material(sensor: str, recipe: str, table: Path, asked: Unknowns | None = None) -> Material:
    """Fit the moduli of a sensor file to the forces in a table, with indenter, friction and mesh of a recipe.

    Raises:
        UserError: unreadable or unusable input, or a press for which the solver fails.
    """
    asked, measured, path = asked or Unknowns(), force_curves.read(table), assets.sensor_path(sensor)
    sets = (f"sensor={path.resolve()}",)
    rows = plan.load(assets.recipe_path(recipe), sets).rows
    if len(rows) != 1:
        raise UserError(f"{recipe}: vary: gives {len(rows)} scenes, and a fit takes the indenter of one")
    if rows[0].recipe.sensor_overrides:
        raise UserError(f"{recipe}: sensor_overrides: would be lost in the sensor file: make one with them first")
    if asked.terms and measured.time is None:
        raise UserError(f"{table}: has no column time_s, without which nothing relaxes")
    deepest, start = float(measured.depth.max()), rows[0].recipe.start
    deeper = 1 + force_curves.FIRST_TOUCH_RANGE
    if said := solved_presses.problem(rows[0].sensor.gel, (start.x_mm, start.y_mm), deepest, deeper):
        raise UserError(f"{table}: depth_mm: the largest {said}")
    depths = force_curves.depths_for(deepest)
    if asked.second:
        name, values, now = _range(asked.second, rows[0])
        varied = [plan.load(assets.recipe_path(recipe), (*sets, f"{name}={value!r}")).rows[0] for value in values]
        forces = np.array([force_curves.solved(row, depths) for row in varied])
        curves = force_curves.Curves(depths, forces, np.array(values))
    else:
        name, now = "", None
        curves = force_curves.Curves(depths, force_curves.solved(rows[0], depths)[None])
    simpler = {}
    try:
        fitted = material_fit.fit(curves, measured, zero=asked.zero, terms=asked.terms)
        if wrong := [f"{table}: {said}" for said in _undetermined(fitted, name)]:
            raise UserError(wrong)
        if asked.zero and (name or asked.terms):
            simpler["modulus and zero"] = material_fit.fit(curves, measured, value=now)
        if name and (asked.zero or asked.terms):
            simpler[f"modulus and {name}"] = material_fit.fit(curves, measured, zero=False)
        if asked.zero or name or asked.terms:
            simpler["modulus"] = material_fit.fit(curves, measured, zero=False, value=now)
    except ValueError as error:
        raise UserError(f"{table}: {error}") from None
    return Material(path, rows[0].sensor, _changes(rows[0], asked.path, fitted), asked, fitted, simpler)


def _undetermined(fitted: MaterialFit, second: str) -> Iterator[str]:
    """A message on the numbers that the forces do not determine, and what to measure."""
    if not modulus_in_range(fitted["modulus"]):
        yield f"forces are as of a modulus {fitted['modulus']:.3g} times the file's: are they in N, and depths in mm?"
        return
    for e in fitted.estimates:
        if e.open:
            kind = e.name.rstrip("0123456789")
            shown = second if e.name == "second" else e.name
            yield f"{shown}: is not determined: these forces allow its whole range: {MATERIAL_MEASURE_HINTS[kind]}"


def _range(text: str, row: Row) -> tuple[str, list[float], float]:
    """`PATH=LOW:HIGH` -> the path, values over the range, and what the files have there."""
    name, equals, ends = text.partition("=")
    low, colon, high = ends.partition(":")
    try:
        path = parse_path(name.strip())
        first, last = float(low), float(high)
        if not (equals and colon and -MAX_PARAMETER_VALUE < first < last < MAX_PARAMETER_VALUE):  # nor nan
            raise ValueError
    except ValueError:
        raise UserError(
            f"--second {text}: must be PATH=LOW:HIGH, such as contact.friction=0:0.5 or"
            " sensor.gel.layers[0].poissons_ratio=0.45:0.499"
        ) from None
    now = at(row.sensor_document(), path[1:]) if path[0] == "sensor" else at(row.document(), path)
    if not isinstance(now, int | float):
        raise UserError(f"--second {text}: {name} is no number of the recipe or the sensor file")
    if not first <= now <= last:
        raise UserError(f"--second {text}: {name} is {now:g}, which the range must hold")
    return name.strip(), np.linspace(first, last, SECOND_PARAMETER_VALUES).tolist(), float(now)
