"""Ordinary scenes with two versions of tacgen, interleaved on the same machine: seconds a frame and forces.

    python -m scripts.ordinary_versions OLD [FIRST] [COUNT] [QUALITY]

OLD is a checkout of the other version, whose `benchmarks` have `ordinary.measure`; this checkout is the new one. Solves
draws FIRST, FIRST + 1... of benchmarks/draws.py, each by both, one scene on each core. Prints a line a scene, and at
the end the mean processor seconds a frame of the scenes that both solve, shapes and objects apart, and by how much the
last frame's force differs.
"""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.draws import OBJECTS, drawn
from benchmarks.results_page import one_thread

NEW = Path(__file__).parents[1]
ONE = """
import json, sys
from benchmarks import draws, ordinary
ordinary._warm()
one = ordinary.measure(draws.drawn(int(sys.argv[1])), sys.argv[2], False)
seconds = one.seconds if one.__class__.__dict__.get("rate") else one.seconds * one.frames  # once a mean over frames
print(json.dumps(dict(status=one.status, frames=one.frames, seconds=seconds, force=one.force, stable=one.stable)))
"""
Found = dict[str, Any]


def solved(checkout: Path, index: int, quality: str) -> Found:
    """Status, frames, processor seconds, last force [N] and frames before the first damped one, of a draw."""
    told = subprocess.run(
        [sys.executable, "-c", ONE, str(index), quality],
        cwd=checkout,
        env={**os.environ, **one_thread(), "PYTHONPATH": f"{checkout}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"},
        capture_output=True,
        text=True,
    )
    if told.returncode:
        return {"status": "crashed", "frames": 0, "seconds": 0.0, "force": 0.0, "stable": 0}
    found: Found = json.loads(told.stdout.splitlines()[-1])
    return found


def told(name: str, pairs: Sequence[tuple[Found, Found]]) -> None:
    """Prints the means of the scenes that both versions solve."""
    both = [(old, new) for old, new in pairs if old["status"] == new["status"] == "ok"]
    if not both:
        return
    old, new = (sum(pair[k]["seconds"] for pair in both) / sum(pair[k]["frames"] for pair in both) for k in (0, 1))
    calm = [pair for pair in both if all(one["stable"] == one["frames"] for one in pair)]
    off = [abs(new["force"] / old["force"] - 1) for old, new in calm if old["force"]]
    forces = (
        f"; forces of {len(off)} without folds differ by {np.median(off):.2%}, at most {max(off):.2%}" if off else ""
    )
    print(f"{name}: {len(both)} of {len(pairs)}, old {old:.3f}, new {new:.3f} s a frame, {old / new:.2f} times{forces}")


def main(old: Path, first: int, count: int, quality: str) -> None:
    draws = range(first, first + count)
    jobs = [(checkout, index, quality) for index in draws for checkout in (old, NEW)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        found = pool.map(lambda job: solved(*job), jobs)
        pairs = []
        for index, before, after in zip(draws, found, found, strict=False):
            pairs.append((before, after))
            each = [f"{one['status']} {one['seconds'] / max(1, one['frames']):.3f}" for one in (before, after)]
            print(f"{index} {drawn(index).shape}: old {each[0]}, new {each[1]}", flush=True)
    objects = [drawn(index).shape in OBJECTS for index in draws]
    told("all", pairs)
    told("shapes", [pair for pair, solid in zip(pairs, objects, strict=True) if not solid])
    told("objects", [pair for pair, solid in zip(pairs, objects, strict=True) if solid])


if __name__ == "__main__":
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    old, first, count, quality, *_ = [*sys.argv[1:], *["", "0", "60", "draft"][len(sys.argv) - 1 :]]
    main(Path(old).resolve(), int(first), int(count), quality)
