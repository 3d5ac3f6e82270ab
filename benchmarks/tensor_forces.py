"""Forces of the batch engine beside those of the CPU engine, on ordinary scenes and the same meshes.

    python -m benchmarks.tensor_forces [--draws 0 16] [--edge 1.2] [--batch 64] [--seconds 300] [--device cuda]

Scenes of benchmarks/draws.py are solved in batches of one pattern, and each by the CPU engine. A line a scene: frames,
steps of the bulk by both, the largest difference of the force over the scene's largest one, in the frames before the
first damped step of either engine and in all, and what the batch engine could not do. Stops after so many seconds.
"""

import argparse
import sys
import time
from dataclasses import replace
from itertools import takewhile

import numpy as np
import torch

from benchmarks.draws import drawn
from benchmarks.reference_runs import row_of
from tacgen import mechanics
from tacgen.errors import UserError
from tacgen.mechanics import mesh
from tacgen.mechanics.scene import Scene
from tacgen.mechanics.state import State
from tacgen.recipe import scene_of_row
from tacgen.tensor_engine import pool
from tacgen.tensor_engine.engine import Solved

Array = np.ndarray


def main() -> None:
    told = arguments()
    end = time.perf_counter() + told.seconds
    device = told.device or ("cuda" if torch.cuda.is_available() else "cpu")
    torch.set_num_threads(told.threads)
    numbers = range(told.draws[0], sum(told.draws))
    scenes = {k: scene for k in numbers if (scene := scene_of(k, told.edge)) is not None}
    keys = list(scenes)
    for number, found in pool.solved(scenes.values(), device, dtype=told.dtype, slots=told.batch, share=False):
        say(compared(keys[number], scenes[keys[number]], found))
        if time.perf_counter() > end:
            say("out of time")
            return


def say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def arguments() -> argparse.Namespace:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--draws", type=int, nargs=2, default=(0, 16), metavar=("FIRST", "COUNT"))
    ask.add_argument("--edge", type=float, help="element edge [mm], with dhat a twelfth of it; else quality draft")
    ask.add_argument("--batch", type=int, default=64, help="most scenes at once")
    ask.add_argument("--seconds", type=float, default=300.0)
    ask.add_argument("--device")
    ask.add_argument("--dtype", type=lambda name: getattr(torch, name), default=torch.float32)
    ask.add_argument("--threads", type=int, default=1)
    return ask.parse_args()


def scene_of(number: int, edge: float | None) -> Scene | None:
    """The scene of a draw; None where it is refused."""
    draw, quality = drawn(number), "draft" if edge is None else f"{{edge_mm: {edge}, dhat_mm: {edge / 12:.4f}}}"
    sets = (f"sensor={draw.sensor}", *draw.sets, f"quality={quality}", "outputs=[force]")
    try:
        return scene_of_row.build(row_of(sets))
    except UserError as error:
        say(f"draw {number:3d}: refused: {error.lines[0]}")
        return None


def compared(number: int, scene: Scene, solved: Solved) -> str:
    """A line about a scene."""
    one: list[State] = []
    why, start = "", time.perf_counter()
    try:
        one += mechanics.states(replace(scene), mechanics.Problem.of(scene, mesh.of(scene)))
    except mechanics.NotConverged as error:
        why = f"; CPU engine: {error}"
    seconds = time.perf_counter() - start
    both = list(zip(solved.states, one, strict=False))
    forces = np.array([[state.traction_force.sum((0, 1)) for state in pair] for pair in both]).reshape(-1, 2, 3)
    off = np.linalg.norm(forces[:, 0] - forces[:, 1], axis=1)
    off = off / max(float(np.linalg.norm(forces[:, 1], axis=1).max(initial=0.0)), 1e-12)
    stable = len(list(takewhile(lambda pair: not (pair[0].damped or pair[1].damped), both)))
    steps = [sum(state.iterations for state in states) for states in (solved.states, one[: len(both)])]
    kind, first, all_ = type(scene.shape).__name__, off[:stable].max(initial=0.0), off.max(initial=0.0)
    told = "" if solved.why is None else f"; batch engine: {solved.why}"
    return (
        f"draw {number:3d} {kind:12s} {len(both):2d} of {len(scene.poses):2d} frames ({stable:2d} before damping),"
        f" steps {steps[0]:3d} {steps[1]:3d}, force off {first:.1e}, in all frames {all_:.1e},"
        f" CPU {seconds / max(1, len(both)):.2f} s a frame{told}{why}"
    )


if __name__ == "__main__":
    main()
