"""Error of the mechanics against run time, for each choice of mesh, element, tolerances and solver."""

from dataclasses import astuple, dataclass, replace

from benchmarks.reference_runs import DEPTHS, Answer, Error, answer, kept, sliding
from benchmarks.results_page import Cell, Level, Plot, Result, Say, Series, Table, columns, cores, front
from tacgen.mechanics import DEFAULT_OPTIONS, SolverOptions, plain, short_steps

ABOUT = (
    "A ball of 4 mm is pressed 1 mm (0.8 mm on DIGIT and 9DTact) in one frame and slid by 0.6 mm in two, with"
    " friction 0.5. Errors against quality `reference`: force vector in the worst frame; pressure map and stress in"
    " the gel under the contact, L2 norms in the last frame; markers, rms in pixels. Processor seconds on one core,"
    " without meshing."
)
ERRORS = ("force: .2%", "pressure map: .1%", "stress: .1%", "markers [px]: .3f")
WORK = ("nodes: d", "iterations a frame: .1f", "s a frame: .2f")
AT_DRAFT = ("quality=draft",)
PRESETS = ("draft", "default")
HEXES = {"smoke": (1.2,), "normal": (0.8, 0.6, 0.5, 0.4, 0.3), "full": (0.8, 0.7, 0.6, 0.5, 0.45, 0.4, 0.35, 0.3, 0.25)}


SOLVERS = {  # name: options of the solver
    "as it is": DEFAULT_OPTIONS,
    "nothing predicted": replace(DEFAULT_OPTIONS, predict=False),
    "pressure not mixed": replace(DEFAULT_OPTIONS, mixed_pressure=False),
    "every tangent new": replace(DEFAULT_OPTIONS, keep_tangent=False),
    "load steps half as long": short_steps(DEFAULT_OPTIONS, 2),
}
FULL_SOLVERS = {"nothing condensed": replace(DEFAULT_OPTIONS, condense=False), "plain": plain()}


@dataclass(frozen=True)
class Variant:
    """A choice: changes to the scene, and options of the solver."""

    axis: str
    name: str
    sets: tuple[str, ...] = ()
    options: SolverOptions = DEFAULT_OPTIONS


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
    return found


def _tolerances(times: float) -> SolverOptions:
    """Options with the usual tolerances multiplied by `times`."""
    step, residual, most = DEFAULT_OPTIONS.step_tol, DEFAULT_OPTIONS.residual_tol, DEFAULT_OPTIONS.residual_max
    return replace(
        DEFAULT_OPTIONS, step_tol=times * step, residual_tol=times * residual, residual_max=max(times, 1.0) * most
    )


def bench(level: Level, say: Say) -> Result:
    """The sweep on the Mini, and the presets on every sensor."""
    answer((*sliding("gelsight_mini"), "quality={edge_mm: 1.5}"))  # compiles
    if level == "smoke":
        return Result(ABOUT, *_sweep(level, {}, say))
    with cores() as every:  # runs that are not timed may share the machine
        list(every(kept, [_preset(sensor, "reference") for sensor in DEPTHS]))
    say("references are there")
    presets = {(sensor, name): answer(_preset(sensor, name)) for sensor in DEPTHS for name in PRESETS}
    tables, plots = _sweep(level, presets, say)
    return Result(ABOUT, [*tables, _sensors(presets, say)], plots)


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
