"""Rendered sensors beside photographs of real ones: the picture, and the numbers that must agree.

    python scripts/compare.py gelsight_mini|digit|ninedtact [../shared/reference/SENSOR] [-o out/compare_SENSOR.png]

Where the folder of photographs is absent it says so and stops with exit code 0.
"""

import argparse
import csv
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from calibrate_optics import DIGIT, DIGIT_BALL, NINE_PRESS
from PIL import Image
from ruamel.yaml import YAML
from skimage.metrics import structural_similarity

from tacgen import render
from tacgen.calibrate import photos, under
from tacgen.optics.dent import BallDent
from tacgen.optics.layers import Camera
from tacgen.spec.sensor import Sensor

ROOT = Path(__file__).resolve().parents[1]
SHOWN = ("ball_6.310mm_20.png", "ball_6.310mm_8.png", "ball_6.310mm_12.png", "ball_9.500mm_1.png")
DIGIT_REACH = 60  # [px] around a dent within which pictures are compared
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


def beside_mini(folder: Path, sensor: Sensor, renderer: render.Renderer) -> list[np.ndarray]:
    """The Mini's dents: their likeness, and how colours turn with the slope."""
    camera, strips = Camera.from_sensor(sensor), []
    real, made = load(folder / "background.png"), renderer.develop(renderer.flat())
    fits: list[tuple[np.ndarray, np.ndarray]] = []
    for press in presses(folder):
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
    return strips


def digit_press(folder: Path, name: str) -> photos.Press:
    """One of DIGIT's photographed presses."""
    x, y, contact = DIGIT[name]
    return photos.Press(name, load(folder / name), DIGIT_BALL, (x, y), contact, None)


def beside_digit(folder: Path, sensor: Sensor, renderer: render.Renderer) -> list[np.ndarray]:
    """DIGIT's dents, with their shadow fans."""
    strips = []
    for name, (x, y, _) in DIGIT.items():
        press = digit_press(folder, name)
        real, made = press.picture, renderer.develop(renderer.image(under.face(sensor, press, {})))
        down, across = np.mgrid[: real.shape[0], : real.shape[1]] + 0.5
        near = np.hypot(across - x, down - y) < DIGIT_REACH
        print(f"{name:24s} dent SSIM {similarity(real, made, near):.3f}")
        strips.append(np.hstack([real, made]))
    return strips


def nine_press(folder: Path) -> photos.Press:
    """9DTact's photographed press."""
    name, ball, x, y, depth = NINE_PRESS
    return photos.Press(name, load(folder / name), ball, (x, y), None, depth)


def profile(change: np.ndarray, middle: tuple[float, float], mm_per_px: float) -> np.ndarray:
    """Mean change [counts] of a picture (h, w) in rings of 0.2 mm to 9 mm around a place [px]."""
    y, x = np.mgrid[: change.shape[0], : change.shape[1]] + 0.5
    ring = (np.hypot(x - middle[0], y - middle[1]) * mm_per_px / 0.2).astype(int)
    sums, count = (np.bincount(ring.ravel(), w, 45)[:45] for w in (change.ravel(), np.ones(change.size)))
    return np.asarray(sums / count)


def beside_nine(folder: Path, sensor: Sensor, renderer: render.Renderer) -> list[np.ndarray]:
    """9DTact's ball: the dark disc and its halo."""
    real0, press = load(folder / UNTOUCHED["ninedtact"]), nine_press(folder)
    real, face = press.picture, under.face(sensor, press, {})
    made0, made = (renderer.develop(r) for r in (renderer.flat(), renderer.image(face)))
    where = np.ones(real.shape[:2], bool)
    level = np.clip(made.astype(int) - made0 + real0, 0, 255).astype(np.uint8)
    print(f"press SSIM {similarity(real, made, where):.4f}, on the unit's own background "
          f"{similarity(real, level, where):.4f}")  # fmt: skip
    grey, rendered = real.mean(axis=2) - real0.mean(axis=2), made.mean(axis=2) - made0.mean(axis=2)
    a, b = (profile(c, press.center, sensor.camera.mm_per_px) for c in (grey, rendered))
    print(
        "radius [mm]:change of grey, real/rendered",
        *(f"{0.2 * k + 0.1:.1f}:{a[k]:.0f}/{b[k]:.0f}" for k in range(0, 45, 4)),
    )
    print(f"radial profile {100 * np.sqrt(np.mean((a - b) ** 2)) / np.abs(a).max():.1f} % of its peak off (rms)")
    return [np.hstack([real, made])]


BESIDE = {"gelsight_mini": beside_mini, "digit": beside_digit, "ninedtact": beside_nine}
UNTOUCHED = {"ninedtact": "reference_rectified.png"}


def main() -> int:
    """Render, compare, write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sensor", choices=BESIDE)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("-o", "--out", type=Path)
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--file", type=Path, help="the sensor file; the shipped one if not given")
    asked = parser.parse_args()
    folder = asked.folder or ROOT.parent / "shared/reference" / asked.sensor
    first = folder / UNTOUCHED.get(asked.sensor, "background.png")
    if not first.is_file():
        print(f"{folder}: no photographs here, nothing to compare with")
        return 0
    file = asked.file or ROOT / "sensors" / f"{asked.sensor}.yaml"
    sensor = Sensor.model_validate(YAML(typ="safe").load(file.read_text()))
    renderer = render.Renderer(sensor, asked.spp, 0, markers=False)
    real, made = load(first), renderer.develop(renderer.flat())
    table([("background mean (R, G, B)", real.mean(axis=(0, 1)), made.mean(axis=(0, 1)))])
    print(f"background SSIM {similarity(real, made, np.ones(real.shape[:2], bool)):.3f}")
    strips = [np.hstack([real, made]), *BESIDE[asked.sensor](folder, sensor, renderer)]
    out = asked.out or ROOT / "out" / f"compare_{asked.sensor}.png"
    out.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.vstack(strips)).save(out)
    print(f"{out}: real left, rendered right (variant {renderer.variant})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
