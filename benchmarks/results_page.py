"""Results of benches as tables and plots, with date, machine and versions, and the page of all results."""

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
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from tacgen.base import machine
from tacgen.batch import worker_process

Cell: TypeAlias = str | float | int | None
Level: TypeAlias = Literal["smoke", "normal", "full"]
Say: TypeAlias = Callable[[str], None]
ROOT = Path(__file__).parents[1]
PACKAGES = ("numpy", "scipy", "warp-lang", "cvxopt", "pymetis", "mitsuba", "drjit", "h5py")
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")  # Okabe and Ito's
MARKERS = "osD^vPX*"  # one more than colours, so that the eighth series differs from the first
LONGEST = 85  # words of a table on the page: longer ones stay in the JSON, which the page names
CHILD = """
import importlib, json, sys
module, name = sys.argv[1].split(":")
print(json.dumps(getattr(importlib.import_module(module), name)(*json.loads(sys.argv[2]))))
"""


class Absent(Exception):
    """Something that a bench needs is missing on this machine; earlier results are kept."""


@dataclass(frozen=True)
class Table:
    """A table; `columns`: headings with units, and the format specification of their numbers."""

    title: str
    columns: dict[str, str]
    rows: list[list[Cell]]
    note: str = ""


def columns(*named: str) -> dict[str, str]:
    """The columns of a table from texts such as "s a frame: .2f", a heading and a format specification."""
    return {head: form for head, _, form in (name.partition(": ") for name in named)}


@dataclass(frozen=True)
class Series:
    """Points of a plot, with optional labels."""

    name: str
    x: list[float]
    y: list[float]
    labels: list[str] = field(default_factory=list)
    line: bool = False


@dataclass(frozen=True)
class Plot:
    """A plot; the axes in `log` are logarithmic."""

    title: str
    x: str
    y: str
    series: list[Series]
    log: Literal["xy", "x", ""] = "xy"


@dataclass(frozen=True)
class Result:
    """The result of a bench; `about` describes the measurement in a few sentences."""

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
        "cores": machine.cores(),
        "gflops": round(in_own_process(f"{__name__}:gflops"), 1),
        "cholmod_blas": in_own_process(f"{__name__}:cholmod_blas"),
        "memory_gb": round(memory),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "packages": packages,
    }


def gflops(n: int = 1000) -> float:
    """Speed of the product of matrices of n rows [Gflop/s], to compare runs at different times."""
    a = np.random.default_rng(0).random((n, n))
    seconds = []
    for _ in range(9):
        start = time.perf_counter()
        a @ a
        seconds.append(time.perf_counter() - start)
    return 2e-9 * n**3 / float(np.median(seconds))


def cholmod_blas() -> str:
    """The kernels of CHOLMOD's BLAS and their speed, which differ from NumPy's; empty without CHOLMOD."""
    from tacgen.mechanics import blas_kernels, linear_solvers

    return blas_kernels.report() if "cholmod" in linear_solvers.available() else ""


def _processor() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    found = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return found[0] if found else platform.machine()


def one_thread() -> dict[str, str]:
    """The environment of a process that uses one core and can import the benchmarks."""
    return machine.environment(**dict.fromkeys(worker_process.THREAD_VARIABLES, "1"))


def in_own_process(target: str, *args: Any, env: dict[str, str] | None = None) -> Any:
    """The result of `target`, "module:function", for plain arguments, in a separate process on one core.

    `env` is added to its environment.

    Raises:
        RuntimeError: it failed; the message is its stderr.
    """
    command = [sys.executable, "-c", CHILD, target, json.dumps(args)]
    done = subprocess.run(command, env=one_thread() | (env or {}), capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{target}{args}: {done.stderr.strip() or f'exit code {done.returncode}'}")
    return json.loads(done.stdout.splitlines()[-1])


def in_own_processes(target: str, jobs: Iterable[tuple[Any, ...]]) -> Iterator[Any]:
    """The result of `in_own_process` for each job, or its RuntimeError; one job on each core at a time."""

    def one(job: tuple[Any, ...]) -> Any:
        try:
            return in_own_process(target, *job)
        except RuntimeError as error:
            return error

    with ThreadPoolExecutor(machine.cores()) as threads:  # each thread waits for a process
        yield from threads.map(one, jobs)


@contextmanager
def cores(level: Level = "normal") -> Iterator[Callable[..., Iterator[Any]]]:
    """A `map` that distributes its calls to one process a core, for work that is not timed; at `smoke` it is map."""
    if level == "smoke":
        yield map
        return
    with ProcessPoolExecutor(machine.cores(), mp_context=get_context("spawn")) as workers:
        yield workers.map


def peak_memory() -> float:
    """Peak memory of this process [MB]; getrusage would include that of the parent before the fork."""
    return float(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0]) / 1024


def front(x: Sequence[float], y: Sequence[float]) -> list[int]:
    """Pareto front: the indices of the points that no other point beats in both x and y, by increasing x."""
    kept: list[int] = []
    for i in sorted(range(len(x)), key=lambda i: (x[i], y[i])):
        if not kept or y[i] < y[kept[-1]]:
            kept.append(i)
    return kept


def write(folder: Path, name: str, found: Result, seconds: float) -> None:
    """Write the JSON and the plot of one bench to `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    plain = {"bench": name, "made": made(), "seconds": round(seconds, 1), **asdict(found)}
    (folder / f"{name}.json").write_text(json.dumps(plain, indent=1) + "\n")
    if found.plots:
        _draw(found.plots, folder / f"{name}.png")


def _draw(plots: Sequence[Plot], out: Path) -> None:
    from matplotlib.figure import Figure

    columns = min(len(plots), 2)
    rows = -(-len(plots) // columns)
    sheet = Figure(figsize=(6.4 * columns, 4.8 * rows), layout="constrained")
    labels: list[tuple[Any, list[Any]]] = []
    for number, plot in enumerate(plots):
        axes = sheet.add_subplot(rows, columns, number + 1)
        texts: list[Any] = []
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
        for axis in (getattr(axes, f"{name}axis") for name in scale):
            round_ticks(axis)
        axes.grid(True, which="both", linewidth=0.3, alpha=0.6)
        if len(plot.series) > 1 or not texts:
            axes.legend(fontsize=7)
        labels.append((axes, texts))
    sheet.dpi = 110
    sheet.draw_without_rendering()  # computes the layout of the axes
    for axes, texts in labels:
        spread(axes, texts, [point for line in axes.get_lines() for point in line.get_xydata()])
    sheet.savefig(out, dpi=110)


def round_ticks(axis: Any) -> None:
    """Label a logarithmic axis with plain numbers: powers of ten; with 2 and 5 of each decade on an axis of up to two;
    evenly spaced ones on an axis of less than one."""
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

    low, high = axis.get_view_interval()
    decades = LogLocator(subs=(1.0, 2.0, 5.0) if high < 100 * low else (1.0,))
    axis.set_major_locator(decades if high > 5 * low else MaxNLocator(5, steps=[1, 2, 5, 10]))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def spread(axes: Any, texts: Sequence[Any], points: Sequence[Any] = ()) -> None:
    """Move labels beside their points so that none overlaps another, the legend or `points` [data], or leaves the axes.

    Labels without room are removed.
    """
    from matplotlib.transforms import Bbox

    legend, inside = axes.get_legend(), axes.get_window_extent()
    placed: list[Any] = [legend.get_window_extent()] if legend else []
    placed += [Bbox.from_extents(*(at - 3), *(at + 3)) for at in map(axes.transData.transform, points)]
    for text in texts:
        for down, side in product((0, 8, -8, 16, -16, 24, -24, 32, -32), ("left", "right")):
            text.set(position=(4 if side == "left" else -4, 3 - down), horizontalalignment=side)
            box = text.get_window_extent()
            within = inside.x0 <= box.x0 and box.x1 <= inside.x1 and inside.y0 <= box.y0 and box.y1 <= inside.y1
            if within and not any(box.overlaps(other) for other in placed):
                placed.append(box)
                break
        else:
            text.remove()


def page(folder: Path, names: Sequence[str], file: Path, title: str, head: str) -> None:
    """Write the page of the results of these benches in `folder`."""
    parts = [f"# {title}", head]
    for name in names:
        source = folder / f"{name}.json"
        if source.exists():
            parts += _section(json.loads(source.read_text()), folder, file.parent)
    file.write_text("\n\n".join(parts) + "\n")


def _section(found: dict[str, Any], folder: Path, home: Path) -> list[str]:
    m = found["made"]
    parts = [
        f"## {found['bench'].capitalize()}",
        found["about"],
        f"*Made {m['date']} on {m['processor']}, {m['cores']} cores, {m['memory_gb']} GB.*",
    ]
    if found["plots"]:
        picture = (folder / f"{found['bench']}.png").relative_to(home)
        parts.append(f"![{found['bench']}]({picture.as_posix()})")
    for table in found["tables"]:
        drawn = grid(table)
        long = len(drawn.replace("|", " ").split()) > LONGEST
        rows = f"{len(table['rows'])} rows in `{folder.name}/{found['bench']}.json`: {', '.join(table['columns'])}."
        parts += [f"### {table['title']}", rows if long else drawn]
        if table["note"] and not long:
            parts.append(table["note"])
    return parts


def grid(table: dict[str, Any]) -> str:
    """A table of a result's JSON as Markdown."""
    heads = list(table["columns"])
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for row in table["rows"]:
        cells = (_cell(cell, form) for cell, form in zip(row, table["columns"].values(), strict=True))
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(cell: Cell, form: str) -> str:
    return "" if cell is None else cell.replace("|", "\\|") if isinstance(cell, str) else format(cell, form)
