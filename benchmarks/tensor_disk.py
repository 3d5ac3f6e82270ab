"""Frames a second to disk with the batch engine, beside the cores alone.

    python -m benchmarks.tensor_disk [--scenes 1000] [--quality draft] [--outputs force rgb] [--workers 16] [--again]

`tacgen run` makes presses of balls on the Mini, ten frames each: a few first, so that code is compiled, then all by the
batch engine, and some by the CPU engine. Of each run are printed: frames, seconds until the first scene has ended and
in all, frames a second between the first and the last scene and in the best ten seconds, what they take of a core and
of the GPU's board. With --again the batch engine makes all a second time, and bundles are compared byte by byte.
"""

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks import gpu_board

WINDOW = 10  # [s] in which frames are counted
WARM = 20  # scenes made first
RECIPE = """\
tacgen: 1
name: balls
sensor: gelsight_mini
indenter: {shape: sphere, radius_mm: 4.0}
trajectory:
  - press: {depth_mm: 1.0, frames: 10}
contact: {friction: 0.6}
vary:
  samples: 20
  seed: 3
  over:
    indenter.radius_mm: {uniform: [2.5, 5.0]}
    start.x_mm: {uniform: [-3, 3]}
    start.y_mm: {uniform: [-3, 3]}
"""


class Ran(NamedTuple):
    """A run: scenes by their status, frames of those that are ok, the seconds at which scenes ended and how many frames
    they have, seconds in all, seconds of cores, and the GPU's board."""

    status: dict[str, int]
    ends: list[tuple[float, int]]
    seconds: float
    cores: float
    board: gpu_board.Board

    @property
    def frames(self) -> int:
        """Frames that were written."""
        return sum(frames for _, frames in self.ends)

    def __str__(self) -> str:
        first, last = self.ends[0][0], self.ends[-1][0]
        between = self.frames - self.ends[0][1]
        windows = [sum(n for at, n in self.ends if start <= at < start + WINDOW) for start, _ in self.ends]
        return (
            f"{self.frames} frames in {self.seconds:.1f} s ({', '.join(f'{n} {s}' for s, n in self.status.items())}):"
            f" {self.frames / self.seconds:.0f} a second; the first scene at {first:.1f} s, then"
            f" {between / max(last - first, 1e-9):.0f} a second, {max(windows) / WINDOW:.0f} in the best {WINDOW} s;"
            f" {1e3 * self.cores / self.frames:.1f} ms of a core a frame; {self.board}"
        )


def main() -> None:
    told = arguments()
    with tempfile.TemporaryDirectory(dir=told.folder) as place:
        folder = Path(place)
        sets = [f"quality={told.quality}", f"outputs=[{', '.join(told.outputs)}]"]
        for engine in told.engines:
            made(folder / "warm", engine, WARM, sets, told.workers)
            shutil.rmtree(folder / "warm")
            scenes = told.alone if engine == "local" else told.scenes
            ran = made(folder / engine, engine, scenes, sets, told.workers)
            print(f"{engine}, {told.workers} workers: {ran}", flush=True)
            print(f"  {size(folder / engine) / ran.frames / 1e3:.0f} kB a frame", flush=True)
            if told.again and engine != "local":
                again = made(folder / "again", engine, scenes, sets, told.workers)
                print(f"{engine}, again: {again}", flush=True)
                different = [*unlike(folder / engine, folder / "again")]
                print(f"  {len(different)} of {scenes} bundles differ", *different[:5], flush=True)
                shutil.rmtree(folder / "again")
            shutil.rmtree(folder / engine)


def arguments() -> argparse.Namespace:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--scenes", type=int, default=1000)
    ask.add_argument("--alone", type=int, default=160, help="scenes of the CPU engine")
    ask.add_argument("--quality", default="draft")
    ask.add_argument("--outputs", nargs="*", default=("force", "rgb"))
    ask.add_argument("--workers", type=int, default=os.cpu_count())
    ask.add_argument("--engines", nargs="*", default=("cuda", "local"))
    ask.add_argument("--again", action="store_true", help="a second run by the batch engine, for its bytes")
    ask.add_argument("--folder", help="where to write")
    return ask.parse_args()


def made(out: Path, engine: str, scenes: int, sets: Sequence[str], workers: int) -> Ran:
    """Make scenes into a folder. Raises RuntimeError: the command fails."""
    recipe = out.with_suffix(".yaml")
    recipe.write_text(RECIPE)
    more = [part for each in (*sets, f"vary.samples={scenes}") for part in ("--set", each)]
    call = [sys.executable, "-m", "tacgen", "run", str(recipe), "-o", str(out), *more, "--json"]
    status, ends, before, start = dict[str, int](), list[tuple[float, int]](), _children(), time.perf_counter()
    call += ["--engine", engine, "--workers", str(workers)]
    with gpu_board.watched() as board, out.with_suffix(".log").open("w+") as log:
        with subprocess.Popen(call, stdout=subprocess.PIPE, stderr=log, text=True) as run:
            assert run.stdout is not None
            for line in run.stdout:
                if '"scene"' in line and (event := json.loads(line))["event"] == "scene":
                    status[event["status"]] = status.get(event["status"], 0) + 1
                    ends.append((time.perf_counter() - start, event["frames"]))
        if run.returncode or not ends:
            log.seek(0)
            raise RuntimeError(f"{' '.join(call)}: {log.read().strip() or f'exit code {run.returncode}'}")
    return Ran(status, ends, time.perf_counter() - start, _children() - before, board)


def _children() -> float:
    """Processor seconds of processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def size(folder: Path) -> int:
    """Bytes of the bundles of a folder."""
    return sum(path.stat().st_size for path in folder.glob("*.h5"))


def unlike(folder: Path, other: Path) -> Iterator[str]:
    """Names of the bundles of a folder that another one has not byte by byte."""
    for path in sorted(folder.glob("*.h5")):
        if not (other / path.name).is_file() or path.read_bytes() != (other / path.name).read_bytes():
            yield path.name


if __name__ == "__main__":
    main()
