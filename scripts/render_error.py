"""How far pictures are from Mitsuba's `path`, and how long they take, for every method and setting.

    python scripts/render_error.py [--sensors digit] [--faces ball] [--spp 1024] [--shrink 2] [-o out/optics]

Writes a table, JSON, error against time as a picture, and with --pictures each picture beside its reference.
"""

import argparse
import os
import platform
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"

from tacgen.bench import optics  # noqa: E402
from tacgen.image import variants  # noqa: E402


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensors", nargs="+", default=list(optics.DEPTHS), choices=list(optics.DEPTHS))
    parser.add_argument("--faces", nargs="+", default=list(optics.FACES), choices=list(optics.FACES))
    parser.add_argument("--variant", default=None, help="Mitsuba variant; the best one here if not given")
    parser.add_argument("--spp", type=int, default=1024, help="paths a pixel in each half of the reference")
    parser.add_argument("--shrink", type=int, default=4, help="divide the picture's width and height by this")
    parser.add_argument("--only", default="", help="ways whose name holds this, as in 'transport draft'")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/optics"))
    parser.add_argument("--pictures", action="store_true")
    asked = parser.parse_args()
    variant = asked.variant or variants.best().variant
    ways = [way for way in optics.WAYS if asked.only in " ".join(way)]
    print(f"{variant}, reference 2 x {asked.spp} paths a pixel\n{optics.HEADER}")
    outcomes = []
    for outcome, picture, truth in optics.measure(asked.sensors, asked.faces, asked.spp, asked.shrink, ways, variant):
        outcomes.append(outcome)
        print(outcome.line(), flush=True)
        if asked.pictures:
            optics.beside(picture, truth, asked.out / f"{outcome.name}.png")
    optics.write(outcomes, asked.out, {"variant": variant, "spp": asked.spp, "machine": platform.processor()})
    print(f"written to {asked.out}")


if __name__ == "__main__":
    main()
