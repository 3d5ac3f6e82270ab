"""`make torture`: many hostile inputs and kills, and a table of what became of them.

    PYTHONPATH=tests python -m benchmarks.torture --inputs 10000 --kills 1000 -o docs

The attempts themselves are in tests/hostile, where some of them are part of the tests.
"""

import argparse
import sys
import tempfile
import time
from collections import Counter
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from hostile import attempts, kills
from hostile.resealed import MUTATIONS

import benchmarks
from benchmarks import results_page
from tacgen.base import machine

ABOUT = (
    "Hostile inputs, each read by a command or a loader in a process of its own, and processes killed at a"
    " call to the disk and run again. Accepted is what a reader does not use, what `check` tells, and of"
    " kills what a second run made whole."
)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=10_000, help="shared by all kinds of damage")
    parser.add_argument("--kills", type=int, default=1_000)
    parser.add_argument("--first", type=int, default=0, help="seed to begin with")
    parser.add_argument("--out", "-o", type=Path, default=Path("out/torture"), help="folder for the page of results")
    args = parser.parse_args()
    start, bad = time.perf_counter(), list[str]()
    numbers = dict.fromkeys(sorted(MUTATIONS), args.inputs // len(MUTATIONS)) | {"kill": args.kills}
    counts = {kind: Counter[str]() for kind in numbers}
    jobs = [(kind, args.first + i) for kind, number in numbers.items() for i in range(number)]
    with tempfile.TemporaryDirectory() as scratch:
        source = attempts.inputs(attempts.base(Path(scratch)))
        attempts.warm(source)
        with get_context("fork").Pool(machine.cores()) as pool:
            for found in pool.imap_unordered(partial(one, source), jobs, chunksize=4):
                counts[found.kind][found.outcome] += 1
                if found.outcome not in (attempts.GOOD if found.kind != "kill" else ("accepted",)):
                    bad.append(str(found))
                    print(found, file=sys.stderr, flush=True)
    heads = results_page.columns("kind", "tried: d", *(f"{name}: d" for name in attempts.OUTCOMES))
    rows = [[kind, n.total(), *(n[name] for name in attempts.OUTCOMES)] for kind, n in counts.items()]
    table = results_page.Table("Damage and kills", heads, rows, f"Seeds from {args.first}." + "".join(bad))
    benchmarks.record("torture", results_page.Result(ABOUT, [table]), time.perf_counter() - start, args.out)
    print((args.out / benchmarks.PAGE).read_text())
    return 1 if bad else 0


def one(source: Path, job: tuple[str, int]) -> attempts.Attempt:
    """One attempt or kill, by its kind and seed."""
    kind, seed = job
    return kills.kill(seed, source) if kind == "kill" else attempts.attempt(kind, seed, source)


if __name__ == "__main__":
    sys.exit(main())
