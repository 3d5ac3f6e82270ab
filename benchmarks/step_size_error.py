"""Error of long frames, against the same path with four frames for each: friction depends on the path."""

from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from benchmarks.cases import CASES, PLAIN, RANDOM, Sets, random
from benchmarks.reference_runs import row_of, solve_frames
from benchmarks.results_page import Cell, Level, Say, Table, columns, cores
from tacgen import mechanics
from tacgen.geometry.pose import along, shortest_turn
from tacgen.mechanics import mesh
from tacgen.mechanics.scene import Scene
from tacgen.recipe import scene_of_row

Array = np.ndarray
FINER = 4  # frames of the compared path for each frame
CYLINDER = "indenter={shape: cylinder, radius_mm: 3, fillet_mm: 0.5}"
PRESS = "{press: {depth_mm: 0.6, frames: 3}}"
ROD, ROUGH = "indenter={shape: capsule, radius_mm: 1, length_mm: 2}", "contact.friction=1.1"
PATHS: dict[str, Sets] = {
    "ball pressed, slid": (),
    "cylinder pressed": (CYLINDER, f"trajectory=[{PRESS}]"),
    "cylinder slid": (CYLINDER, f"trajectory=[{PRESS}, {{slide: {{x_mm: 1, frames: 5}}}}]"),
    "cylinder twisted": (CYLINDER, f"trajectory=[{PRESS}, {{twist: {{angle_deg: 20, frames: 5}}}}]"),
    "rod slid by its width at once": (ROD, ROUGH, f"trajectory=[{PRESS}, {{slide: {{y_mm: 1, frames: 1}}}}]"),
    "rod twisted by 30 deg at once": (ROD, ROUGH, f"trajectory=[{PRESS}, {{twist: {{angle_deg: 30, frames: 1}}}}]"),
    "rod pressed, released": (ROD, ROUGH, f"trajectory=[{PRESS}, {{release: {{frames: 2}}}}]"),
}
RANDOM_PATHS = {f"random {i}": random(u.tolist()) for i, u in enumerate(np.random.default_rng(7).random((24, RANDOM)))}
WORST_CASES = ("box twisted by 45 deg a frame", "sharp wedge", "jump across the pad")
PATHS |= {name: CASES[name] for name in WORST_CASES}


def table(level: Level, say: Say) -> Table:
    """Difference of forces from those of the same path in shorter frames."""
    some: dict[str, Sets] = {"ball pressed, slid": ()}
    ways = {"smoke": some, "normal": PATHS, "full": PATHS | RANDOM_PATHS}[level]
    with cores(level) as every:
        return _table(list(ways), every(error, ways.values()), say)


def finer(made: Scene, times: int) -> Scene:
    """A scene whose path has `times` frames for each; every `times`-th is the same pose."""
    ways = list(pairwise([made.start, *made.poses]))
    turns = [shortest_turn(a, b) for a, b in ways] if made.turns is None else made.turns
    poses = [pose for (a, b), turn in zip(ways, turns, strict=True) for pose in along(a, b, turn, times)]
    shorter = np.repeat(turns, times, axis=0) / times
    return replace(made, poses=np.array(poses), segment=np.repeat(made.segment, times), turns=shorter)


def error(sets: Sets) -> tuple[Array, Array, float, float]:
    """Forces of the frames (n, 3), those of short frames at the same poses (m, 3), and processor seconds of both."""
    made = scene_of_row.build(row_of((*PLAIN, *sets)))
    both = (made, finer(made, FINER))
    long, short = (solve_frames(way, mechanics.Problem.of(way, mesh.of(way))) for way in both)
    return long.forces, short.forces[FINER - 1 :: FINER], long.seconds, short.seconds


def _table(names: list[str], found: Iterable[tuple[Array, Array, float, float]], say: Say) -> Table:
    rows: list[list[Cell]] = []
    for name, (long, short, one, other) in zip(names, found, strict=True):
        n = min(len(long), len(short))
        if not n:
            rows.append([name, 0, None, None, None, one, other])
            continue
        most = float(np.linalg.norm(short, axis=1).max())
        off = np.linalg.norm(long[:n] - short[:n], axis=1) / most
        rows.append([name, n, most, float(off.max()), float(off[-1]), one, other])
        say(f"{name}: {off.max():.2%} off shorter frames")
    heads = columns("way", "frames: d", "force [N]: .4g", "worst: .2%", "last: .2%", "s: .1f", "s, shorter: .1f")
    note = (
        f"Force of each frame against that of the same path with {FINER} frames for each, over the largest force:"
        " worst and last of the frames that both reached. At edge 0.8 mm."
    )
    return Table("Frames that are long", heads, rows, note)
