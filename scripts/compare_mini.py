"""Rendered GelSight Mini beside photographs of a real one: the picture, and the numbers that must agree.

    python scripts/compare_mini.py [../shared/reference/gelsight_mini] [-o out/compare_mini.png]

Where the folder of photographs is absent it says so and stops with exit code 0.
"""

import argparse
import csv
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from ruamel.yaml import YAML
from skimage.metrics import structural_similarity

from tacgen import render
from tacgen.optics.dent import BallDent
from tacgen.optics.layers import Camera
from tacgen.sensor import Sensor

ROOT = Path(__file__).resolve().parents[1]
SHOWN = ("ball_6.310mm_20.png", "ball_6.310mm_8.png", "ball_6.310mm_12.png", "ball_9.500mm_1.png")
MARGIN = 1.7  # contact radii around a dent within which pictures are compared


@dataclass(frozen=True)
class Press:
    """A photographed ball press."""

    name: str
    picture: np.ndarray  # (H, W, 3) uint8
    center: tuple[float, float]  # of the contact circle [px]
    contact: float  # its radius [px]
    ball: float  # radius [mm]

    def near(self, reach: float) -> np.ndarray:
        """Pixels within `reach` contact radii of the dent's middle, (H, W) bool."""
        y, x = np.mgrid[: self.picture.shape[0], : self.picture.shape[1]] + 0.5
        return np.hypot(x - self.center[0], y - self.center[1]) < reach * self.contact


def load(path: Path) -> np.ndarray:
    """An 8-bit RGB picture (H, W, 3)."""
    return np.asarray(Image.open(path).convert("RGB"))


def presses(folder: Path) -> list[Press]:
    """Every press of the folder's circles.csv."""
    return [
        Press(
            row["image"], load(folder / row["image"]), (float(row["cx_px"]), float(row["cy_px"])),
            float(row["contact_radius_px"]), float(row["ball_diameter_mm"]) / 2,
        )
        for row in csv.DictReader((folder / "circles.csv").read_text().splitlines())
    ]  # fmt: skip


def slopes(picture: np.ndarray, untouched: np.ndarray, press: Press, mm_per_px: float) -> np.ndarray:
    """Change of colour [counts] per unit slope of the ball's surface inside the contact circle: rows R, G, B, columns
    offset, along x, along y. The slope is (x, y) from the dent's middle over the ball's radius."""
    y, x = (np.mgrid[: picture.shape[0], : picture.shape[1]] + 0.5) * mm_per_px
    inside = press.near(0.95)
    u = (x[inside] - press.center[0] * mm_per_px) / press.ball
    v = (y[inside] - press.center[1] * mm_per_px) / press.ball
    change = picture[inside].astype(float) - untouched[inside]
    return np.asarray(np.linalg.lstsq(np.column_stack([np.ones_like(u), u, v]), change, rcond=None)[0].T)


def similarity(a: np.ndarray, b: np.ndarray, where: np.ndarray) -> float:
    """Mean structural similarity of two 8-bit pictures over some pixels."""
    full = structural_similarity(a, b, channel_axis=2, full=True, gaussian_weights=True, sigma=1.5, data_range=255)[1]
    return float(full.mean(axis=2)[where].mean())


def table(rows: list[tuple[str, np.ndarray, np.ndarray]]) -> None:
    """Print real and rendered triples side by side."""
    for name, real, made in rows:
        print(f"{name:34s} real {_three(real)}   rendered {_three(made)}")


def _three(values: np.ndarray) -> str:
    return " ".join(f"{v:7.1f}" for v in values)


def main() -> int:
    """Render, compare, write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=ROOT.parent / "shared/reference/gelsight_mini")
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "out" / "compare_mini.png")
    parser.add_argument("--sensor", type=Path, default=ROOT / "sensors" / "gelsight_mini.yaml")
    parser.add_argument("--spp", type=int, default=64)
    asked = parser.parse_args()
    if not (asked.folder / "background.png").is_file():
        print(f"{asked.folder}: no photographs here, nothing to compare with")
        return 0
    sensor = Sensor.model_validate(YAML(typ="safe").load(asked.sensor.read_text()))
    camera, renderer = Camera.from_sensor(sensor), render.Renderer(sensor, asked.spp, 0, markers=False)
    real, made = load(asked.folder / "background.png"), renderer.develop(renderer.flat())
    everywhere = np.ones(real.shape[:2], bool)
    table([("background mean (R, G, B)", real.mean(axis=(0, 1)), made.mean(axis=(0, 1)))])
    print(f"background SSIM {similarity(real, made, everywhere):.3f}")
    fits: list[tuple[np.ndarray, np.ndarray]] = []
    strips = [np.hstack([real, made])]
    for press in presses(asked.folder):
        dent = BallDent.seen(camera, press.ball, press.center, press.contact)
        dented = renderer.develop(renderer.image(dent))
        fits.append((slopes(press.picture, real, press, camera.mm_per_px),
                     slopes(dented, made, press, camera.mm_per_px)))  # fmt: skip
        ssim = similarity(press.picture, dented, press.near(MARGIN))
        level = np.clip(dented.astype(int) - made + real, 0, 255).astype(np.uint8)  # on the unit's own background
        own = similarity(press.picture, level, press.near(MARGIN))
        print(f"{press.name:24s} dent SSIM {ssim:.3f}, on the unit's own background {own:.3f}")
        if press.name in SHOWN:
            strips.append(np.hstack([press.picture, dented]))
    for k, along in ((1, "x"), (2, "y")):
        a, b = (np.median([f[i][:, k] for f in fits], axis=0) for i in (0, 1))
        table([(f"counts per slope along {along} (R, G, B)", a, b)])
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.vstack(strips)).save(asked.out)
    print(f"{asked.out}: real left, rendered right (variant {renderer.variant})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
