"""Compare Mitsuba's variants: seconds of a traced image on the processor, and on a GPU if there is one.

    python scripts/bench_variants.py [--spp 16 256 4096] [--sensors digit]

A ball's dent at the sensor's own resolution. The first image of a size compiles its kernels and is timed separately; of
three more, the shortest and the longest time are printed. The variants use different random paths, so images agree
within their noise: the last column is the difference of the mean radiance from the first variant, and its noise.
"""

import argparse
import statistics
import time

import numpy as np

from tacgen.optics.hertz_dent import BallDent
from tacgen.optics.surface_grid import Sheet, Untouched
from tacgen.recipe import assets, plan
from tacgen.render import mitsuba_variants
from tacgen.render.mitsuba_path import PathTracer


def timed(tracer: PathTracer, nodes: np.ndarray, spp: int, seed: int) -> tuple[float, np.ndarray]:
    """Wall-clock seconds of a picture, and the picture."""
    start = time.perf_counter()
    picture = tracer.render(nodes, spp, seed)
    return time.perf_counter() - start, picture


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensors", nargs="*", default=assets.list_sensors())
    parser.add_argument("--spp", nargs="*", type=int, default=[16, 256])
    asked = parser.parse_args()
    print(f"{'sensor':<15}{'variant':<14}{'spp':>6}{'first':>9}{'then':>18}  mean light")
    for name in asked.sensors:
        sensor = plan.load(assets.recipe_path("quickstart"), (f"sensor={name}", "outputs=[force]")).rows[0].sensor
        sheet, untouched = Sheet.over(sensor.gel, 0.1), Untouched.of(sensor.gel)
        nodes, first = sheet.at(BallDent(4.0, 1.5, face=untouched)), {}
        for found in mitsuba_variants.variants():
            if not found.works:
                continue
            tracer = PathTracer(sensor, sheet, False, found.variant)
            for spp in asked.spp:
                compiled, _ = timed(tracer, nodes, spp, 0)
                seconds, pictures = zip(*(timed(tracer, nodes, spp, seed) for seed in (1, 2, 3)), strict=True)
                light = [picture.mean() for picture in pictures]
                mean, noise = statistics.mean(light), statistics.stdev(light) / 3**0.5
                before = first.setdefault(spp, (mean, noise))
                off, sure = mean / before[0] - 1, np.hypot(noise, before[1]) / before[0]
                then = f"{min(seconds):.3f} to {max(seconds):.3f}"
                print(
                    f"{name:<15}{found.variant:<14}{spp:>6}{compiled:>9.2f}{then:>18}  {off:+.3%}, noise {sure:.3%}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
