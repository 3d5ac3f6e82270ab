"""Objects with sharp edges and tips: the error of their forces, and what is told of it."""

import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.reference_runs import row_of, solve_frames
from benchmarks.results_page import Cell, Level, Result, Say, Table, columns, cores
from tacgen import mechanics
from tacgen.base.errors import UserError
from tacgen.mechanics import mesh
from tacgen.mechanics.expected_error import ERROR_ESTIMATE_FACTOR, Expected
from tacgen.recipe import scene_of_row

if TYPE_CHECKING:
    import trimesh

Array = np.ndarray
QUALITIES = {"draft": "draft", "default": "default", "half": "{edge_mm: 0.18, dhat_mm: 0.02}"}
TIP = 0.05  # radius of the analytic wedge and cone [mm]
LIMIT_S = {"smoke": 60.0, "normal": 600.0, "full": 3000.0}  # longest solve [s]
ABOUT = (
    "Closed meshes with sharp edges and tips, pressed into a GelSight Mini with friction 0.6: the force at"
    " `draft` and `default` against edges of 0.18 mm, and the expected error that is told. `analytic` is the"
    " same wedge or cone with a tip of 0.05 mm. Refused: the expected error is above 50 %."
)
HEADS = columns(
    "case", "depth [mm]: .2f", "quality", "force [N]: .4f", "error: +.1%", "expected: .1%", "within its factor",
    "iterations: d", "s a frame: .2f", "analytic [N]: .4f",
)  # fmt: skip


def hull(points: Array) -> "trimesh.Trimesh":
    """The convex hull of points (n, 3)."""
    import trimesh

    made: trimesh.Trimesh = trimesh.convex.convex_hull(points)
    return made


def wedge(half_angle_deg: float, length: float = 8.0, height: float = 6.0) -> "trimesh.Trimesh":
    """A wedge whose sharp edge lies along y."""
    aside = height * math.tan(math.radians(half_angle_deg))
    return hull(
        np.array([(x, y, z) for y in (-length / 2, length / 2) for x, z in ((0, 0), (aside, height), (-aside, height))])
    )


def block(size: tuple[float, float, float], lowest: tuple[float, float, float]) -> "trimesh.Trimesh":
    """A block that stands on the edge or corner which lies toward `lowest`."""
    import trimesh

    corners = trimesh.creation.box(size).vertices
    down = np.array(lowest) / np.linalg.norm(lowest)
    across = np.linalg.svd(down[None])[2][1:]
    return hull(corners @ np.vstack([across, -down]).T)


def created(kind: str, **sizes: float) -> "trimesh.Trimesh":
    """A mesh of trimesh.creation."""
    import trimesh

    made: trimesh.Trimesh = getattr(trimesh.creation, kind)(**sizes)
    return made


def turned(made: "trimesh.Trimesh", angle: float) -> "trimesh.Trimesh":
    """A body turned by an angle [rad] about y."""
    made.vertices = Rotation.from_rotvec([0, angle, 0]).apply(made.vertices)
    return made


def cone(half_angle_deg: float, height: float = 8.0) -> "trimesh.Trimesh":
    """A cone with a sharp tip, which points down."""
    radius = height * math.tan(math.radians(half_angle_deg))
    return turned(created("cone", radius=radius, height=height, sections=64), math.pi)


def nut() -> "trimesh.Trimesh":
    """An M6 nut: 10 mm across its flats, 5 mm high, with a bore of 5 mm."""
    made = created("annulus", r_min=2.5, r_max=5.0, height=5.0, sections=48)
    angle = np.arctan2(*made.vertices.T[1::-1])
    reach = 1 / np.cos((angle + np.pi / 6) % (np.pi / 3) - np.pi / 6)  # of the hexagon over its inner circle
    made.vertices[:, :2] *= np.where(np.hypot(*made.vertices.T[:2]) > 4.0, reach, 1.0)[:, None]
    return made


def allen_key() -> "trimesh.Trimesh":
    """The long arm of a 3 mm Allen key, lying on an edge."""
    return turned(created("cylinder", radius=1.5, height=16.0, sections=6), math.pi / 2)


@dataclass(frozen=True)
class Case:
    """A mesh, or the name of a shipped object, pressed by `depth` [mm]; `analytic`: the same shape with a round tip;
    long: half the edge takes a quarter of an hour, which level full alone spends."""

    name: str
    depth: float
    made: "Callable[[], trimesh.Trimesh] | str"
    analytic: str = ""
    long: bool = False


def _tip(shape: str, half_angle: float, more: str = "") -> str:
    return f"{{shape: {shape}, half_angle_deg: {half_angle}, tip_radius_mm: {TIP}{more}}}"


CASES = (
    Case("wedge 15 deg", 0.6, lambda: wedge(15), _tip("wedge", 15, ", length_mm: 8")),
    Case("wedge 30 deg", 0.6, lambda: wedge(30), _tip("wedge", 30, ", length_mm: 8")),
    Case("cone 11.3 deg", 1.5, lambda: cone(11.3), _tip("cone", 11.3)),
    Case("cone 11.3 deg", 0.6, lambda: cone(11.3), _tip("cone", 11.3)),
    Case("cone 30 deg", 1.0, lambda: cone(30), _tip("cone", 30)),
    Case("block on its edge", 0.6, lambda: block((6, 4, 3), (1, 0, 1))),
    Case("block on its corner", 0.6, lambda: block((4, 4, 4), (1, 1, 1))),
    Case("block on its corner", 1.0, lambda: block((4, 4, 4), (1, 1, 1))),
    Case("tube, wall of .2 mm", 0.5, lambda: created("annulus", r_min=2.8, r_max=3.0, height=5, sections=96)),
    Case("plate of .12 mm on its edge", 0.5, lambda: block((6, 0.12, 5), (0, 0, -1))),
    Case("torus of triangles", 0.5, lambda: created("torus", major_radius=3, minor_radius=1)),
    Case("nut", 0.4, nut, long=True),
    Case("Allen key", 0.5, allen_key),
    *(Case(name, 0.4, name, long=name in ("key", "gear")) for name in ("key", "letters", "gear", "hex_bolt", "ring")),
)


@dataclass(frozen=True)
class Found:
    """A solved scene: force on the gel [N], nan if it is not; expected error [-]; Newton iterations; processor
    seconds a frame; why it is refused or rejected."""

    force: float = math.nan
    expected: float = math.nan
    iterations: int = 0
    seconds: float = 0.0
    reason: str = ""


def solved(indenter: str, depth: float, quality: str, level: Level) -> Found:
    """A press by `depth` [mm] in two frames."""
    sets = (
        "outputs=[force]", f"indenter={indenter}", f"trajectory=[{{press: {{depth_mm: {depth}, frames: 2}}}}]",
        f"quality={quality}",
    )  # fmt: skip
    error = math.nan
    try:
        scene = scene_of_row.build(row_of(sets))
        if expected := Expected.of(scene):
            error = expected.error
            expected.refuse()
        start = time.process_time()
        run = solve_frames(scene, mechanics.Problem.of(scene, mesh.of(scene)), LIMIT_S[level])
    except UserError as refused:
        return Found(expected=error, reason=f"refused: {refused.lines[0]}")
    if len(run.states) < 2:
        return Found(expected=error, reason=run.status)
    steps = sum(state.iterations for state in run.states)
    return Found(float(-run.forces[-1, 2]), error, steps, (time.process_time() - start) / 2)


def measure(case: Case, quality: str, analytic: bool, level: Level) -> Found:
    """A case at one of QUALITIES, or its analytic twin."""
    press = case.depth, QUALITIES[quality], level
    if analytic:
        return solved(case.analytic, *press) if case.analytic else Found()
    if isinstance(case.made, str):
        return solved(f"{{shape: mesh, file: {case.made}}}", *press)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sharp.stl"
        case.made().export(path)
        return solved(f"{{shape: mesh, file: {path}}}", *press)


def rows(case: Case, found: dict[str, Found], analytic: float) -> list[list[Cell]]:
    """The rows of a case, by quality."""
    reference = found["half"].force
    out: list[list[Cell]] = []
    for quality, one in found.items():
        error = one.force / reference - 1
        within = one.reason[:60] or ("yes" if abs(error) < ERROR_ESTIMATE_FACTOR * one.expected else "no") * (
            quality != "half"
        )
        work = one.iterations, one.seconds
        out.append([case.name, case.depth, quality, one.force, error, one.expected, within, *work, analytic])
    return out


def bench(level: Level, say: Say) -> Result:
    """The sharp table."""
    numbers = [k for k, case in enumerate(CASES) if level == "full" or not case.long][: 2 if level == "smoke" else None]
    kinds = [*((quality, False) for quality in QUALITIES), ("half", True)]
    table: list[list[Cell]] = []
    with cores(level) as every:
        answers = every(_one, [(k, *kind, level) for k in numbers for kind in kinds])
        for case in (CASES[k] for k in numbers):
            of = {kind: next(answers) for kind in kinds}
            table += rows(case, {quality: of[quality, False] for quality in QUALITIES}, of["half", True].force)
            say(f"{case.name}: " + ", ".join(f"{row[2]} {row[4]:+.1%} ({row[5]:.1%})" for row in table[-3:]))
    return Result(ABOUT, [Table("Sharp edges and tips", HEADS, table)])


def _one(asked: tuple[int, str, bool, Level]) -> Found:
    number, quality, analytic, level = asked
    return measure(CASES[number], quality, analytic, level)
