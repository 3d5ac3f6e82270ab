"""Error of `default` (or others) against `reference`: force, pressure map, peak and area, for all three sensors.

    python scripts/bench_accuracy.py [--only digit] [--qualities draft default]

A reference takes minutes: its meshes have five to ten times the nodes.
"""

import argparse
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"

from tacgen.bench import accuracy  # noqa: E402


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="scenes whose name holds this")
    parser.add_argument("--qualities", nargs="+", default=["default"])
    asked = parser.parse_args()
    print(accuracy.HEADER)
    names = [name for name in accuracy.SCENES if asked.only in name]
    for line in accuracy.table(names, asked.qualities):
        print(line, flush=True)


if __name__ == "__main__":
    main()
