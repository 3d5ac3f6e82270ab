"""Rendered sensors beside photographs of real ones: the picture, and the numbers that must agree.

    python scripts/compare.py [gelsight_mini|digit|ninedtact] [--photos ../shared/reference] [-o out] [--results docs]

Without a sensor, all of them; `--results` puts the numbers into the page of results, as `make bench` does. Where the
photographs are absent it says so and stops with exit code 0.
"""

import argparse
import csv
import sys
import time
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
from calibrate_optics import DIGIT, DIGIT_BALL, NINE_PRESS
from PIL import Image
from ruamel.yaml import YAML
from skimage.metrics import structural_similarity

from tacgen.calibrate import photos, press_faces
from tacgen.optics.camera import Camera
from tacgen.optics.hertz_dent import BallDent
from tacgen.recipe.background_photo import read as load
from tacgen.recipe.sensor import Sensor
from tacgen.render import images

ROOT = Path(__file__).resolve().parents[1]
SHOWN = ("ball_6.310mm_20.png", "ball_6.310mm_8.png", "ball_6.310mm_12.png", "ball_9.500mm_1.png")
DIGIT_REACH = 60  # [px] around a dent within which pictures are compared
ABOUT = (
    "Rendered pictures beside photographs of one real unit a sensor, to some of which its lights were fitted"
    " (docs/OPTICS.md says how): structural similarity, 1 where they are the same, also with the rendered change put on"
    " the unit's own untouched photograph; and colours in counts of 255."
)
MARGIN = 1.7  # contact radii around a dent within which pictures are compared


@dataclass(frozen=True)
class Likeness:
    """One thing that is compared: structural similarity, as rendered and on the unit's own untouched photograph, or a
    number of the photograph and of the rendering."""

    what: str
    ssim: float | None = None
    own: float | None = None
    real: str = ""
    made: str = ""

    def __str__(self) -> str:
        similar = "" if self.ssim is None else f"SSIM {self.ssim:.4f} "
        own = "" if self.own is None else f"on its own background {self.own:.4f}"
        numbers = f"real {self.real}   rendered {self.made}" if self.real else ""
        return f"{self.what:44s} {similar}{own}{numbers}"


Beside = tuple[list[np.ndarray], list[Likeness]]  # strips of a picture, real left and rendered right


def near(press: photos.Press, reach: float) -> np.ndarray:
    """Pixels within `reach` contact radii of the dent's middle, (H, W) bool."""
    assert press.contact is not None
    y, x = np.mgrid[: press.picture.shape[0], : press.picture.shape[1]] + 0.5
    return np.hypot(x - press.center[0], y - press.center[1]) < reach * press.contact


def presses(folder: Path) -> list[photos.Press]:
    """Every press of the folder's circles.csv."""
    return [
        photos.Press(
            row["image"], load(folder / row["image"]), float(row["ball_diameter_mm"]) / 2,
            (float(row["cx_px"]), float(row["cy_px"])), float(row["contact_radius_px"]), None,
        )
        for row in csv.DictReader((folder / "circles.csv").read_text().splitlines())
    ]  # fmt: skip


def slopes(picture: np.ndarray, untouched: np.ndarray, press: photos.Press, mm_per_px: float) -> np.ndarray:
    """Change of colour [counts] per unit slope of the ball's surface inside the contact circle: rows R, G, B, columns
    offset, along x, along y. The slope is (x, y) from the dent's middle over the ball's radius."""
    y, x = (np.mgrid[: picture.shape[0], : picture.shape[1]] + 0.5) * mm_per_px
    inside = near(press, 0.95)
    u = (x[inside] - press.center[0] * mm_per_px) / press.ball
    v = (y[inside] - press.center[1] * mm_per_px) / press.ball
    change = picture[inside].astype(float) - untouched[inside]
    return np.asarray(np.linalg.lstsq(np.column_stack([np.ones_like(u), u, v]), change, rcond=None)[0].T)


def similarity(a: np.ndarray, b: np.ndarray, where: np.ndarray) -> float:
    """Mean structural similarity of two 8-bit pictures over some pixels."""
    full = structural_similarity(a, b, channel_axis=2, full=True, gaussian_weights=True, sigma=1.5, data_range=255)[1]
    return float(full.mean(axis=2)[where].mean())


def three(what: str, real: np.ndarray, made: np.ndarray) -> Likeness:
    """Of red, green and blue."""
    return Likeness(what, None, None, *(" / ".join(f"{v:.1f}" for v in rgb) for rgb in (real, made)))


def beside_mini(folder: Path, sensor: Sensor, renderer: images.Renderer) -> Beside:
    """The Mini's dents: their likeness, and how colours turn with the slope."""
    camera, strips, found = Camera.from_sensor(sensor), list[np.ndarray](), list[Likeness]()
    real, made = load(folder / "background.png"), renderer.develop(renderer.flat())
    fits: list[tuple[np.ndarray, np.ndarray]] = []
    for press in presses(folder):
        dent = BallDent.seen(camera, press.ball, press.center, press.contact)
        dented = renderer.develop(renderer.image(dent))
        fits.append((slopes(press.picture, real, press, camera.mm_per_px),
                     slopes(dented, made, press, camera.mm_per_px)))  # fmt: skip
        ssim = similarity(press.picture, dented, near(press, MARGIN))
        level = np.clip(dented.astype(int) - made + real, 0, 255).astype(np.uint8)  # on the unit's own background
        own = similarity(press.picture, level, near(press, MARGIN))
        found.append(Likeness(f"around the dent of {press.name}", ssim, own))
        if press.name in SHOWN:
            strips.append(np.hstack([press.picture, dented]))
    for k, along in ((1, "x"), (2, "y")):
        a, b = (np.median([f[i][:, k] for f in fits], axis=0) for i in (0, 1))
        found.append(three(f"red / green / blue, counts per slope along {along}", a, b))
    return strips, found


def digit_press(folder: Path, name: str) -> photos.Press:
    """One of DIGIT's photographed presses."""
    x, y, contact = DIGIT[name]
    return photos.Press(name, load(folder / name), DIGIT_BALL, (x, y), contact, None)


def beside_digit(folder: Path, sensor: Sensor, renderer: images.Renderer) -> Beside:
    """DIGIT's dents, with their shadow fans."""
    strips, found = list[np.ndarray](), list[Likeness]()
    for name, (x, y, _) in DIGIT.items():
        press = digit_press(folder, name)
        real, made = press.picture, renderer.develop(renderer.image(press_faces.face(sensor, press, {})))
        down, across = np.mgrid[: real.shape[0], : real.shape[1]] + 0.5
        around = np.hypot(across - x, down - y) < DIGIT_REACH
        found.append(Likeness(f"around the dent of {name}", similarity(real, made, around)))
        strips.append(np.hstack([real, made]))
    return strips, found


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


def beside_nine(folder: Path, sensor: Sensor, renderer: images.Renderer) -> Beside:
    """9DTact's ball: the dark disc and its halo."""
    real0, press = load(folder / UNTOUCHED["ninedtact"]), nine_press(folder)
    real, face = press.picture, press_faces.face(sensor, press, {})
    made0, made = (renderer.develop(r) for r in (renderer.flat(), renderer.image(face)))
    where = np.ones(real.shape[:2], bool)
    level = np.clip(made.astype(int) - made0 + real0, 0, 255).astype(np.uint8)
    found = [Likeness(f"whole picture of {press.name}", similarity(real, made, where), similarity(real, level, where))]
    grey, rendered = real.mean(axis=2) - real0.mean(axis=2), made.mean(axis=2) - made0.mean(axis=2)
    a, b = (profile(c, press.center, sensor.camera.mm_per_px) for c in (grey, rendered))
    rings = [2, 10, 20, 30, 44]
    at = " / ".join(f"{0.2 * k + 0.1:.1f}" for k in rings)
    found.append(Likeness(f"change of grey {at} mm from the middle", None, None,
                          *(" / ".join(f"{c[k]:.1f}" for k in rings) for c in (a, b))))  # fmt: skip
    off = np.sqrt(np.mean((a - b) ** 2)) / np.abs(a).max()
    found.append(Likeness("its radial profile, rms off, of the peak", None, None, "0", f"{off:.1%}"))
    return [np.hstack([real, made])], found


BESIDE = {"gelsight_mini": beside_mini, "digit": beside_digit, "ninedtact": beside_nine}
UNTOUCHED = {"ninedtact": "reference_rectified.png"}


def beside(name: str, folder: Path, sensor: Sensor, spp: int) -> Beside:
    """A sensor's pictures, and how like the photographs of `folder` they are."""
    renderer = images.Renderer(sensor, spp, 0, markers=False)
    real, made = load(folder / UNTOUCHED.get(name, "background.png")), renderer.develop(renderer.flat())
    strips, found = BESIDE[name](folder, sensor, renderer)
    mean = three("untouched, mean red / green / blue", real.mean(axis=(0, 1)), made.mean(axis=(0, 1)))
    alike = Likeness("untouched", similarity(real, made, np.ones(real.shape[:2], bool)))
    return [np.hstack([real, made]), *strips], [mean, alike, *found]


def main() -> int:
    """Render, compare, write the pictures and what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sensor", choices=BESIDE, nargs="?")
    parser.add_argument("--photos", type=Path, default=ROOT.parent / "shared/reference", help="a folder a sensor in it")
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "out", help="where compare_SENSOR.png goes")
    parser.add_argument("--results", type=Path, help="a folder with RESULTS.md")
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--file", type=Path, help="the sensor file; the shipped one if not given")
    asked = parser.parse_args()
    rows: list[list[str | float | int | None]] = []
    started = time.perf_counter()
    for name in [asked.sensor] if asked.sensor else BESIDE:
        folder = asked.photos / name
        if not (folder / UNTOUCHED.get(name, "background.png")).is_file():
            print(f"{folder}: no photographs here, nothing to compare with")
            continue
        file = asked.file or ROOT / "sensors" / f"{name}.yaml"
        sensor = Sensor.model_validate(YAML(typ="safe").load(file.read_text()))
        strips, found = beside(name, folder, sensor, asked.spp)
        print(*found, sep="\n")
        rows += [[name, *astuple(one)] for one in found]
        out = asked.out / f"compare_{name}.png"
        out.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.vstack(strips)).save(out)
        print(f"{out}: real left, rendered right")
    if asked.results and rows:
        sys.path.insert(0, str(ROOT))
        import benchmarks
        from benchmarks import results_page

        heads = results_page.columns("sensor", "what", "SSIM: .3f", "on its own background: .3f", "real", "rendered")
        result = results_page.Result(ABOUT, [results_page.Table("Likeness", heads, rows)])
        benchmarks.record("photographs", result, time.perf_counter() - started, asked.results)
    return 0


if __name__ == "__main__":
    sys.exit(main())
