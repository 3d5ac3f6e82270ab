"""Measurements of the program itself: how far it may be pushed, how right it is, what it costs.

A bench is a module with `bench(level, say) -> results_page.Result` and a line of BENCHES. Each writes its figures as
JSON and a picture; the page of results is made of those files.
"""

import os
import time
import traceback
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from benchmarks import results_page, summary
from tacgen.errors import UserError

BENCHES = {  # and the module of each
    "mechanics": "mechanics",
    "ordinary": "ordinary",
    "pipeline": "pipeline",
    "cost": "cost",
    "peers": "peers",
    "optics": "optics",
    "real": "real",
    "stability": "stability",
    "pay": "cost_per_output",
    "scaling": "scaling",
    "load": "load",
}
PARTS = (*BENCHES, "torture")  # of the page; `make torture` writes the last
PAGE, FOLDER = "RESULTS.md", "results"
HEAD = (
    "Written by `tacgen bench` (`make bench`), never by hand: each part says when, where and with what it was made."
    " Seconds depend on the machine; ratios between them hardly. All figures are in `results/*.json` too."
)


def run(names: Sequence[str], out: Path, level: results_page.Level, say: results_page.Say) -> list[str]:
    """Run these benches, or all, and write `out`/RESULTS.md and `out`/results; the names of those that failed.

    Raises:
        UserError: a bench of no such name.
    """
    if unknown := [name for name in names if name not in BENCHES]:
        raise UserError(f"{unknown[0]}: must be one of {', '.join(BENCHES)}")
    os.environ.update(results_page.one_thread())  # before NumPy comes in
    failed = []
    for name in names or BENCHES:
        started = time.perf_counter()
        try:
            found = import_module(f"benchmarks.{BENCHES[name]}").bench(
                level, lambda text, name=name: say(f"{name}: {text}")
            )
        except results_page.Absent as why:
            say(f"{name}: left out, {why}")
            continue
        except Exception:
            say(traceback.format_exc())  # the others go on
            failed.append(name)
            continue
        record(name, found, time.perf_counter() - started, out)
        say(f"{name}: {time.perf_counter() - started:.0f} s")
    return failed


def record(name: str, found: results_page.Result, seconds: float, out: Path) -> None:
    """Write one part's figures to `out`/results, and `out`/RESULTS.md anew."""
    results_page.write(out / FOLDER, name, found, seconds)
    results_page.page(out / FOLDER, PARTS, out / PAGE, "Results", f"{HEAD}\n\n{summary.short(out / FOLDER)}")
