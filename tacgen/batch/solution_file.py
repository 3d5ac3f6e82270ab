"""Solutions of scenes as files, from the process that solves many at once to those that label and write them."""

import io
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from tacgen import atomic_file
from tacgen.mechanics.solved_scene import SolvedScene
from tacgen.mechanics.state import State

LEFT_OUT = ("internal", "after", "passed")  # no label needs the history of a load step
NAMES = [field.name for field in fields(State) if field.name not in LEFT_OUT]


def write(path: Path, solution: SolvedScene) -> None:
    """Write a solution, in whole or not at all. Without friction, what only friction has is left out."""
    found: dict[str, np.ndarray] = {"/engine": np.array(solution.engine), "/why": np.array(solution.why)}
    found["/heights"] = np.array(solution.heights)
    for name in NAMES if solution.states else ():
        values = [getattr(state, name) for state in solution.states]
        if values[0] is not None:
            found[name] = np.stack(values)
    written = io.BytesIO()
    np.savez(written, **found)  # type: ignore[arg-type]  # its stub takes any name for an option
    atomic_file.write(path, written.getvalue())


def read(path: Path) -> SolvedScene | None:
    """A solution; None if there is no such file."""
    if not path.is_file():
        return None
    with np.load(path, allow_pickle=False) as found:
        arrays = {name: found[name] for name in NAMES if name in found}
        frames = len(arrays["index"]) if arrays else 0
        states = [State(**{name: _at(arrays, name, k) for name in NAMES}) for k in range(frames)]
        return SolvedScene(str(found["/engine"]), states, str(found["/why"]), tuple(found["/heights"].tolist()))


def _at(arrays: dict[str, np.ndarray], name: str, frame: int) -> Any:
    """A field of a frame: an array, or a plain number; None if there is none."""
    if name not in arrays:
        return None
    value = arrays[name][frame]
    return value if value.ndim else value.item()
