"""A process killed at a seeded moment: what a second one makes is what an undisturbed one makes, and nothing more."""

import os
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from helpers.killing import calls
from helpers.scenes import make, make_plan

from hostile.attempts import Attempt, contained
from tacgen import export
from tacgen.base import array_cache, atomic_file
from tacgen.bundle import dataset, pack
from tacgen.bundle.journal import write_plan
from tacgen.recipe import plan_table


def _pack(source: Path, here: Path) -> None:
    if not (here / "out").exists():
        pack.pack(dataset.scenes(source / "loose"), here / "out", 0.04)


def _scene(source: Path, here: Path) -> None:
    make(make_plan(source, 3).rows[1], here)


def _cache(source: Path, here: Path) -> None:
    os.environ["TACGEN_CACHE_DIR"] = str(here)
    array_cache.kept("kind", "key", lambda: (np.arange(1000.0), np.ones(3)))


def _plan(source: Path, here: Path) -> None:
    atomic_file.sweep(here)  # as every run begins
    write_plan(plan_table.as_json(make_plan(source, 3)), here, None)


WORKS: dict[str, Callable[[Path, Path], Any]] = {
    "pack": _pack,
    "scene": _scene,
    "cache": _cache,
    "plan": _plan,
    "export vtkhdf": lambda source, here: export.export("vtkhdf", source / "loose", here / "out"),
    "export webdataset": lambda source, here: export.export("webdataset", source / "loose", here / "out"),
}
CLOCKED = "frames.h5"  # holds the time
LOG = "made.log"  # of the stand-in for a scene's work, not of tacgen


def work(seed: int) -> str:
    """Which of WORKS `kill` kills."""
    return Random(f"which {seed}").choice(sorted(WORKS))


def kill(seed: int, source: Path) -> Attempt:
    """Kill one of WORKS at one of its calls to the disk, run it again, and compare."""
    rng, name = Random(f"kill {seed}"), work(seed)
    with tempfile.TemporaryDirectory() as scratch:
        here, note = Path(scratch) / "here", Path(scratch) / "note"
        here.mkdir()
        moment = rng.randrange(1, count(name, source) + 1)
        assert calls(lambda: WORKS[name](source, here), moment) is None
        outcome = contained(lambda: (WORKS[name](source, here), "accepted")[1], note)
        said = f"{name} at call {moment}"
        if outcome != "accepted":
            return Attempt("kill", seed, said, outcome, note.read_text() if note.exists() else "")
        found, wanted = tree(here), whole(name, source)
        missing, more = sorted(wanted.keys() - found.keys()), sorted(found.keys() - wanted.keys())
        if missing:
            return Attempt("kill", seed, said, "lost", str(missing))
        return Attempt("kill", seed, said, "accepted" if found == wanted else "wrong", str(more))


def tree(folder: Path) -> dict[str, bytes]:
    """Content by path; a claim, which the next process at that place takes over, counts for nothing."""
    files = [path for path in folder.rglob("*") if path.is_file() and not path.name.endswith((".claim", LOG))]
    return {str(path.relative_to(folder)): b"" if path.name == CLOCKED else path.read_bytes() for path in files}


@cache
def whole(name: str, source: Path) -> dict[str, bytes]:
    """What an undisturbed run leaves."""
    with tempfile.TemporaryDirectory() as scratch:
        WORKS[name](source, Path(scratch))
        return tree(Path(scratch))


@cache
def count(name: str, source: Path) -> int:
    """Calls to the disk of an undisturbed run."""
    with tempfile.TemporaryDirectory() as scratch:
        here = Path(scratch) / "here"
        here.mkdir()
        return calls(lambda: WORKS[name](source, here)) or 0
