"""What every bench gives: tables and plots, with where and of what they were made; and the page that shows them all."""

import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

Cell: TypeAlias = str | float | int | None
Level: TypeAlias = Literal["smoke", "normal", "full"]
Say: TypeAlias = Callable[[str], None]
ROOT = Path(__file__).parents[1]
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
PACKAGES = ("numpy", "scipy", "numba", "cvxopt", "pymetis", "mitsuba", "drjit", "h5py", "ipctk")
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")  # Okabe and Ito's
MARKERS = "osD^vPX*"  # one more than colours: the eighth is no twin of the first
CHILD = """
import importlib, json, sys
module, name = sys.argv[1].split(":")
print(json.dumps(getattr(importlib.import_module(module), name)(*json.loads(sys.argv[2]))))
"""


class Absent(Exception):
    """What a bench needs is not on this machine: what it found elsewhere stays."""


@dataclass(frozen=True)
class Table:
    """Rows under `columns`: a heading with its unit, and how its numbers are written, as `format` has it."""

    title: str
    columns: dict[str, str]
    rows: list[list[Cell]]
    note: str = ""


def columns(*named: str) -> dict[str, str]:
    """The columns of a table from headings, each with how its numbers are written after a colon: "s a frame: .2f"."""
    return {head: form for head, _, form in (name.partition(": ") for name in named)}


@dataclass(frozen=True)
class Series:
    """Points of a plot, with a word beside each of them where `labels` has one."""

    name: str
    x: list[float]
    y: list[float]
    labels: list[str] = field(default_factory=list)
    line: bool = False


@dataclass(frozen=True)
class Plot:
    """Axes, of which those in `log` are logarithmic."""

    title: str
    x: str
    y: str
    series: list[Series]
    log: Literal["xy", "x", ""] = "xy"


@dataclass(frozen=True)
class Result:
    """What a bench found: `about` says in a few sentences what was done and how to read it."""

    about: str
    tables: list[Table]
    plots: list[Plot] = field(default_factory=list)


def made() -> dict[str, Any]:
    """Machine, versions and date."""
    packages = {}
    for name in ("tacgen", *PACKAGES):
        try:
            packages[name] = version(name)
        except PackageNotFoundError:
            continue
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    return {
        "date": time.strftime("%Y-%m-%d"),
        "processor": _processor(),
        "cores": core_count(),
        "gflops": round(in_own_process(f"{__name__}:gflops"), 1),
        "memory_gb": round(memory),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "packages": packages,
    }


def gflops(n: int = 1000) -> float:
    """How fast matrices of n rows are multiplied here and now: what seconds of different hours are compared by."""
    a = np.random.default_rng(0).random((n, n))
    seconds = []
    for _ in range(9):
        start = time.perf_counter()
        a @ a
        seconds.append(time.perf_counter() - start)
    return 2e-9 * n**3 / float(np.median(seconds))


def _processor() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    found = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return found[0] if found else platform.machine()


def one_thread() -> dict[str, str]:
    """The environment in which a process computes on one core, and finds the benchmarks."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return os.environ | dict.fromkeys(ONE_THREAD, "1") | {"PYTHONPATH": path}


def in_own_process(target: str, *args: Any, env: dict[str, str] | None = None) -> Any:
    """What `target`, "module:function", gives for plain arguments in a process of its own, on one core.

    `env` is added to its environment.

    Raises:
        RuntimeError: it failed; the message is what it said.
    """
    command = [sys.executable, "-c", CHILD, target, json.dumps(args)]
    done = subprocess.run(command, env=one_thread() | (env or {}), capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{target}{args}: {done.stderr.strip() or f'exit code {done.returncode}'}")
    return json.loads(done.stdout.splitlines()[-1])


def in_own_processes(target: str, jobs: Iterable[tuple[Any, ...]]) -> Iterator[Any]:
    """What `in_own_process` gives for each job, or the RuntimeError that it raises; one on each core at a time."""

    def one(job: tuple[Any, ...]) -> Any:
        try:
            return in_own_process(target, *job)
        except RuntimeError as error:
            return error

    with ThreadPoolExecutor(core_count()) as threads:  # each waits for a process
        yield from threads.map(one, jobs)


def core_count() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0))


@contextmanager
def cores(level: Level = "normal") -> Iterator[Callable[..., Iterator[Any]]]:
    """A `map` whose calls go to as many processes as there are cores: for what is not timed. At `smoke` it is map."""
    if level == "smoke":
        yield map
        return
    with ProcessPoolExecutor(core_count(), mp_context=get_context("spawn")) as workers:
        yield workers.map


def peak_memory(process: int | str = "self") -> float:
    """Of a process since it began [MB]; getrusage would count what the parent had when it forked."""
    return float(Path(f"/proc/{process}/status").read_text().partition("VmHWM:")[2].split()[0]) / 1024


def front(x: Sequence[float], y: Sequence[float]) -> list[int]:
    """Pareto front: the points than which none is smaller in both x and y, by rising x."""
    kept: list[int] = []
    for i in sorted(range(len(x)), key=lambda i: (x[i], y[i])):
        if not kept or y[i] < y[kept[-1]]:
            kept.append(i)
    return kept


def write(folder: Path, name: str, found: Result, seconds: float) -> None:
    """The JSON and the picture of one bench, in `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    plain = {"bench": name, "made": made(), "seconds": round(seconds, 1), **asdict(found)}
    (folder / f"{name}.json").write_text(json.dumps(plain, indent=1) + "\n")
    if found.plots:
        _draw(found.plots, folder / f"{name}.png")


def _draw(plots: Sequence[Plot], out: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = min(len(plots), 2)
    rows = -(-len(plots) // columns)
    sheet = Figure(figsize=(6.4 * columns, 4.8 * rows), layout="constrained")
    FigureCanvasAgg(sheet)
    texts: list[Any] = []
    for number, plot in enumerate(plots):
        axes = sheet.add_subplot(rows, columns, number + 1)
        for k, one in enumerate(plot.series):
            colour, mark = COLOURS[k % len(COLOURS)], "" if one.line else MARKERS[k % len(MARKERS)]
            axes.plot(
                one.x, one.y, color=colour, marker=mark, linestyle="-" if one.line else "", label=one.name,
                markersize=5, linewidth=1.2,
            )  # fmt: skip
            for x, y, label in zip(one.x, one.y, one.labels, strict=False):
                style: dict[str, Any] = {"textcoords": "offset points", "fontsize": 7, "color": colour}
                texts.append(axes.annotate(label, (x, y), (4, 3), **style))
        scale = dict.fromkeys(plot.log, "log")
        axes.set(xscale=scale.get("x", "linear"), yscale=scale.get("y", "linear"))
        axes.set(title=plot.title, xlabel=plot.x, ylabel=plot.y)
        axes.grid(True, which="both", linewidth=0.3, alpha=0.6)
        axes.legend(fontsize=7)
    sheet.dpi = 110
    sheet.draw_without_rendering()  # lays out the axes
    spread(texts)
    sheet.savefig(out, dpi=110)


def spread(texts: Sequence[Any]) -> None:
    """Move labels that would be printed over others, up or down; where there is no room, the table alone says it."""
    placed: list[Any] = []
    for text in texts:
        for down in (0, 8, -8, 16, -16, 24, -24, 32, -32):
            text.set_position((4, 3 - down))
            box = text.get_window_extent()
            if not any(box.overlaps(other) for other in placed):
                placed.append(box)
                break
        else:
            text.remove()


def page(folder: Path, names: Sequence[str], file: Path, title: str, head: str) -> None:
    """Markdown of what `folder` holds of these benches, each with where and when it was made."""
    parts = [f"# {title}", head]
    for name in names:
        source = folder / f"{name}.json"
        if source.exists():
            parts += _section(json.loads(source.read_text()), folder, file.parent)
    file.write_text("\n\n".join(parts) + "\n")


def _section(found: dict[str, Any], folder: Path, home: Path) -> list[str]:
    m = found["made"]
    packages = ", ".join(f"{name} {number}" for name, number in m["packages"].items())
    speed = f" ({m['gflops']} Gflop/s on one when it ended)" if "gflops" in m else ""
    machine = f"{m['processor']}, {m['cores']} cores{speed}, {m['memory_gb']} GB, {m['system']}"
    parts = [
        f"## {found['bench'].capitalize()}",
        found["about"],
        f"*Made {m['date']} in {found['seconds']:.0f} s on {machine}; Python {m['python']}, {packages}.*",
    ]
    if found["plots"]:
        picture = (folder / f"{found['bench']}.png").relative_to(home)
        parts.append(f"![{found['bench']}]({picture.as_posix()})")
    for table in found["tables"]:
        parts += [f"### {table['title']}", _grid(table)]
        if table["note"]:
            parts.append(table["note"])
    return parts


def _grid(table: dict[str, Any]) -> str:
    heads = list(table["columns"])
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for row in table["rows"]:
        cells = (_cell(cell, form) for cell, form in zip(row, table["columns"].values(), strict=True))
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(cell: Cell, form: str) -> str:
    return "" if cell is None else cell.replace("|", "\\|") if isinstance(cell, str) else format(cell, form)
