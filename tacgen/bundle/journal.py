"""The plan and the journal of a run, in the dataset's folder beside the bundles.

Neither decides whether a scene is finished: only the bundle's own contents do. Runs of different shards write to
different files, so that several machines can share the folder.
"""

import hashlib
import json
import os
import re
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from pydantic import Field, NonNegativeInt

from tacgen.base import atomic_file, regular_file
from tacgen.base.errors import UserError
from tacgen.bundle import stored_json
from tacgen.bundle.stored_json import Name, Stored, Value

if TYPE_CHECKING:
    from tacgen.recipe.plan import Plan

Shard = tuple[int, int]  # (i, N): the scenes whose index modulo N is i
# of the files that runs write: N of their shards, and the seconds that a scene took
RUN_FILE_NAME = re.compile(r"(plan|journal)(?:-\d+-of-(\d+))?\.jsonl?|scene-\d+(?:-[LR])?\.(timing)\.json")
RUN_FILE_BEGINNINGS = {  # of their contents: a file that begins otherwise is not a run's, and stays untouched
    "plan": re.compile(rb'\{"name": "(?:[^"\\]|\\.)*", "scenes": \[\s*\{"scene": "'),
    "journal": re.compile(rb'\{"time": "[^"]*", "run": "'),
    "timing": re.compile(rb'\{\s*"frames": \d+,\s*"seconds": \{'),
}
BEGINNING_BYTES = 65536  # bytes at the beginning of a file in which these are looked for


@contextmanager
def claimed(plan: "Plan", folder: Path, shard: Shard | None) -> Iterator[str]:
    """Claim a folder for the runs of one plan, or of its shards; gives the plan as JSON.

    Raises:
        UserError: a file that no run wrote has the name of one that this run writes.
        Busy: a run of something else is at work there.
    """
    from tacgen.recipe import plan_table

    written = [f"plan{_suffix(shard)}.json", f"journal{_suffix(shard)}.jsonl"]
    for name in [*written, *os.listdir(folder)]:
        match = RUN_FILE_NAME.fullmatch(name)
        needed = match and (match[3] or name in written) and os.path.lexists(folder / name)
        if match and needed and not _is_ours(folder / name, match[1] or match[3]):
            text = "was not written by tacgen run, which needs this name: move it, or choose another folder"
            raise UserError(f"{folder / name}: {text}")
    table = plan_table.as_json(plan)
    work = table if shard is None else f"{plan.inputs} in {shard[1]}"
    busy = f"{folder}: a run of another recipe, or of other values of it, is at work there: choose another folder"
    with atomic_file.shared(folder / "run", hashlib.sha256(work.encode()).hexdigest(), busy):
        yield table


def write_plan(table: str, folder: Path, shard: Shard | None) -> None:
    """Write `plan.json`, or that of a shard, and remove the plans of other divisions into shards."""
    target = folder / f"plan{_suffix(shard)}.json"
    for path, shards in _files(folder, "plan"):
        if shards != (shard and str(shard[1])):
            path.unlink(missing_ok=True)
    atomic_file.write(target, table.encode())


def _files(folder: Path, kind: str) -> list[tuple[Path, str | None]]:
    """The plans or journals that runs wrote in a folder, sorted, each with the number of shards that its name gives."""
    ours = []
    for name in sorted(os.listdir(folder)):
        match = RUN_FILE_NAME.fullmatch(name)
        if match and match[1] == kind and _is_ours(folder / name, kind):
            ours.append((folder / name, match[2]))
    return ours


def _is_ours(path: Path, kind: str) -> bool:
    """Whether a file begins as those that runs write; an empty one holds nothing that could be lost."""
    try:
        with regular_file.opened(path, stored_json.MAX_JSON_BYTES) as file:
            head = file.read(BEGINNING_BYTES)
    except OSError:
        return False
    return not head or RUN_FILE_BEGINNINGS[kind].match(head) is not None


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
    plans = [stored_json.read(StoredPlan, path) for path, _ in _files(folder, "plan")]
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
    keys: dict[str, str] = Field(default_factory=dict)  # of each bundle of the scene, by its name


def read_journal(folder: Path) -> Iterator[Event]:
    """All lines of all journals in the folder, in order, without lines that a killed run left incomplete.

    Raises:
        UserError: a journal cannot be read.
    """
    for path, _ in _files(folder, "journal"):
        for line in regular_file.content(path, stored_json.MAX_JSON_BYTES).splitlines():
            with suppress(ValueError):
                yield stored_json.parsed(Event, line)


def made(folder: Path) -> set[tuple[str, str]]:
    """Name and input key of every bundle that the runs in this folder planned or made."""
    plan = read_plan(folder)
    planned = {(row.scene, row.key) for row in plan.scenes} if plan else set()
    return planned.union(*(event.keys.items() for event in read_journal(folder)))


def _suffix(shard: Shard | None) -> str:
    return "" if shard is None else f"-{shard[0]}-of-{shard[1]}"
