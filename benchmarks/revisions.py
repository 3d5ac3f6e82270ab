"""Two revisions on the same ordinary scenes, in turns: forces, and seconds of a core.

    git worktree add /tmp/before REVISION
    python -m benchmarks.revisions /tmp/before 131000 20

Each scene is solved by both in processes of their own, so that they meet the same load of the machine. Forces are
compared in the frames before the first damped step: after a fold the last digit of a sum decides.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

Frames = tuple[str, list[list[float]], list[bool], float]
MAX_SECONDS = 120  # of wall time for a scene
# run in each revision: forces of the frames, whether they are unique, and processor seconds after the first one
SOLVE = """
import json, sys, time
from benchmarks import draws, ordinary
from tacgen import mechanics
from tacgen.mechanics import mesh
draw = draws.drawn(int(sys.argv[1]))
scene = ordinary._scene((f"sensor={draw.sensor}", *draw.sets, "quality=draft"))
forces, unique, times = [], [], []
try:
    for state in mechanics.states(scene, mechanics.Problem.of(scene, mesh.of(scene))):
        forces.append(state.traction_force.sum((0, 1)).tolist())
        unique.append(bool(state.unique))
        times.append(time.process_time())
except mechanics.NotConverged:
    pass
print(json.dumps([draw.shape, forces, unique, times[-1] - times[0] if times else 0.0]))
"""


def solved(folder: Path, draw: int) -> Frames:
    """A scene by the revision in a folder; no frames where it does not end in time."""
    env = {**os.environ, "PYTHONPATH": str(folder), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-c", SOLVE, str(draw)]
    try:
        told = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, timeout=MAX_SECONDS)
        shape, *rest = json.loads(told.stdout.splitlines()[-1])
    except (subprocess.TimeoutExpired, IndexError):
        return "", [], [], 0.0
    return (shape, *rest)


def compared(old: Frames, new: Frames) -> tuple[float, float, float]:
    """Largest difference of forces over the largest force, and both revisions' seconds; nan where frames lack."""
    count = min(len(old[1]), len(new[1]))
    alike = next((k for k in range(count) if not (old[2][k] and new[2][k])), count)
    a, b = (np.array(each[1][:alike]).reshape(-1, 3) for each in (old, new))
    off = float(np.abs(a - b).max() / np.abs(a).max()) if a.any() else np.nan
    return (off, old[3], new[3]) if len(old[1]) == len(new[1]) > 0 else (off, np.nan, np.nan)


if __name__ == "__main__":
    before, now, first, rows = Path(sys.argv[1]).resolve(), Path(__file__).parents[1], int(sys.argv[2]), []
    for draw in range(first, first + int(sys.argv[3])):
        both = [solved(folder, draw) for folder in (before, now)]
        rows.append(compared(*both))
        print(
            f"{draw} {both[1][0]}: forces {rows[-1][0]:.1e} apart; {rows[-1][1]:.2f} and {rows[-1][2]:.2f} s",
            flush=True,
        )
    off, old, new = np.array(rows).T
    part = np.nansum(new) / np.nansum(old) - 1
    print(f"median {np.nanmedian(off):.1e}, worst {np.nanmax(off):.1e}; {np.nansum(new):.1f} s of a core, {part:+.1%}")
