"""What a dataset's folder says of itself beside its bundles: the plan, and a journal of what happened.

Neither is ever trusted about a finished scene: a bundle counts by its own contents alone. Runs of different shards
write different files, so that machines that share the folder do not write into each other's.
"""

import json
import os
import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from pydantic import JsonValue, NonNegativeInt

from tacgen import atomic_file, regular_file
from tacgen.bundle import stored_json
from tacgen.bundle.stored_json import Name, Stored
from tacgen.errors import UserError, why
from tacgen.recipe import plan_table
from tacgen.recipe.plan import Plan

Shard = tuple[int, int]  # (i, N): the scenes whose index leaves i when divided by N


def write_plan(plan: Plan, folder: Path, shard: Shard | None) -> None:
    """Write `plan.json`, or a shard's own; those of another division of the work are removed."""
    target = folder / f"plan{_suffix(shard)}.json"
    mine = {target.name} if shard is None else {f"plan{_suffix((i, shard[1]))}.json" for i in range(shard[1])}
    for other in set(folder.glob("plan*.json")):
        if other.name not in mine:
            other.unlink(missing_ok=True)
    atomic_file.write(target, plan_table.as_json(plan).encode())


class PlannedScene(Stored):
    """A row of a stored plan."""

    scene: Name
    frames: NonNegativeInt
    key: str
    values: dict[str, JsonValue]


class StoredPlan(Stored):
    """What plan.json says."""

    name: str
    scenes: list[PlannedScene]


def read_plan(folder: Path) -> StoredPlan | None:
    """The plan of all shards together; None if the folder has none. Raises UserError: it is damaged."""
    plans = [stored_json.read(StoredPlan, path) for path in sorted(folder.glob("plan*.json"))]
    if not plans:
        return None
    scenes = [scene for plan in plans for scene in plan.scenes]
    scenes.sort(key=lambda row: (len(row.scene), row.scene))  # scene-100000 comes after scene-99999
    return StoredPlan(name=plans[0].name, scenes=scenes)


class Journal:
    """One JSON object a line: when a run began and ended, and each scene's outcome and retries."""

    def __init__(self, folder: Path, shard: Shard | None) -> None:
        self.path = folder / f"journal{_suffix(shard)}.jsonl"
        self.who = f"{socket.gethostname()}:{os.getpid()}"

    def __enter__(self) -> "Journal":
        handle = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK, 0o666)  # waits for no pipe
        self.file = os.fdopen(handle, "a", encoding="utf-8")
        self.write({"event": "begin"})
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.write({"event": "end"} if kind is None else {"event": "end", "error": f"{kind.__name__}: {error}"})
            self.file.close()
        except OSError:
            if kind is None:  # otherwise what stopped the run is the better message
                raise

    def write(self, event: dict[str, Any]) -> None:
        """Append a line; a frame is not worth one."""
        if event["event"] != "frame":
            line = {"time": time.strftime("%Y-%m-%dT%H:%M:%S%z"), "run": self.who, **event}
            self.file.write(json.dumps(line) + "\n")
            self.file.flush()


class Event(Stored):
    """A line of a journal; of one that ends a scene more is said."""

    event: str
    scene: str = ""
    status: str = ""
    reason: str = ""
    traceback: str = ""


def read_journal(folder: Path) -> Iterator[Event]:
    """Every line of every journal in the folder, in the order written; one that a killed run cut short is left out.

    Raises:
        UserError: a journal cannot be read.
    """
    for path in sorted(folder.glob("journal*.jsonl")):
        try:
            lines = regular_file.read_bytes(path, stored_json.LARGEST).splitlines()
        except OSError as error:
            raise UserError(f"{path}: cannot be read: {why(error)}") from None
        for line in lines:
            with suppress(ValueError):
                yield stored_json.parsed(Event, line)


def _suffix(shard: Shard | None) -> str:
    return "" if shard is None else f"-{shard[0]}-of-{shard[1]}"
