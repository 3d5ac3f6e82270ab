"""Extreme scenes, and random ones, solved one after the other: how each ends, in how many iterations, how well.

    python scripts/bench_stability.py [--only TEXT] [--random 20 --seed 0]

Ends with 1 if a scene was rejected on the way; one that is refused before it is solved is an answer.
"""

import argparse
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"

import numpy as np  # noqa: E402

from tacgen.bench import stability  # noqa: E402


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="cases whose name holds this")
    parser.add_argument("--random", type=int, default=0, help="so many random scenes instead")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    print(stability.HEADER)
    failed = 0
    cases = stability.CASES
    if asked.random:
        points = np.random.default_rng(asked.seed).random((asked.random, stability.RANDOM))
        cases = {f"random {asked.seed}.{i}": stability.random(u.tolist()) for i, u in enumerate(points)}
    for name, sets in cases.items():
        if asked.only in name:
            found = stability.measure(name, sets)
            failed += found.status == "rejected"
            print(found.line(), flush=True)
    raise SystemExit(1 if failed else 0)


if __name__ == "__main__":
    main()
