"""Ordinary scenes, drawn at random as for a data set: how many are solved, the time and the force error of a frame."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from benchmarks import half_edge
from benchmarks.draws import BALL, OBJECTS, Draw, drawn
from benchmarks.reference_runs import row_of, solve_frames
from benchmarks.results_page import Cell, Level, Result, Say, Table, columns, cores
from benchmarks.step_size_error import FINER, finer
from tacgen import mechanics
from tacgen.base.errors import UserError
from tacgen.mechanics import SolverOptions, mesh, presolve
from tacgen.mechanics.scene import Scene
from tacgen.recipe import scene_of_row

Array = np.ndarray
LIMIT_S = 150.0  # longest processor time of a scene [s]
COMPARED = 6  # every sixth draft scene is also solved in short frames
SCENES = {"smoke": 2, "normal": 30, "full": 150}  # at draft
DEFAULT_SCENES = 60  # at quality `default`, at level full
ABLATIONS: dict[str, dict[str, bool]] = {  # name: options that are switched off
    "nothing": {},
    "kept tangents": {"keep_tangent": False},
    "predictor": {"predict": False},
    "mixed pressure": {"mixed_pressure": False},
}
ABLATED_SCENES = {"smoke": 0, "normal": 4, "full": 8}  # solved with each of ABLATIONS
HALVED_SCENES = {"smoke": 0, "normal": 4, "full": 40}  # also solved on a mesh of half the edge
SMOKE = "{edge_mm: 1.2, dhat_mm: 0.08}"  # the quality of a smoke test
STATUSES = ("ok", "refused", "rejected", "out of time", "crashed")
MEASURES = {"rate": ("s a frame", ".2f"), "iterations": ("iterations", ".1f"), "factored": ("factorisations", ".1f")}
QUANTILES = (50, 90, 99)  # [%]
ABOUT = (
    "Scenes as in a data set: three sensors, seven shapes and the five shipped objects, pressed by 0.1 to"
    " 0.35 of the gel's thickness, slid, twisted, tilted and partly released, friction 0.2 to 1. Processor"
    " seconds of the solve alone, a scene a core. Refused: before it is solved; rejected: a frame did not"
    f" converge; out of time: {LIMIT_S:.0f} s had passed before the last frame; crashed: a bug. The mean of"
    " seconds a frame is what a data set costs."
)


@dataclass(frozen=True)
class Outcome:
    """The outcome of a scene: `status` is one of STATUSES, with a `reason`; the rest is of the solved frames.

    seconds: processor seconds of all frames; iterations, factored: Newton iterations and factorisations, means over the
    frames; least_J: certified lower bound of the Jacobian in all elements and frames; stable: frames before the first
    in a fold; unique: frames whose forces are; error: of the force against short frames, in the worst frame, over the
    largest force, None if not measured; stable_error: the same in the stable frames.
    """

    draw: Draw
    quality: str
    status: str
    reason: str = ""
    frames: int = 0
    seconds: float = 0.0
    iterations: float = 0.0
    factored: float = 0.0
    least_J: float = math.inf
    stable: int = 0
    unique: int = 0
    error: float | None = None
    stable_error: float | None = None

    @property
    def rate(self) -> float:
        """Processor seconds a frame."""
        return self.seconds / max(1, self.frames)


def measure(
    draw: Draw, quality: str, compared: bool, limit: float = LIMIT_S, options: SolverOptions = mechanics.DEFAULT_OPTIONS
) -> Outcome:
    """Solve a scene in at most `limit` processor seconds; if `compared` and ok, also in short frames."""
    try:
        made = _scene((f"sensor={draw.sensor}", *draw.sets, f"quality={quality}"))
        grid = mesh.of(made)
        problem = mechanics.Problem.of(made, grid, options)
    except UserError as error:
        return Outcome(draw, quality, "refused", error.lines[0])
    solved = solve_frames(made, problem, limit)
    states, status, n = solved.states, solved.status, len(solved.states)
    if not n:
        return Outcome(draw, quality, status, solved.reason)
    stable = next((k for k, state in enumerate(states) if state.damped), n)
    off: list[float | None] = [None, None]
    if compared and status == "ok":
        short = finer(made, FINER)
        between = solve_frames(short, mechanics.Problem.of(short, grid), limit).forces
        off = [_force_error(solved.forces[:count], between) for count in (n, stable)]
    return Outcome(
        draw,
        quality,
        status,
        solved.reason,
        n,
        solved.seconds,
        sum(state.iterations for state in states) / n,
        problem.factored / n,
        min(state.least_J for state in states),
        stable,
        sum(state.unique for state in states),
        *off,
    )


def _scene(sets: Sequence[str]) -> Scene:
    return presolve.presolved(scene_of_row.build(row_of(("outputs=[force]", *sets))))


def _force_error(long: Array, short: Array) -> float | None:
    """Largest difference of forces (n, 3) from those of short frames (m, 3) in frames that both reached, over the
    largest force; None if there are none."""
    ends = short[FINER - 1 :: FINER][: len(long)]
    off = np.linalg.norm(long[: len(ends)] - ends, axis=1)
    return float(off.max() / np.linalg.norm(short, axis=1).max()) if len(off) else None


@cache
def _warm() -> None:
    """Load compiled code, once in each process, before anything is timed."""
    moves = "trajectory=[{press: {depth_mm: 0.5, frames: 1}}, {slide: {x_mm: 0.2, frames: 1}}]"
    made = _scene(("sensor=ninedtact", "indenter={shape: mesh, file: ring}", moves, f"quality={SMOKE}"))
    solve_frames(made, mechanics.Problem.of(made, mesh.of(made)))


def _job(job: tuple[Draw, str, bool, SolverOptions]) -> Outcome:
    try:
        _warm()
        draw, quality, compared, options = job
        return measure(draw, quality, compared, options=options)
    except Exception as error:  # a bug in one scene must not lose the figures of the others
        return Outcome(job[0], job[1], "crashed", f"{type(error).__name__}: {error}")


def bench(level: Level, say: Say) -> Result:
    """The ball, ordinary scenes at draft and, at level full, some at default."""
    draws = [drawn(i) for i in range(SCENES[level])]
    quality = SMOKE if level == "smoke" else "draft"
    jobs = [
        (BALL, quality, True, mechanics.DEFAULT_OPTIONS),
        *((draw, quality, i % COMPARED == 0, mechanics.DEFAULT_OPTIONS) for i, draw in enumerate(draws)),
    ]
    jobs += [(draw, "default", False, mechanics.DEFAULT_OPTIONS) for draw in draws[:DEFAULT_SCENES] if level == "full"]
    whole, few = len(jobs), draws[: ABLATED_SCENES[level]]
    jobs += [
        (draw, quality, False, replace(mechanics.DEFAULT_OPTIONS, **off)) for off in ABLATIONS.values() for draw in few
    ]
    found = list[Outcome]()
    with cores(level) as every:
        for one in every(_job, jobs):
            found.append(one)
            name = "ball" if one.draw.index is None else f"{one.draw.index}"
            what = f"{one.quality} {one.draw.sensor} {one.draw.shape}: {one.status}"
            say(f"{name} {what}, {one.rate:.2f} s a frame {one.reason}")
        halved = list(every(half_edge.compared, draws[: HALVED_SCENES[level]]))
    ball, rough, fine = found[:1], found[1 : len(draws) + 1], found[len(draws) + 1 : whole]
    groups = [(name, some) for every in (rough, fine) for name, some in _kinds(every) if some]
    together = [_summary(name, some) for name, some in [*groups, ("ball", ball)]]
    heads = columns("scenes of", "quality", "scenes: d", *(f"{status}: d" for status in STATUSES))
    heads |= columns("s a frame, mean: .3f", "core-hours a million: .0f")
    heads |= columns("stable frames: .0%", "unique frames: .0%")
    heads |= columns(*(f"{head}, p{q}: {form}" for head, form in MEASURES.values() for q in QUANTILES))
    heads |= columns("least J: .3f", "J <= 0: d", "compared: d", "force error, worst: .2%", "force error, median: .2%")
    heads |= columns("force error in stable frames, worst: .2%")
    note = (
        "Least J: certified lower bound of the Jacobian, 1 at rest, over all elements and frames; J <= 0: scenes with"
        f" an inverted element. Force error: against the same path with {FINER} frames for each, in the worst frame"
        " that both reached, over the largest force; worst and median of the compared scenes. Stable frames: those"
        " before the first in which a Newton step needed damping, because the gel folds, wrinkles or slips suddenly"
        " (`/frames/quality/damped_steps`); from there on forces may depend on the step size. Ball: of 4 mm on the"
        " Mini, pressed 1 mm in 3 frames and slid 1.5 mm in 5 with friction 0.6."
    )
    tables = [
        Table("Together", heads, together, note),
        _groups("By shape", "shape", rough, lambda one: one.draw.shape),
        _groups("By sensor", "sensor", rough, lambda one: one.draw.sensor),
        _failed(found[:whole]),
    ]
    if few:
        tables[3:3] = [_ablated(found[whole:], len(few)), half_edge.table(halved)]
    return Result(ABOUT, tables)


def _quantile(group: Sequence[Outcome], name: str, percent: float) -> float | None:
    """Quantile over the scenes that are ok; None if there are none."""
    values = [getattr(one, name) for one in group if one.status == "ok"]
    return float(np.percentile(values, percent)) if values else None


def _kinds(group: Sequence[Outcome]) -> list[tuple[str, list[Outcome]]]:
    """All scenes, those of analytic shapes and those of objects."""
    objects = [one for one in group if one.draw.shape in OBJECTS]
    return [("ordinary", list(group)), ("shapes", [one for one in group if one not in objects]), ("objects", objects)]


def _mean(group: Sequence[Outcome]) -> float | None:
    """Seconds of all scenes that are ok over their frames; None if there are none."""
    ended = [one for one in group if one.status == "ok"]
    return sum(one.seconds for one in ended) / sum(one.frames for one in ended) if ended else None


def _summary(what: str, group: Sequence[Outcome]) -> list[Cell]:
    counts = [sum(one.status == status for one in group) for status in STATUSES]
    mean = _mean(group)
    hours = None if mean is None else mean * 1e6 / 3600
    work = [_quantile(group, name, q) for name in MEASURES for q in QUANTILES]
    least = [one.least_J for one in group if one.frames]
    folded = sum(not J > 0 for J in least)
    errors = [one.error for one in group if one.error is not None]
    off = [max(errors), float(np.median(errors))] if errors else [None, None]
    frames = sum(one.frames for one in group)
    stable, unique = (sum(getattr(one, what) for one in group) / max(1, frames) for what in ("stable", "unique"))
    before = max((one.stable_error for one in group if one.stable_error is not None), default=None)
    found = [min(least, default=None), folded, len(errors), *off, before]
    return [what, group[0].quality, len(group), *counts, mean, hours, stable, unique, *work, *found]


def _groups(title: str, head: str, found: Sequence[Outcome], of: Callable[[Outcome], str]) -> Table:
    rows: list[list[Cell]] = []
    for name in sorted({of(one) for one in found}):
        group = [one for one in found if of(one) == name]
        work = [_quantile(group, *which) for which in (("rate", 50), ("rate", 90), ("iterations", 50))]
        rows.append([name, len(group), sum(one.status == "ok" for one in group), _mean(group), *work])
    heads = columns(head, "scenes: d", "ok: d", "s a frame, mean: .3f", "s a frame, p50: .2f", "s a frame, p90: .2f")
    return Table(title, heads | columns("iterations, p50: .1f"), rows)


def _ablated(found: Sequence[Outcome], count: int) -> Table:
    """Time of the same scenes with one acceleration switched off, relative to all switched on."""
    groups = [found[i : i + count] for i in range(0, len(found), count)]
    rows: list[list[Cell]] = []
    for name, group in zip(ABLATIONS, groups, strict=True):
        both = [(b.seconds / a.seconds) for a, b in zip(groups[0], group, strict=True) if a.status == b.status == "ok"]
        ended = sum(one.status == "ok" for one in group)
        times = [float(np.percentile(both, q)) for q in (50, 90)] if both else [None, None]
        work = [_quantile(group, what, 50) for what in ("iterations", "factored")]
        rows.append([name, count, ended, *times, *work])
    heads = columns("without", "scenes: d", "ok: d", "time, p50: .2f", "time, p90: .2f", "iterations, p50: .1f")
    note = "Time of a scene without it, over that of the same scene with all accelerations."
    return Table("What each acceleration saves", heads | columns("factorisations, p50: .1f"), rows, note)


def _failed(found: Sequence[Outcome]) -> Table:
    """The scenes that are not ok, or in which an element may be inverted."""
    rows: list[list[Cell]] = []
    for one in found:
        reason = one.reason or f"least certified J {one.least_J:.3f}"
        if one.status != "ok" or not one.least_J > 0:
            rows.append([one.draw.index, one.quality, one.draw.sensor, one.draw.shape, one.status, reason])
    note = "`benchmarks.draws.drawn(i)` gives the changes of scene i to the quickstart, as values of `--set`."
    return Table("What failed", columns("scene: d", "quality", "sensor", "shape", "status", "reason"), rows, note)
