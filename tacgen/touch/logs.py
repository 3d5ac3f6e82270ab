"""Logs of simulators as episodes: CSV, npz and HDF5 as `tacgen replay` reads them, an episode each.

Their bodies are `sensor`, where the log has it, and `object`, or as the one object that is asked for.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tacgen.base.errors import UserError
from tacgen.replay import log_file
from tacgen.replay.contact_log import Conventions
from tacgen.touch.columns import ColumnNames, Named
from tacgen.touch.recording import RecordedRows

LOG_SUFFIXES = (*log_file.TABLE_SUFFIXES, *log_file.ARCHIVE_SUFFIXES, *log_file.HDF5_SUFFIXES)


@dataclass(frozen=True)
class Logs:
    """Log files. thing: name of the object."""

    files: Sequence[Path]
    columns: ColumnNames
    thing: str

    def __len__(self) -> int:
        return len(self.files)

    @property
    def fps(self) -> float:
        """Rows in a second, as in most of the first log."""
        return float(np.round(1 / np.median(np.diff(self.rows(0).time)), 3))

    def rows(self, number: int) -> RecordedRows:
        """One log by its place. Raises UserError: it cannot be read."""
        file, said = self.files[number], self.columns.model_dump(include={"quaternion", "units"}, exclude_unset=True)
        log = log_file.read(file, Conventions(self.columns.layout, **said))[0]
        if len(log) < 2:
            raise UserError(f"{file}: has {len(log)} rows, and at least 2 are needed")
        bodies = {self.thing: log.body} | ({} if log.sensor is None else {"sensor": log.sensor})
        forces = {} if log.force is None else {("sensor", self.thing): log.force}
        return RecordedRows(file.stem, log.time - log.time[0], _nothing, bodies=bodies, forces=forces)


def opened(path: Path, columns: ColumnNames, things: Sequence[str]) -> Logs:
    """A log, or those in a folder in the order of their names. Raises UserError: there is none."""
    files = [path] if path.is_file() else sorted(p for p in path.iterdir() if p.suffix.lower() in LOG_SUFFIXES)
    if not files:
        raise UserError(f"{path}: holds no logs ({', '.join(LOG_SUFFIXES)})")
    return Logs(files, columns, things[0] if len(things) == 1 else "object")


def _nothing(name: str) -> Named:
    raise KeyError("none in a log")
