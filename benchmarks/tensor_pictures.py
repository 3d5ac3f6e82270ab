"""Camera pictures drawn on a GPU beside the CPU's: error and time.

    python -m benchmarks.tensor_pictures [--sensors gelsight_mini digit] [--quality draft default] [--frames 10]

Dents of balls at random places (optics/hertz_dent), without solving. Printed for each sensor and quality: milliseconds
a frame of one core and of the GPU, which draws some scenes of so many frames one after the other; the largest
difference of light where the CPU computes every sample as the GPU does, over the largest light; and, in counts of 8
bits without noise, how far from those the CPU's pictures as it ships them, interpolated, and the GPU's are.
"""

import argparse
import time
from collections.abc import Sequence

import numpy as np
import torch

from tacgen.optics.adaptive_sampling import SamplingTolerance
from tacgen.optics.hertz_dent import BallDent
from tacgen.optics.surface_grid import Surface
from tacgen.recipe import plan
from tacgen.recipe.assets import recipe_path
from tacgen.render.images import Clear, Renderer
from tacgen.tensor_optics.drawing import Drawing

Array = np.ndarray
EVERYWHERE = SamplingTolerance(1, 0.0, 0.0)  # no sample is interpolated
SCENES = 20  # drawn on the GPU for its time


def main() -> None:
    told = arguments()
    if told.device.startswith("cuda") and not torch.cuda.is_available():
        raise SystemExit("PyTorch finds no GPU that it can use")
    print("sensor, quality: ms a frame of a core, of the GPU; difference of light; counts off, mean and most: CPU, GPU")
    for sensor in told.sensors:
        for quality in told.quality:
            print(f"{sensor}, {quality}: {compared(sensor, quality, told.frames, told.device)}", flush=True)


def arguments() -> argparse.Namespace:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--sensors", nargs="*", default=("gelsight_mini", "digit", "gelsight_r15"))
    ask.add_argument("--quality", nargs="*", default=("draft", "default"))
    ask.add_argument("--frames", type=int, default=10, help="of a scene")
    ask.add_argument("--device", default="cuda")
    return ask.parse_args()


def compared(sensor: str, quality: str, count: int, device: str) -> str:
    """A line on so many frames of a sensor."""
    asked = [f"sensor={sensor}", f"quality={quality}", "outputs=[force, rgb]"]
    (row,) = plan.load(recipe_path("quickstart"), asked).rows
    lit = row.sensor
    renderer = Renderer(lit, row.recipe.resolved().spp, 0, lit.markers is not None)  # type: ignore[arg-type]
    if not isinstance(renderer.light, Clear):
        return "not drawn on a GPU"
    direct = renderer.light.direct
    faces = dents(renderer.untouched, count)
    renderer.image(faces[0])  # compiles it
    started = time.perf_counter()
    shipped = [renderer.image(face) for face in faces]
    alone = (time.perf_counter() - started) / count
    tolerance, direct.tolerance = direct.tolerance, EVERYWHERE
    exact = np.array([renderer.image(face) for face in faces])
    direct.tolerance = tolerance
    drawing = Drawing(direct, renderer.light.glow, renderer.stray, renderer.texture, device)
    nodes = np.stack([renderer.sheet.at(face) for face in faces])
    drawn = drawing.radiance(nodes)
    counts = drawing.developed(drawn, [None] * count, [None] * count).astype(int)
    started = time.perf_counter()
    for _ in range(SCENES):
        drawing.developed(drawing.radiance(nodes), [None] * count, [None] * count)
    each = (time.perf_counter() - started) / (SCENES * count)
    light = np.abs(drawn.cpu().numpy() - exact).max() / exact.max()
    right = developed(renderer, exact)
    mine, theirs = np.abs(developed(renderer, shipped) - right), np.abs(counts - right)
    return (
        f"{1e3 * alone:.1f} ms, {1e3 * each:.2f} ms; {light:.1e};"
        f" {mine.mean():.3f} and {mine.max()}, {theirs.mean():.5f} and {theirs.max()}; {memory(device)}"
    )


def dents(untouched: Surface, count: int) -> list[BallDent]:
    """Faces under balls at random places."""
    random = np.random.default_rng(0)
    return [
        BallDent(radius, share * radius, (x, y), untouched)
        for radius, share, x, y in random.uniform([2.5, 0.2, -3, -3], [5.0, 0.6, 3, 3], (count, 4))
    ]


def developed(renderer: Renderer, light: "Sequence[Array] | Array") -> Array:
    """Counts (F, H, W, 3) without noise."""
    return np.array([renderer.develop(each) for each in light]).astype(int)


def memory(device: str) -> str:
    """The most memory of a GPU in use so far."""
    return f"{torch.cuda.max_memory_allocated() / 1e6:.0f} MB" if device.startswith("cuda") else "no GPU"


if __name__ == "__main__":
    main()
