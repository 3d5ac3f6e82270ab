"""Scenes for the engines' tests: made in milliseconds through the real claim, writer and resume, and spoilt on demand.

A file `faults/scene-00003` in the folder spoils that scene: its words are `once`, `writing` (otherwise before anything
is written) and one of kill, exit, hang, eat, raise, refuse. Each scene that is made adds a line to `made.log`.
"""

import os
import signal
import time
from pathlib import Path
from typing import Any

from helpers.synthetic import write
from tacgen.base import atomic_file
from tacgen.base.errors import UserError
from tacgen.bundle import resume
from tacgen.recipe import plan
from tacgen.recipe.row import Row

TASK = "helpers.scenes:make"
RECIPE = """
tacgen: 1
name: many
sensor: gelsight_mini
indenter: {shape: sphere, radius_mm: 4.0}
trajectory: [{press: {depth_mm: 0.5, frames: 12}}]
outputs: [force]
vary: {method: random, samples: 8, over: {start.x_mm: {uniform: [-3, 3]}}}
"""


def make_plan(folder: Path, samples: int = 8, shard: tuple[int, int] = (0, 1), outputs: str = "[force]") -> plan.Plan:
    path = folder / "many.yaml"
    if not path.exists():  # other processes of the torture read it
        atomic_file.write(path, RECIPE.encode())
    return plan.load(path, [f"vary.samples={samples}", f"outputs={outputs}"], shard)


def spoil(folder: Path, scene: str, words: str) -> None:
    (folder / "faults").mkdir(parents=True, exist_ok=True)
    (folder / "faults" / scene).write_text(words)


def made(folder: Path) -> list[str]:
    """Names of the scenes made, in the order they were finished; one made twice is there twice."""
    log = folder / "made.log"
    return log.read_text().split() if log.exists() else []


def make(row: Row, folder: Path, *, overwrite: bool = False, on_event: Any = None) -> resume.SceneResult:
    """In the place of pipeline.run_scene."""
    with resume.claimed(row, folder, overwrite=overwrite) as found:
        return found if isinstance(found, resume.SceneResult) else _make(row, found, on_event)


def _make(row: Row, path: Path, on_event: Any) -> resume.SceneResult:
    fault = path.parent / "faults" / row.name
    words = fault.read_text().split() if fault.exists() else []
    if "writing" not in words:
        _suffer(words, fault)

    def edit(index: int, arrays: dict[str, Any]) -> None:
        arrays["/frames/force"] = arrays["/frames/force"] + row.values["start.x_mm"]
        if on_event:
            on_event({"event": "frame", "scene": row.name, "frame": index + 1, "frames": row.frames})
        if index == 5:
            _suffer(words, fault)

    known = {"input_key": row.key, "seed": row.seed, "scene_index": row.index, "values": row.values}
    known |= {"recipe": row.document(), "sensor_document": row.sensor_document()}
    write(path, outputs=frozenset({"force"}), edit=edit, **known)
    with (path.parent / "made.log").open("a") as log:
        log.write(f"{row.name}\n")
    return resume.SceneResult(row.name, path, "ok", "", row.frames, {"solve": 0.01, "pid": float(os.getpid())})


def _suffer(words: list[str], fault: Path) -> None:
    if "once" in words:
        fault.unlink()
    if "slow" in words:
        time.sleep(0.3)
    if "kill" in words:
        os.kill(os.getpid(), signal.SIGKILL)
    if "exit" in words:
        os._exit(7)
    if "hang" in words:
        time.sleep(600)
    if "eat" in words:
        hoard = bytearray(os.urandom(1024) * 1024 * 400)
        time.sleep(600 if hoard else 0)
    if "raise" in words:
        raise ZeroDivisionError("made to fail")
    if "refuse" in words:
        raise UserError("this cannot be made")


def endless(row: Row, folder: Path, *, overwrite: bool = False, on_event: Any = None) -> None:
    """A scene that never ends, with a frame every 50 ms."""
    frame = 0
    while True:
        frame += 1
        on_event({"event": "frame", "scene": row.name, "frame": frame, "frames": row.frames})
        time.sleep(0.05)


def noted(row: Row) -> None:
    """Before its first scene a worker leaves a file named after its process, which holds the row's name, and fails."""
    Path(os.environ["MADE_READY"], str(os.getpid())).write_text(row.name)
    raise RuntimeError("a scene would say why")
