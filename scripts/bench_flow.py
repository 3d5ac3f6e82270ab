"""Markers and flow under a press and a shear of 0.5 mm, against Mitsuba's paths to the same face, in pixels.

python scripts/bench_flow.py [--only digit] [--spp 256]
"""

import argparse
from typing import cast

from tacgen.bench import flow
from tacgen.image import variants
from tacgen.spec.sensor import LitSensor


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="sensors whose name holds this")
    parser.add_argument("--quality", default="draft", help="of the solve")
    parser.add_argument("--spp", type=int, default=256, help="paths a pixel")
    asked = parser.parse_args()
    print(f"{'sensor':<15} {'moved':>7} {'markers rms':>12} {'most':>7} {'flow rms':>9} {'most':>7}  [px]")
    for name in (name for name in flow.DEPTHS if asked.only in name):
        sensor, untouched, moved = flow.sheared(name, asked.quality)
        found = flow.measure(cast(LitSensor, sensor), untouched, moved, variants.best().variant, asked.spp)
        print(
            f"{name:<15} {found[0]:7.2f} {found[1]:12.4f} {found[2]:7.4f} {found[3]:9.4f} {found[4]:7.4f}", flush=True
        )


if __name__ == "__main__":
    main()
