"""Error of the mechanics against run time, for each choice of mesh, element, contact and solver."""

from collections.abc import Iterator
from dataclasses import astuple, dataclass, replace
from importlib.util import find_spec

import numpy as np

from benchmarks.reference_runs import DEPTHS, Answer, Error, answer, kept, row_of, sliding
from benchmarks.results_page import Cell, Level, Plot, Result, Say, Series, Table, columns, cores, front
from tacgen.mechanics import DEFAULT, NotConverged, SolverOptions, plain, short_steps

ABOUT = (
    "A ball of 4 mm is pressed 1 mm (0.8 mm on DIGIT and 9DTact) in one frame and slid by 0.6 mm in two, with"
    " friction 0.5. Errors against quality `reference`: force vector in the worst frame; pressure map and stress in"
    " the gel under the contact, L2 norms in the last frame; markers, rms in pixels. Processor seconds on one core,"
    " without meshing."
)
ERRORS = ("force: .2%", "pressure map: .1%", "stress: .1%", "markers [px]: .3f")
WORK = ("nodes: d", "iterations a frame: .1f", "s a frame: .2f")
FILLETS = {"normal": (0.3, 0.6), "full": (0.1, 0.3, 0.6, 1.2)}  # of a box [mm]; the element edge at `draft` is 0.6
SHIFTS = ((0.0, 0.0), (0.5, 0.0), (0.3, 0.5))  # of the mesh under the ball, in element edges
FORMULATIONS = [name for name in ("distance", "ipctk") if name == "distance" or find_spec("ipctk")]
BOX = "indenter={{shape: box, size_x_mm: 3, size_y_mm: 3, fillet_mm: {fillet}}}"
PRESSED, SLID = "{press: {depth_mm: 0.5, frames: 1}}", "{slide: {x_mm: 0.1, y_mm: 0.06, frames: 1}}"
AT_DRAFT = ("quality=draft",)
PRESETS = ("draft", "default")
HEXES = {
    "smoke": (1.2,),
    "normal": (0.8, 0.6, 0.5, 0.4, 0.3),
    "full": (0.8, 0.7, 0.6, 0.5, 0.45, 0.4, 0.35, 0.3, 0.25),
}


SOLVERS = {  # name: options of the solver
    "as it is": DEFAULT,
    "nothing predicted": replace(DEFAULT, predict=False),
    "pressure not mixed": replace(DEFAULT, mixed_pressure=False),
    "every tangent new": replace(DEFAULT, keep_tangent=False),
    "load steps half as long": short_steps(DEFAULT, 2),
}
FULL_SOLVERS = {"nothing condensed": replace(DEFAULT, condense=False), "plain": plain()}


@dataclass(frozen=True)
class Variant:
    """A choice: changes to the scene, and options of the solver."""

    axis: str
    name: str
    sets: tuple[str, ...] = ()
    options: SolverOptions = DEFAULT


def variants(level: Level) -> list[Variant]:
    """All choices of the sweep, each a single change to `default`, or to `draft` for the slowest."""
    found = [Variant("hex, edge", f"{e:g}", (f"quality={{edge_mm: {e}}}",)) for e in HEXES[level]]
    if level == "smoke":
        return found
    for name, element, edges in (("P2", "tet", (0.8, 0.6, 0.4)), ("P1", "linear_tet", (0.6, 0.4, 0.3))):
        found += [Variant(f"{name}, edge", f"{e:g}", (f"mesh={element}", f"quality={{edge_mm: {e}}}")) for e in edges]
    found += [Variant("dhat", f"{d:g}", (f"quality={{dhat_mm: {d}}}",)) for d in (0.1, 0.06, 0.03, 0.01)]
    for part in (10, 0.1, 0.01) if level == "full" else (10, 0.1):
        found.append(Variant("tolerances, times", f"{part:g}", (), _tolerances(part)))
    solvers = SOLVERS | FULL_SOLVERS if level == "full" else SOLVERS
    found += [Variant("draft, solver", name, AT_DRAFT, options) for name, options in solvers.items()]
    if find_spec("ipctk"):
        found.append(Variant("draft, contact", "ipctk", (*AT_DRAFT, "contact.formulation=ipctk")))
    return found


def _tolerances(times: float) -> SolverOptions:
    """Options with the usual tolerances multiplied by `times`."""
    step, residual, most = DEFAULT.step_tol, DEFAULT.residual_tol, DEFAULT.residual_max
    return replace(DEFAULT, step_tol=times * step, residual_tol=times * residual, residual_max=max(times, 1.0) * most)


def bench(level: Level, say: Say) -> Result:
    """The sweep on the Mini, and the presets on every sensor."""
    answer((*sliding("gelsight_mini"), "quality={edge_mm: 1.5}"))  # compiles
    if level == "smoke":
        return Result(ABOUT, *_sweep(level, {}, say))
    fillets = FILLETS[level]
    with cores() as every:  # runs that are not timed may share the machine
        true = [_preset(sensor, "reference") for sensor in DEPTHS]
        references = every(kept, [*true, *(_edged(fillet) for fillet in fillets)])
        boxes = every(_dragged_answer, [_dragged(fillet, name) for fillet in fillets for name in FORMULATIONS])
        placed = [_preset("gelsight_mini", name) for name in PRESETS for _ in SHIFTS]
        shifted = every(answer, placed, SHIFTS * len(PRESETS))
        list(references)
        say("references are there")
        edges, places = _edges(fillets, boxes, say), _places(shifted)
    presets = {(sensor, name): answer(_preset(sensor, name)) for sensor in DEPTHS for name in PRESETS}
    tables, plots = _sweep(level, presets, say)
    return Result(ABOUT, [*tables, places, edges, _sensors(presets, say)], plots)


def _preset(sensor: str, name: str) -> tuple[str, ...]:
    return (*sliding(sensor), f"quality={name}")


def _sweep(level: Level, presets: dict[tuple[str, str], Answer], say: Say) -> tuple[list[Table], list[Plot]]:
    base = sliding("gelsight_mini")
    reference = kept((*base, f"quality={'{edge_mm: 0.8, dhat_mm: 0.05}' if level == 'smoke' else 'reference'}"))
    rows: list[list[Cell]] = []
    for one in variants(level):
        found = answer((*base, *one.sets), options=one.options)
        rows.append([one.axis, one.name, *_work(found), *astuple(found.error(reference))])
        say(f"{one.axis} {one.name}: {found.seconds:.1f} s, force {rows[-1][5]:.2%}")
    for (sensor, name), found in presets.items():
        if sensor == "gelsight_mini":
            rows.append(["preset", name, *_work(found), *astuple(found.error(reference))])
    seconds = [float(row[4]) for row in rows]  # type: ignore[arg-type]
    errors = [[float(row[k]) for row in rows] for k in range(5, 9)]  # type: ignore[arg-type]
    best = [front(seconds, error) for error in errors]
    for i, row in enumerate(rows):
        row.append("".join(letter for letter, those in zip("fpsm", best, strict=True) if i in those))
    note = "Front: on the Pareto front of (f)orce, (p)ressure, (s)tress, (m)arkers. Everything else is as in"
    note += " `default`, or `draft` where stated."
    table = Table("Choices on the Mini", columns("choice", "value", *WORK, *ERRORS, "front"), rows, note)
    return [table], [_plot(rows, seconds, errors[k], best[k], ERRORS[k].partition(":")[0]) for k in range(4)]


def _places(shifted: Iterator[Answer]) -> Table:
    """The presets with the ball at several positions within a cell."""
    reference, rows = kept(_preset("gelsight_mini", "reference")), list[list[Cell]]()
    for name in PRESETS:
        kinds = list(zip(*(astuple(next(shifted).error(reference)) for _ in SHIFTS), strict=True))
        rows += [[name, "worst", *map(max, kinds)], [name, "best", *map(min, kinds)]]
    note = "Worst and best of three positions of the ball within a cell; in all other tables it is over a node."
    return Table("Presets wherever the ball stands", columns("preset", "error", *ERRORS), rows, note)


def _work(found: Answer) -> list[Cell]:
    frames = len(found.force)
    return [found.nodes, found.iterations / frames, found.seconds / frames]


def _plot(rows: list[list[Cell]], seconds: list[float], errors: list[float], best: list[int], what: str) -> Plot:
    def series(name: str, of: list[int], labels: bool) -> Series:
        words = [str(rows[i][1]) for i in of] if labels else []
        return Series(name, [seconds[i] for i in of], [errors[i] for i in of], words, line=not labels)

    groups = dict.fromkeys(str(row[0]) for row in rows)
    points = [series(group, [i for i, row in enumerate(rows) if row[0] == group], True) for group in groups]
    unit = "" if "[" in what else " [-]"
    return Plot(f"Error of {what}", "s a frame", f"error{unit}", [*points, series("Pareto front", best, False)])


def _edged(fillet: float, moves: str = PRESSED, quality: str = "reference") -> tuple[str, ...]:
    """A pressed box with rounded edges, without friction."""
    scene = ("outputs=[force]", BOX.format(fillet=fillet), f"trajectory=[{moves}]", "contact.friction=0")
    return (*scene, f"quality={quality}")


def _dragged(fillet: float, formulation: str) -> tuple[str, ...]:
    """Scene of a box with rounded edges that is pressed and slid."""
    return (*_edged(fillet, f"{PRESSED}, {SLID}", "draft"), f"contact.formulation={formulation}")


def _dragged_answer(sets: tuple[str, ...]) -> Answer | None:
    """None where a frame does not converge."""
    try:
        return answer(sets)
    except NotConverged:
        return None


def _edges(fillets: tuple[float, ...], boxes: Iterator[Answer | None], say: Say) -> Table:
    """A box with decreasing radius of its edges: both formulations of contact where the mesh does not resolve it."""
    rows: list[list[Cell]] = []
    for fillet in fillets:
        true, found = kept(_edged(fillet)), [next(boxes) for _ in FORMULATIONS]
        off = [None if one is None else float(one.force[0, 2] / true.force[0, 2] - 1) for one in found]
        slid = [None if one is None else one.force[1:] for one in found]
        drag = [None if f is None else float((np.hypot(*f[:, :2].T) / -f[:, 2]).max()) for f in slid]
        edge = row_of(_dragged(fillet, FORMULATIONS[0])).recipe.resolved().edge_mm
        rows.append([fillet / edge, *off, *[None] * (2 - len(off)), *drag, *[None] * (2 - len(drag))])
        say(f"fillet {fillet:g} mm: {', '.join('rejected' if part is None else f'{part:+.1%}' for part in off)}")
    heads = columns(
        "radius / edge: .2f", "force, distance: +.1%", "force, ipctk: +.1%",
        "drag, distance: .2%", "drag, ipctk: .2%",
    )  # fmt: skip
    note = (
        "A box of 3 mm at `draft`, pressed 0.5 mm without friction: error of the force against `reference`, and the"
        " largest tangential over normal force while it slides, a discretisation error. The formulations have different"
        " contact points; both have the error of a mesh that cannot follow the edge. Empty: a frame did not converge."
    )
    return Table("Edges sharper than the mesh", heads, rows, note)


def _sensors(presets: dict[tuple[str, str], Answer], say: Say) -> Table:
    """Presets against `reference` on every sensor."""
    rows: list[list[Cell]] = []
    for sensor in DEPTHS:
        reference = kept(_preset(sensor, "reference"))
        for name in PRESETS:
            found = presets[sensor, name]
            error: Error = found.error(reference)
            rows.append([sensor, name, *_work(found), *astuple(error), found.area / reference.area - 1])
            say(f"{sensor} {name}: force {error.force:.2%}, map {error.pressure:.1%}")
        rows.append([sensor, "reference", *_work(reference), *[None] * 5])
    return Table("Presets on every sensor", columns("sensor", "quality", *WORK, *ERRORS, "area: +.1%"), rows)
