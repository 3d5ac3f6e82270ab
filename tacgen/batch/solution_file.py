"""Solutions of scenes as files, from the process that solves many at once to those that label and write them."""

import io
import json
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base import atomic_file
from tacgen.geometry.pose import Pose
from tacgen.mechanics.solved_scene import SolvedScene
from tacgen.mechanics.state import History, State

Array = np.ndarray
UNSAVED_STATE_FIELDS = ("internal", "after", "passed")  # of the histories only derivatives need some, see `write`
STATE_FIELDS = [field.name for field in fields(State) if field.name not in UNSAVED_STATE_FIELDS]
HISTORY_ARRAYS = ("x", "normal_force", "normal", "anchor", "gap")
HISTORY_NUMBERS = ("offset", "kappa", "least_force", "folded")
# with these, which are nan without a prediction, and a pose; of elastic gels without inertia
PACKED_ARRAYS = (*HISTORY_ARRAYS, "rotation", "position", "numbers", "predicted", "error", "motion")


def write(path: Path, solution: SolvedScene, *, histories: bool = False) -> None:
    """Write a solution, in whole or not at all. Without friction, what only friction has is left out.

    histories: with those of all load steps, for derivatives.
    """
    found: dict[str, Array] = {}
    numbers: dict[str, list[float]] = {}  # in one text: each array of a file takes as long to read as 100 kB
    for name in STATE_FIELDS if solution.states else ():
        values = [getattr(state, name) for state in solution.states]
        if np.ndim(values[0]):
            found[name] = np.stack(values)
        elif values[0] is not None:
            numbers[name] = np.array(values).tolist()
    steps = [(*state.passed, state.after) for state in solution.states] if histories else []
    packed = [_packed(history) for some in steps for history in some if history is not None]
    found |= {f"/{name}": np.stack([each[name] for each in packed]) for name in PACKED_ARRAYS if packed}
    told = {"engine": solution.engine, "why": solution.why, "heights": [*solution.heights], "numbers": numbers}
    found["/told"] = np.array(json.dumps(told | {"steps": [len(some) for some in steps]}))
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
        packed = {name: found[f"/{name}"] for name in PACKED_ARRAYS if told["steps"]}
    known: dict[str, Any] = dict.fromkeys(STATE_FIELDS)
    frames = range(len(arrays.get("index", ())))
    states = [State(**known | {name: values[k] for name, values in arrays.items()}) for k in frames]
    if told["steps"]:
        every = _unpacked(packed)
        for k, count in enumerate(told["steps"]):
            *passed, after = islice(every, count)
            states[k] = replace(states[k], after=after, passed=tuple(passed))
    return SolvedScene(told["engine"], states, told["why"], tuple(told["heights"]))


def _packed(history: History) -> dict[str, Array]:
    """A history as PACKED_ARRAYS."""
    none = np.full_like(history.x, np.nan), np.full_like(history.anchor, np.nan)
    error, motion = history.predictor_error or none
    predicted = none[0] if history.predicted is None else history.predicted
    numbers = np.array([float(getattr(history, name)) for name in HISTORY_NUMBERS])
    pose = {"rotation": history.pose.rotation, "position": history.pose.position, "numbers": numbers}
    arrays = {name: getattr(history, name) for name in HISTORY_ARRAYS}
    return arrays | pose | {"predicted": predicted, "error": error, "motion": motion}


def _unpacked(packed: Mapping[str, Array]) -> Iterator[History]:
    """The histories of stacks of PACKED_ARRAYS."""
    for k, (*numbers, folded) in enumerate(packed["numbers"].tolist()):
        known: dict[str, Any] = {name: packed[name][k] for name in HISTORY_ARRAYS}
        known |= dict(zip(HISTORY_NUMBERS, (*numbers, bool(folded)), strict=True))
        known["pose"] = Pose(packed["rotation"][k], packed["position"][k])
        if np.isfinite(packed["predicted"][k]).all():
            known |= {"predicted": packed["predicted"][k], "predictor_error": (packed["error"][k], packed["motion"][k])}
        yield History(**known)
