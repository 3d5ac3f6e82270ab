"""Datasets of many scenes: seconds, memory and open files of each command, as the number of scenes grows."""

import os
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from benchmarks.results_page import Cell, Level, Plot, Result, Say, Series, Table, columns, one_thread, peak_memory
from benchmarks.scaling import TINY

COUNTS: dict[Level, tuple[int, ...]] = {"smoke": (2, 4), "normal": (250, 1000), "full": (250, 1000, 5000)}
LOOK_S = 0.02  # interval at which a process is sampled [s]
ABOUT = (
    "The smallest possible scenes, one frame of forces, are made, checked and packed by the commands, each in a"
    " separate process: processor seconds (of `run` with its workers), and peak memory and largest number of open"
    " files of the command itself. Growth faster than the number of scenes would prevent larger datasets."
)


def bench(level: Level, say: Say) -> Result:
    """Every command on each number of scenes."""
    counts, rows = COUNTS[level], list[list[Cell]]()
    series: dict[str, Series] = {}
    for count in counts:
        with tempfile.TemporaryDirectory() as folder:
            for name, args in _commands(count, Path(folder)).items():
                seconds, memory, files = measured(args)
                one = series.setdefault(name, Series(name, [], []))
                each = 1000 * (seconds - one.y[-1]) / (count - one.x[-1]) if one.x else None
                rows.append([name, count, seconds, each, memory, files])
                one.x.append(float(count))
                one.y.append(seconds)
                say(f"{name} of {count}: {seconds:.1f} s, {memory:.0f} MB, {files} files")
    heads = columns(
        "command", "scenes: d", "s: .1f", "ms for each scene more: .1f", "peak memory [MB]: .0f", "open files: d"
    )
    rows.sort(key=lambda row: list(series).index(str(row[0])))
    return Result(ABOUT, [Table("Commands", heads, rows)], [Plot("Seconds", "scenes", "s", [*series.values()])])


def _commands(count: int, here: Path) -> dict[str, list[str]]:
    """The commands, in the order in which they are run."""
    made = str(here / "made")
    over = f"vary={{method: random, samples: {count}, over: {{start.x_mm: {{uniform: [-4, 4]}}}}}}"
    sets = [word for text in (*TINY, over) for word in ("--set", text)]
    return {
        "run": ["run", "batch", "-o", made, *sets],
        "run again": ["run", "batch", "-o", made, *sets],
        "status": ["status", made],
        "check": ["check", made],
        "report": ["report", made],
        "pack": ["pack", made, "-o", str(here / "packed")],
        "check, packed": ["check", str(here / "packed")],
    }


def measured(args: list[str]) -> tuple[float, float, int]:
    """Processor seconds, peak memory [MB] and largest number of open files of a command.

    Raises:
        RuntimeError: it failed; the message is its output.
    """
    command = [sys.executable, "-m", "tacgen", *args]
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(command, env=one_thread(), stdout=said, stderr=subprocess.STDOUT)
        memory, files = 0.0, 0
        while not (ended := os.wait4(process.pid, os.WNOHANG))[0]:
            with suppress(OSError, IndexError):  # the process has just ended
                memory = max(memory, peak_memory(process.pid))
                files = max(files, len(os.listdir(f"/proc/{process.pid}/fd")))
            time.sleep(LOOK_S)
        _, status, used = ended
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        if process.returncode:
            raise RuntimeError(f"{args}: {said.read().decode()[-2000:]}")
    return used.ru_utime + used.ru_stime, memory, files
