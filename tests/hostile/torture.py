"""`make torture`: many hostile inputs, and a table of what became of them.

python -m hostile.torture --inputs 10000
"""

import argparse
import sys
import tempfile
from collections import Counter
from pathlib import Path

from hostile import attempts
from hostile.mutations import MUTATIONS


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", nargs="*", default=sorted(MUTATIONS))
    args = parser.parse_args()
    count: dict[str, Counter[str]] = {}
    seen: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as scratch:
        source = attempts.base(Path(scratch))
        for reader in attempts.READERS.values():
            reader(source / "loose") if reader is not attempts.READERS["pack"] else None
        for kind in args.kinds:
            count[kind] = Counter()
            for seed in range(args.first, args.first + args.inputs // len(args.kinds)):
                found = attempts.attempt(kind, seed, source)
                count[kind][found.outcome] += 1
                if found.outcome not in ("accepted", "refused"):
                    seen[found.detail.partition(" at ")[2] or found.detail or found.outcome] += 1
                    print(found, flush=True)
    print("| kind | tried | " + " | ".join(attempts.OUTCOMES) + " |")
    for kind, outcome in count.items():
        print(f"| {kind} | {outcome.total()} | " + " | ".join(str(outcome[name]) for name in attempts.OUTCOMES) + " |")
    for place, n in seen.most_common():
        print(n, place, file=sys.stderr)
    return 1 if seen else 0


if __name__ == "__main__":
    sys.exit(main())
