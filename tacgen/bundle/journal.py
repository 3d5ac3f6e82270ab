"""The plan and the journal of a run, in the dataset's folder beside the bundles.

Neither decides whether a scene is finished: only the bundle's own contents do. Runs of different shards write to
different files, so that several machines can share the folder.
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

from pydantic import NonNegativeInt

from tacgen import atomic_file, regular_file
from tacgen.bundle import stored_json
from tacgen.bundle.stored_json import Name, Stored, Value
from tacgen.errors import UserError, why
from tacgen.recipe import plan_table
from tacgen.recipe.plan import Plan

Shard = tuple[int, int]  # (i, N): the scenes whose index modulo N is i


def write_plan(plan: Plan, folder: Path, shard: Shard | None) -> None:
    """Write `plan.json`, or that of a shard, and remove the plans of other divisions into shards."""
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
    values: dict[str, Value]


class StoredPlan(Stored):
    """The contents of plan.json."""

    name: str
    scenes: list[PlannedScene]


def read_plan(folder: Path) -> StoredPlan | None:
    """The combined plan of all shards; None if the folder has none. Raises UserError: it is damaged."""
    plans = [stored_json.read(StoredPlan, path) for path in sorted(folder.glob("plan*.json"))]
    if not plans:
        return None
    scenes = [scene for plan in plans for scene in plan.scenes]
    scenes.sort(key=lambda row: (len(row.scene), row.scene))  # scene-100000 comes after scene-99999
    return StoredPlan(name=plans[0].name, scenes=scenes)


class Journal:
    """Log of a run with a JSON object per line: begin and end, and the outcome and retries of each scene."""

    def __init__(self, folder: Path, shard: Shard | None) -> None:
        self.path = folder / f"journal{_suffix(shard)}.jsonl"
        self.who = f"{socket.gethostname()}:{os.getpid()}"

    def __enter__(self) -> "Journal":
        handle = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK, 0o666)  # no wait for a pipe
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
            if kind is None:  # otherwise the error that stopped the run matters more
                raise

    def write(self, event: dict[str, Any]) -> None:
        """Append an event as a line; events of single frames are skipped."""
        if event["event"] != "frame":
            line = {"time": time.strftime("%Y-%m-%dT%H:%M:%S%z"), "run": self.who, **event}
            self.file.write(json.dumps(line) + "\n")
            self.file.flush()


class Event(Stored):
    """A line of a journal; status, reason and traceback are those of a scene that ended."""

    event: str
    scene: str = ""
    status: str = ""
    reason: str = ""
    traceback: str = ""


def read_journal(folder: Path) -> Iterator[Event]:
    """All lines of all journals in the folder, in order, without lines that a killed run left incomplete.

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
