"""Measure accuracy, run time, stability and the cost of outputs and batches on this machine.

    python -m benchmarks [NAME ...] [-o FOLDER] [--full | --smoke]

Writes FOLDER/RESULTS.md and FOLDER/results. The exit code is 1 if a bench failed, 2 for an error in the arguments.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import benchmarks
from tacgen.base.errors import UserError
from tacgen.base.terminal import say
from tacgen.cli.common import probe, writing


def main(arguments: Sequence[str] | None = None) -> int:
    """Run benches; returns the exit code."""
    ask = argparse.ArgumentParser(
        "python -m benchmarks", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    ask.add_argument("names", nargs="*", metavar="NAME", help=f"{' '.join(benchmarks.BENCHES)}; all if left out")
    ask.add_argument("-o", "--out", type=Path, default=Path("out/bench"), help="folder; out/bench if left out")
    levels = ask.add_mutually_exclusive_group()
    for level, text in (("full", "finer meshes, more scenes: an hour or more"), ("smoke", "the smallest run of each")):
        levels.add_argument(f"--{level}", action="store_const", const=level, dest="level", default="normal", help=text)
    told = ask.parse_args(arguments)
    try:
        with writing(told.out):
            probe(told.out)
            failed = benchmarks.run(told.names, told.out, told.level, lambda text: say(text, err=True))
    except UserError as error:
        for line in error.lines:
            say(line, err=True)
        return 2
    say(str(told.out / benchmarks.PAGE))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
