"""One press by other methods: CalculiX if it is installed, and tetrahedra."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import calculix
from benchmarks.calculix import Pressed
from benchmarks.reference_runs import BALL, answer, kept, row_of
from benchmarks.results_page import Cell, Level, Plot, Result, Say, Series, Table, columns, cores
from tacgen.base import array_cache
from tacgen.recipe import scene_of_row

ABOUT = (
    "One press on the Mini's pad (ball of 4 mm, 1 mm deep, no friction, E 0.15 MPa, nu 0.48), on one core, in"
    " processor seconds without meshing. tacgen solves the whole pad; CalculiX the whole pad, and a quarter"
    " by symmetry. Errors are against the mean of both programs on fine meshes."
)
PRESS = (
    *BALL,
    "contact.friction=0",
    "trajectory=[{press: {depth_mm: 1.0, frames: 1}}]",
    "sensor.gel.layers[0].youngs_modulus_mpa=0.15",
    "sensor.gel.layers[0].poissons_ratio=0.48",
)
EQUAL = 0.01  # force error at which times are compared [-]
FINEST = 0.6  # element edge of CalculiX's fine mesh [mm]


@dataclass(frozen=True)
class Runs:
    """One method on several meshes."""

    name: str
    labels: list[str]
    nodes: list[int]
    seconds: list[float]
    forces: list[float]

    def errors(self, reference: float) -> list[float]:
        return [force / reference - 1 for force in self.forces]

    def cheapest(self, reference: float) -> float | None:
        """Time of the coarsest mesh from which on all errors are at most EQUAL; None if there is none."""
        found = None
        for seconds, error in zip(self.seconds[::-1], self.errors(reference)[::-1], strict=True):  # finest first
            if abs(error) > EQUAL:
                break
            found = seconds
        return found


def bench(level: Level, say: Say) -> Result:
    """Every method on several meshes."""
    smoke = level == "smoke"
    with cores(level) as every:  # runs that are not timed may share the machine
        finest = dict(_finest(smoke, every))
    say(", ".join(f"{name}: {force:.4f} N" for name, force in finest.items()))
    reference = sum(finest.values()) / len(finest)
    answer((*PRESS, "quality={edge_mm: 1.5}"))  # compile
    ours = _runs("tacgen, hexes (Q1P0)", _tacgen(), (1.5, 1.2) if smoke else (0.8, 0.7, 0.6, 0.5, 0.4, 0.3), say)
    runs = [ours]
    if not smoke:
        runs.append(_runs("tacgen, P2 tetrahedra", _tacgen("mesh=tet"), (0.8, 0.6, 0.45), say))
        runs.append(_runs("tacgen, P1 tetrahedra", _tacgen("mesh=linear_tet"), (0.6, 0.4, 0.25, 0.15), say))
    if calculix.installed() and not smoke:
        runs.append(_calculix((2.0, 1.2) if level == "normal" else (2.0, 1.2, 0.8, 0.6, 0.5), True, say))
        runs.append(_calculix((2.0,), False, say))
    rows: list[list[Cell]] = []
    for one in runs:
        parts = (one.labels, one.nodes, one.seconds, one.forces, one.errors(reference))
        rows += [[one.name, *row] for row in zip(*parts, strict=True)]
    rows += [[f"finest, {name}", "", None, None, force, force / reference - 1] for name, force in finest.items()]
    heads = columns("method", "edge [mm]", "nodes: d", "s: .2f", "force [N]: .4f", "error: +.2%")
    note = "Seconds from the mesh to the force; for CalculiX those of the whole program."
    tables = [Table("One press", heads, rows, note), _equal(runs, ours, reference)]
    series = [Series(r.name, r.seconds, [abs(e) for e in r.errors(reference)], r.labels) for r in runs]
    plot = Plot("Force error of one press", "s", "|error| of the force [-]", series)
    return Result(ABOUT, tables, [plot])


def _finest(smoke: bool, every: Callable[..., Iterator[float]]) -> Iterator[tuple[str, float]]:
    """Force [N] by each program on a fine mesh, computed once."""
    quality: dict[str, str | None] = {"tacgen, quality `reference`": "reference"}  # or by CalculiX
    if smoke:
        quality = {"tacgen, coarse": "{edge_mm: 1.0, dhat_mm: 0.1}"}
    elif calculix.installed():
        quality[f"{calculix.version()}, edge {FINEST:g} mm"] = None
    return zip(quality, every(_fine, quality, quality.values()), strict=True)


def _fine(name: str, quality: str | None) -> float:
    """Force [N] by tacgen at this quality; if None by CalculiX, whose version is part of `name`."""
    if quality is not None:
        return -float(kept((*PRESS, f"quality={quality}")).force[-1, 2])
    gel = scene_of_row.build(row_of(PRESS)).gel
    key = array_cache.digest([name, *PRESS, Path(calculix.__file__).read_bytes()])
    return float(array_cache.kept_one("bench", key, lambda: np.array(calculix.press(gel, 4.0, 1.0, FINEST).force)))


def _runs(name: str, press: Callable[[float], Pressed], edges: tuple[float, ...], say: Say) -> Runs:
    """One method on meshes of several edges [mm]."""
    runs = Runs(name, [f"{edge:g}" for edge in edges], [], [], [])
    for edge in edges:
        found = press(edge)
        runs.nodes.append(found.nodes)
        runs.seconds.append(found.seconds)
        runs.forces.append(found.force)
        say(f"{name}, edge {edge:g}: {found.force:.4f} N in {found.seconds:.2f} s")
    return runs


def _tacgen(*sets: str) -> Callable[[float], Pressed]:
    """The press by tacgen with these changes, as a function of the element edge [mm]."""

    def press(edge: float) -> Pressed:
        found = answer((*PRESS, *sets, f"quality={{edge_mm: {edge}}}"))
        return Pressed(-float(found.force[-1, 2]), found.nodes, found.setup + found.seconds)

    return press


def _calculix(edges: tuple[float, ...], quarter: bool, say: Say) -> Runs:
    gel = scene_of_row.build(row_of(PRESS)).gel
    name = f"{calculix.version()}, C3D20R, {'a quarter' if quarter else 'the whole pad'}"
    return _runs(name, lambda edge: calculix.press(gel, 4.0, 1.0, edge, quarter=quarter), edges, say)


def _equal(runs: list[Runs], ours: Runs, reference: float) -> Table:
    """The time of each method for a force error of EQUAL, and its error in the time that tacgen needs for that."""
    base, rows = ours.cheapest(reference), list[list[Cell]]()
    for one in runs:
        least = one.cheapest(reference)
        ratio = None if least is None or base is None else least / base
        errors = one.errors(reference)
        within = [abs(e) for e, s in zip(errors, one.seconds, strict=True) if base is not None and s <= base]
        rows.append([one.name, "not reached" if least is None else f"{least:.2f}", ratio, min(within, default=None)])
    heads = columns("method", f"s to {EQUAL:.0%}", "times ours: .1f", "best error in our time: .1%")
    if not calculix.installed():
        rows.append(["CalculiX", "not installed here", None, None])
    return Table(
        "At equal error, and at equal time", heads, rows, "The coarsest mesh from which on all errors are within that."
    )
