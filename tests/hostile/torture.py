"""`make torture`: many hostile inputs and kills, and a table of what became of them.

python -m hostile.torture --inputs 10000 --kills 1000
"""

import argparse
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from hostile import attempts, kills
from hostile.mutations import MUTATIONS


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=10_000, help="shared by all kinds of damage")
    parser.add_argument("--kills", type=int, default=1_000)
    parser.add_argument("--first", type=int, default=0, help="seed to begin with")
    args = parser.parse_args()
    start, bad = time.monotonic(), 0
    with tempfile.TemporaryDirectory() as scratch:
        source = attempts.inputs(attempts.base(Path(scratch)))
        each = args.inputs // len(MUTATIONS)
        work: dict[str, tuple[int, Callable[[int], attempts.Attempt]]] = {
            kind: (each, lambda seed, kind=kind: attempts.attempt(kind, seed, source)) for kind in sorted(MUTATIONS)
        }
        work["kill"] = (args.kills, lambda seed: kills.kill(seed, source))
        rows = []
        for kind, (number, attempt) in work.items():
            count: Counter[str] = Counter()
            for seed in range(args.first, args.first + number):
                found = attempt(seed)
                count[found.outcome] += 1
                if found.outcome not in attempts.GOOD:
                    bad += 1
                    print(found, file=sys.stderr, flush=True)
            rows.append([kind, count.total(), *(count[name] for name in attempts.OUTCOMES)])
    print("| kind | tried | " + " | ".join(attempts.OUTCOMES) + " |")
    print("|---" * (len(attempts.OUTCOMES) + 2) + "|")
    for row in rows:
        print("| " + " | ".join(map(str, row)) + " |")
    print(f"\n{time.monotonic() - start:.0f} s, seeds from {args.first}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
