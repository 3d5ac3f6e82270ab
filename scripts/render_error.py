"""How far the renderer's pictures are from Mitsuba's `path`, and how long they take.

    python scripts/render_error.py [--variant llvm_ad_rgb] [--spp 1024] [--shrink 2]

PSNR in dB on the developed sRGB picture (before rounding), the reference's own noise, known from two independent
halves, taken off the mean square error. Brute force is shown beside it.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from ruamel.yaml import YAML

from tacgen import render
from tacgen.optics import response
from tacgen.optics.dent import BallDent
from tacgen.optics.direct import Direct
from tacgen.optics.sheet import Untouched
from tacgen.sensor import Sensor
from tacgen.tracer import PathTracer

ROOT = Path(__file__).resolve().parents[1]
FACES = {"untouched": Untouched(), "ball R 4": BallDent(4.0, 1.9), "ball R 1, sharp": BallDent(1.0, 0.85, (2.0, -1.0))}


def decibel(picture: np.ndarray, halves: np.ndarray) -> tuple[float, float]:
    """(corrected, plain) PSNR [dB] of a picture (H, W, 3) in [0, 1] against the mean of two halves (2, H, W, 3)."""
    error = np.mean((picture - halves.mean(axis=0)) ** 2)
    noise = np.mean((halves[0] - halves[1]) ** 2) / 4
    return tuple(float(-10 * np.log10(max(e, 1e-9))) for e in (error - noise, error))


def timed(work: Callable[[], np.ndarray]) -> tuple[np.ndarray, float]:
    """What `work` gives on its second call, and that call's seconds (the first one compiles)."""
    work()
    start = time.perf_counter()
    return work(), time.perf_counter() - start


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sensor", type=Path, default=ROOT / "sensors" / "gelsight_mini.yaml")
    parser.add_argument("--variant", default=None, help="Mitsuba variant; the best one here if not given")
    parser.add_argument("--spp", type=int, default=1024, help="paths a pixel in each half of the reference")
    parser.add_argument("--shrink", type=int, default=2, help="divide the picture's width and height by this")
    asked = parser.parse_args()
    sensor = Sensor.model_validate(YAML(typ="safe").load(asked.sensor.read_text()))
    eye = sensor.camera
    camera = eye.model_copy(
        update={
            "width_px": eye.width_px // asked.shrink, "height_px": eye.height_px // asked.shrink,
            "mm_per_px": eye.mm_per_px * asked.shrink,
        }
    )  # fmt: skip
    sensor = sensor.model_copy(update={"camera": camera})
    renderer = render.Renderer(sensor, 64, 0, False, asked.variant)
    tracer = PathTracer(sensor, renderer.sheet, False, renderer.variant)
    alone = Direct(sensor, renderer.sheet, False, render.effort(64)[0])

    stray = response.stray(camera)

    def shown(radiance: np.ndarray) -> np.ndarray:
        return response.srgb(response.expose(radiance, camera))

    print(f"{camera.width_px} x {camera.height_px}, {renderer.variant}, reference 2 x {asked.spp} spp")
    print(f"{'face':18s} {'method':32s} {'dB':>6s} {'(plain)':>8s} {'s':>7s}")
    for name, face in FACES.items():
        halves = np.array([shown(tracer.radiance(face, asked.spp, seed) + stray) for seed in (11, 12)])
        methods: dict[str, Callable[[], np.ndarray]] = {
            "path, 16 spp": lambda face=face: tracer.radiance(face, 16, 1) + stray,
            "path, 64 spp": lambda face=face: tracer.radiance(face, 64, 1) + stray,
            "direct + mirror images": lambda face=face: alone.radiance(face) + stray,
            "the same + map of scattered": lambda face=face: renderer.image(face).astype(float),
        }
        for method, work in methods.items():
            picture, seconds = timed(work)
            corrected, plain = decibel(shown(picture), halves)
            print(f"{name:18s} {method:32s} {corrected:6.1f} {plain:8.1f} {seconds:7.2f}", flush=True)


if __name__ == "__main__":
    main()
