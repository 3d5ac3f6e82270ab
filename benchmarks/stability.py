"""Extreme scenes: no inverted element, no tunnelling, no wrong frame."""

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import step_size_error
from benchmarks.cases import CASES, PLAIN, RANDOM, random
from benchmarks.reference_runs import row_of, solve_frames
from benchmarks.results_page import Cell, Level, Result, Say, Table, columns, cores
from tacgen import mechanics
from tacgen.base.errors import UserError
from tacgen.fem.elements import HEX_CORNERS
from tacgen.geometry.pose import Pose
from tacgen.mechanics import mesh
from tacgen.recipe import scene_of_row

Array = np.ndarray
ABOUT = (
    "Extreme scenes, by name and at random: each converges, is refused before the solve, or is rejected with"
    " a reason; no frame may be wrong. Over a scene's frames: most iterations and substeps, least certified"
    " J, least gap, largest penetration between contact points (overlap), and the largest balance or"
    " residual."
)
HEADS = {
    "case": "", "status": "", "frames": "d", "force [N]": ".4g", "iterations": "d", "substeps": "d", "least J": ".3f",
    "gap [mm]": ".4f", "overlap [edges]": ".2f", "balance": ".0e", "s": ".1f", "why": "",
}  # fmt: skip
SMOKE_CASES = ("1 kPa",)  # for a smoke test


@dataclass(frozen=True)
class Outcome:
    """The outcome of a scene: `status` is ok, refused (before the solve) or rejected (during it), with a `reason`.

    Over its frames: most iterations and substeps of one frame; certified lower bound of J; smallest gap [mm]; largest
    force balance and residual; overlap: largest penetration between contact points, in element edges.
    """

    name: str
    status: str
    reason: str = ""
    frames: int = 0
    force: float = 0.0  # largest [N]
    iterations: int = 0
    substeps: int = 0
    least_J: float = np.inf
    min_gap: float = np.inf
    balance: float = 0.0
    residual: float = 0.0
    overlap: float = 0.0
    seconds: float = 0.0

    @property
    def sound(self) -> bool:
        """Whether all solved frames are valid."""
        return self.balance < 1e-3 and self.residual < 1e-3 and self.least_J > 0 and self.min_gap > 0

    def cells(self) -> list[Cell]:
        """A row of the table."""
        if self.status == "refused" or not self.frames:
            return [self.name, self.status, *[None] * 8, self.seconds, self.reason]
        numbers = (self.frames, self.force, self.iterations, self.substeps, self.least_J, self.min_gap, self.overlap)
        return [self.name, self.status, *numbers, max(self.balance, self.residual), self.seconds, self.reason]


def measure(name: str, sets: Sequence[str]) -> Outcome:
    """Solve the plain scene with these changes and check every frame."""
    started = time.process_time()
    try:
        with tempfile.TemporaryDirectory() as folder:
            if any("{folder}" in text for text in sets):
                _write_meshes(Path(folder))
            filled = [text.replace("{folder}", folder) for text in (*PLAIN, *sets)]
            made = scene_of_row.build(row_of(tuple(filled)))
        problem = mechanics.Problem.of(made, mesh.of(made))
    except UserError as error:
        return Outcome(name, "refused", error.lines[0], seconds=time.process_time() - started)
    solved = solve_frames(made, problem)
    states = solved.states
    if not states:
        return Outcome(name, solved.status, solved.reason, seconds=time.process_time() - started)
    return Outcome(
        name,
        solved.status,
        solved.reason,
        len(states),
        float(np.linalg.norm(solved.forces, axis=1).max()),
        max(s.iterations for s in states),
        max(s.substeps for s in states),
        min(s.least_J for s in states),
        min(s.min_gap for s in states),
        max((s.balance for s in states if not s.damped), default=0.0),
        max((s.residual for s in states if not s.damped), default=0.0),
        max(overlap(problem, s) for s in states) / problem.edge,
        time.process_time() - started,
    )


def _write_meshes(folder: Path) -> None:
    """Write the mesh files of CASES: a ball of triangles forty times longer than wide; an upright plate."""
    from trimesh import creation

    creation.uv_sphere(4.0, count=(25, 1000)).export(folder / "slivers.obj")
    creation.box((0.4, 8.0, 4.0)).export(folder / "blade.obj")


def overlap(problem: mechanics.Problem, state: mechanics.State, fine: int = 5) -> float:
    """Largest penetration of the gel into the shrunk indenter [mm], at fine^3 points of each hex around it.

    Contact acts at points of the face; thin features could pass between them unnoticed.
    """
    x = state.x[problem.mesh.cells]
    size = np.linalg.norm(np.ptp(x, axis=1), axis=1)
    pose, shape = Pose.of(state.pose), problem.contact.shape
    x = x[shape.distance(pose.local(x.mean(1)))[0] < size]
    if not len(x):
        return 0.0
    t = np.linspace(-1, 1, fine)
    at = np.stack(np.meshgrid(t, t, t), -1).reshape(-1, 1, 3)
    N = (1 + at * HEX_CORNERS).prod(2) / 8
    inside = shape.distance(pose.local((N @ x).reshape(-1, 3)))[0] + state.offset
    return float(max(-inside.min(), 0.0))


def bench(level: Level, say: Say) -> Result:
    """The cases, and rounds of random scenes; after the first round half of them are near the hardest ones so far."""
    rounds = {"smoke": [1], "normal": [8], "full": [100] * 4}[level]
    named = {name: CASES[name] for name in SMOKE_CASES} if level == "smoke" else CASES
    rng, points = np.random.default_rng(7), list[Array]()
    known, chance = list[Outcome](), list[Outcome]()
    with cores(level) as every:
        for count in rounds:
            points += _drawn(count, rng, points, chance)
            scenes = [(f"random {i}", random(points[i].tolist())) for i in range(len(chance), len(points))]
            found = list[Outcome]()
            some = scenes if known else [*scenes, *named.items()]  # random scenes first, which may take longest
            for one in every(measure, *zip(*some, strict=True)):
                found.append(one)
                say(f"{one.name}: {one.status}, {one.iterations} iterations, {one.seconds:.1f} s {one.reason}")
            chance, known = chance + found[:count], known + found[count:]
    rows = [one.cells() for one in known]
    everyone = known + chance
    tables = [_summary(known, chance), Table("Cases", HEADS, rows), _worst(chance)]
    wrong = [one.name for one in everyone if not one.sound]
    about = ABOUT + (f" **Wrong frames in: {', '.join(wrong)}.**" if wrong else "")
    return Result(about, [*tables, step_size_error.table(level, say)])


def _drawn(count: int, rng: np.random.Generator, points: list[Array], found: list[Outcome]) -> list[Array]:
    """The numbers of `count` further random scenes; every other one near the hardest found so far."""
    hardest = sorted(range(len(found)), key=lambda i: -_hardness(found[i]))[: max(1, len(found) // 5)]
    drawn = []
    for i in range(count):
        if found and i % 2:
            near = points[hardest[int(rng.integers(len(hardest)))]] + rng.normal(0, 0.1, RANDOM)
            drawn.append(1 - np.abs(1 - np.abs(near) % 2))  # mirrored at 0 and 1
        else:
            drawn.append(rng.random(RANDOM))
    return drawn


def _hardness(one: Outcome) -> float:
    return np.inf if not one.sound or one.status == "rejected" else one.iterations / max(one.least_J, 0.01)


def _summary(known: list[Outcome], chance: list[Outcome]) -> Table:
    rows: list[list[Cell]] = []
    for name, group in (("cases", known), ("random scenes", chance)):
        solved = [one for one in group if one.frames]
        count = [sum(one.status == status for one in group) for status in ("ok", "refused", "rejected")]
        wrong = sum(not one.sound for one in group)
        most = max(one.iterations for one in solved), float(np.median([one.iterations for one in solved]))
        least = min(one.least_J for one in solved), min(one.min_gap for one in solved)
        worst = max(max(one.balance, one.residual) for one in solved)
        deepest = max(one.overlap for one in solved)
        rows.append([name, len(group), *count, wrong, *most, *least, worst, deepest])
    heads = columns("what", "scenes: d", "ok: d", "refused: d", "rejected: d", "wrong: d", "most iterations: d")
    heads |= columns("median: .0f", "least J: .3f", "least gap [mm]: .1e", "worst balance: .0e")
    heads |= columns("overlap [edges]: .2f")
    note = (
        "Wrong: an accepted frame with an inverted element, a gap below 0, or a balance or residual above 1e-3,"
        " but in a fold. Overlap does not count: features sharper than the mesh penetrate between contact points."
    )
    return Table("Together", heads, rows, note)


def _worst(chance: list[Outcome], count: int = 8) -> Table:
    hardest = sorted(chance, key=_hardness, reverse=True)[:count]
    note = (
        "Ball, capsule, torus, punch, box, cone or wedge of 1.4 to 4 mm, pressed 0.2 to 1.5 mm, slid, twisted, tilted"
        " and released; friction 0 to 2, 1 kPa to 100 MPa, nu 0 to 0.4999, half of them with a skin that is up to a"
        " hundred times softer or stiffer."
    )
    return Table("The hardest random scenes", HEADS, [one.cells() for one in hardest], note)
