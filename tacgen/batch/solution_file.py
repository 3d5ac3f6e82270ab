"""Solutions of scenes as files, from the process that solves many at once to those that label and write them."""

import io
import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base import atomic_file
from tacgen.mechanics.solved_scene import SolvedScene
from tacgen.mechanics.state import State

UNSAVED_STATE_FIELDS = ("internal", "after", "passed")  # no label needs the history of a load step
STATE_FIELDS = [field.name for field in fields(State) if field.name not in UNSAVED_STATE_FIELDS]


def write(path: Path, solution: SolvedScene) -> None:
    """Write a solution, in whole or not at all. Without friction, what only friction has is left out."""
    found: dict[str, np.ndarray] = {}
    numbers: dict[str, list[float]] = {}  # in one text: each array of a file takes as long to read as 100 kB
    for name in STATE_FIELDS if solution.states else ():
        values = [getattr(state, name) for state in solution.states]
        if np.ndim(values[0]):
            found[name] = np.stack(values)
        elif values[0] is not None:
            numbers[name] = np.array(values).tolist()
    told = {"engine": solution.engine, "why": solution.why, "heights": [*solution.heights], "numbers": numbers}
    found["/told"] = np.array(json.dumps(told))
    written = io.BytesIO()
    np.savez(written, **found)  # type: ignore[arg-type]  # its stub takes any name for an option
    atomic_file.write(path, written.getvalue(), sync=False)  # a new run deletes what another one has left


def read(path: Path) -> SolvedScene | None:
    """A solution; None if there is no such file."""
    if not path.is_file():
        return None
    with np.load(path, allow_pickle=False) as found:
        told = json.loads(str(found["/told"]))
        arrays = {name: found[name] for name in STATE_FIELDS if name in found} | told["numbers"]
    known: dict[str, Any] = dict.fromkeys(STATE_FIELDS)
    frames = range(len(arrays.get("index", ())))
    states = [State(**known | {name: values[k] for name, values in arrays.items()}) for k in frames]
    return SolvedScene(told["engine"], states, told["why"], tuple(told["heights"]))
