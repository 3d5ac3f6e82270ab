"""Fit the optical numbers of sensors/gelsight_mini.yaml to photographs of a real unit; called by calibrate_optics.py.

Light is linear in the LEDs' power, so for each trial geometry the radiances and the stray light follow from a
non-negative least-squares fit; only positions, sizes and tilts of the strips, the plate, the coat's gloss and the
vignette are searched. The balls' dents count by their *change* against the untouched picture.
"""

import argparse
import csv
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from ruamel.yaml import YAML
from scipy.optimize import least_squares, nnls

from tacgen.optics import coating, response
from tacgen.optics.dent import BallDent
from tacgen.optics.direct import Direct, Samples
from tacgen.optics.layers import Camera
from tacgen.optics.sheet import Sheet, Untouched
from tacgen.sensor import Sensor

STEP = 4  # pixels of the photograph per pixel of the fit
DENT_WEIGHT = 2.0
HELD_OUT = ("ball_6.310mm_2.png", "ball_9.500mm_8.png", "ball_6.310mm_5.png")
SHEET = 0.2  # [mm]

# name: (start, least, most); strips by [position across, z, centre along, length, height, tilt from the wall]
SEARCH = {
    "red": ((-9.2, -6.5, -1.8, 20.0, 2.7, 0.6), (-10.35, -14.0, -5, 4, 0.5, -0.5), (-8.0, -1.0, 5, 24, 6, 1.4)),
    "green": ((12.1, -5.6, -0.8, 15.6, 3.3, 0.5), (10.5, -14.0, -5, 4, 0.5, -0.5), (12.55, -1.0, 5, 20, 6, 1.4)),
    "blue": ((9.2, -6.5, -0.7, 20.0, 2.6, 0.7), (8.0, -14.0, -5, 4, 0.5, -0.5), (10.35, -1.0, 5, 24, 6, 1.4)),
    "plate": ((4.3,), (0.5,), (12.0,)),
    "vignette": ((9.2,), (6.0,), (80.0,)),
    "specular": ((0.03,), (0.0,), (0.6,)),
    "roughness": ((0.25,), (0.1,), (0.8,)),
}


@dataclass(frozen=True)
class Photo:
    """A real picture at the fit's scale, and which of its pixels count."""

    name: str
    picture: np.ndarray  # (h, w, 3), 0 to 255
    surface: Any
    counts: np.ndarray  # (h, w) bool


def read(path: Path) -> np.ndarray:
    """A photograph averaged over STEP x STEP pixels, (h, w, 3), 0 to 255."""
    picture = np.asarray(Image.open(path).convert("RGB"), dtype=float)
    h, w = picture.shape[0] // STEP, picture.shape[1] // STEP
    return picture[: h * STEP, : w * STEP].reshape(h, STEP, w, STEP, 3).mean(axis=(1, 3))


def photos(folder: Path, camera: Camera) -> list[Photo]:
    """The untouched picture, then every ball press with the pixels around its contact circle."""
    base = read(folder / "background.png")
    found = [Photo("background.png", base, Untouched(), np.ones(base.shape[:2], bool))]
    y, x = (np.mgrid[: base.shape[0], : base.shape[1]] + 0.5) * STEP
    for row in csv.DictReader((folder / "circles.csv").read_text().splitlines()):
        cx, cy, a = float(row["cx_px"]), float(row["cy_px"]), float(row["contact_radius_px"])
        dent = BallDent.seen(camera, float(row["ball_diameter_mm"]) / 2, (cx, cy), a)
        found.append(Photo(row["image"], read(folder / row["image"]), dent, np.hypot(x - cx, y - cy) < 1.7 * a))
    return found


def trial(base: dict, q: dict[str, tuple[float, ...]]) -> Sensor:
    """The sensor file with the searched numbers put in, at the fit's resolution."""
    made = dict(base)
    plate = q["plate"][0]
    bottom = -plate - sum(layer["thickness_mm"] for layer in base["gel"]["layers"])
    leds = []
    for name in ("red", "green", "blue"):
        across, z, along, length, height, tilt = q[name]
        z = max(z, bottom + abs(np.cos(tilt)) * height / 2 + 0.05)  # the strip stays inside plate and gel
        wide, room = (base["gel"][k] / 2 - 0.03 for k in ("height_mm", "width_mm")[:: 1 if name != "green" else -1])
        across = float(np.clip(across, *(wide - abs(np.sin(tilt)) * height / 2) * np.array([-1, 1])))
        length = min(length, 2 * (room - abs(along)))
        side = np.sign(across)
        flat = (0.0, -side * np.cos(tilt)) if name != "green" else (-side * np.cos(tilt), 0.0)
        place = (along, across) if name != "green" else (across, along)
        leds.append(
            {"name": name, "center_mm": (*place, z), "normal": (*flat, -np.sin(tilt)), "size_mm": (length, height),
             "radiance": (1, 1, 1), "source": "fit"}
        )  # fmt: skip
    made["leds"] = leds
    made["plate"] = {**base["plate"], "thickness_mm": plate}
    made["coating"] = {**base["coating"], "specular": q["specular"][0], "roughness": q["roughness"][0]}
    eye = base["camera"]
    made["camera"] = {
        **eye, "vignette_mm": q["vignette"][0], "mm_per_px": eye["mm_per_px"] * STEP,
        "width_px": eye["width_px"] // STEP, "height_px": eye["height_px"] // STEP, "ambient": (0, 0, 0), "exposure": 1,
    }  # fmt: skip
    return Sensor.model_validate(made)


def linear(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse sRGB of a picture in counts, and the slope of counts against linear light there."""
    e = np.clip(picture / 255, 1e-4, 1)
    x = np.where(e <= 0.04045, e / 12.92, ((e + 0.055) / 1.055) ** 2.4)
    slope = np.where(x <= 0.0031308, 12.92, 1.055 / 2.4 * np.maximum(x, 1e-4) ** (1 / 2.4 - 1))
    return x, 255 * slope


class Fit:
    """Real pictures against trial sensors."""

    def __init__(self, base: dict, seen: list[Photo]) -> None:
        """`base` is the sensor file as plain data."""
        self.base, self.seen = base, seen
        self.names = list(SEARCH)
        self._looked: dict[str, Samples] = {}

    def parts(self, v: np.ndarray) -> dict[str, tuple[float, ...]]:
        """The flat vector of searched numbers by name."""
        sizes = np.cumsum([len(SEARCH[n][0]) for n in self.names])[:-1]
        return {n: tuple(float(x) for x in p) for n, p in zip(self.names, np.split(v, sizes), strict=True)}

    def columns(self, sensor: Sensor) -> list[np.ndarray]:
        """Per picture, linear light per unit radiance of each LED, and stray light: (pixels that count, LEDs + 1)."""
        direct = Direct(sensor, _sheet(sensor), markers=False, pieces=(6, 2))
        fall = response.vignette(sensor.camera).ravel()
        coat, made = sensor.coating, []
        for photo in self.seen:
            if photo.name not in self._looked:  # the camera hardly moves in the search: find once what its rays meet
                self._looked[photo.name] = direct.view.look(photo.surface)
            at = self._looked[photo.name]
            here = photo.counts.ravel()
            position = np.where(here[:, None], at.position, np.nan)
            light = direct.light(Samples(position, at.normal, at.rest, at.nodes))[here]
            total = (1 - coat.specular) * coat.albedo[0] * light[..., 0] + coat.specular * coating.METAL * light[..., 1]
            made.append(np.column_stack([total * fall[here, None], np.ones(here.sum())]))
        return made

    def solve(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, Sensor]:
        """Weighted misfit [counts], the best coefficients (3 channels, LEDs + 1) and the sensor."""
        sensor = trial(self.base, self.parts(v))
        columns = self.columns(sensor)
        misfit, found = [], []
        for c in range(3):
            rows, right = [], []
            for photo, a in zip(self.seen, columns, strict=True):
                y, slope = linear(photo.picture[photo.counts][:, c])
                if photo is self.seen[0]:
                    rows.append(a * slope[:, None])
                    right.append(y * slope)
                    continue
                y0, _ = linear(self.seen[0].picture[photo.counts][:, c])
                change = a - columns[0][photo.counts.ravel()]
                weight = DENT_WEIGHT * slope
                rows.append(change * weight[:, None])
                right.append((y - y0) * weight)
            A, b = np.concatenate(rows), np.concatenate(right)
            x, _ = nnls(A, b)
            found.append(x)
            misfit.append(A @ x - b)
        return np.concatenate(misfit), np.array(found), sensor


@cache
def _sheet_of(size: tuple[float, float], corner: float) -> Sheet:
    return Sheet(size, corner, (round(size[1] / SHEET) + 1, round(size[0] / SHEET) + 1))


def _sheet(sensor: Sensor) -> Sheet:
    return _sheet_of((sensor.gel.width_mm, sensor.gel.height_mm), sensor.gel.corner_radius_mm)


def main() -> None:
    """Fit, report, and print the numbers for the sensor file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--steps", type=int, default=30, help="most evaluations of the Jacobian")
    parser.add_argument("--start", type=str, default="", help="all searched numbers in one string, to go on from")
    parser.add_argument("--sensor", type=Path, default=Path(__file__).parents[1] / "sensors" / "gelsight_mini.yaml")
    asked = parser.parse_args()
    base = YAML(typ="safe").load(asked.sensor.read_text())
    seen = [p for p in photos(asked.folder, Camera.from_sensor(Sensor.model_validate(base))) if p.name not in HELD_OUT]
    fit = Fit(base, seen)
    start, least, most = (np.concatenate([SEARCH[n][i] for n in SEARCH]).astype(float) for i in range(3))
    span = most - least
    if asked.start:
        start = np.clip(np.array(asked.start.split(), dtype=float), least + 1e-6, most - 1e-6)
    found = least_squares(
        lambda u: fit.solve(least + u * span)[0], (start - least) / span, bounds=(0, 1), diff_step=3e-3,
        max_nfev=asked.steps, verbose=2,
    )  # fmt: skip
    v = least + found.x * span
    misfit, radiance, sensor = fit.solve(v)
    print(f"weighted misfit {np.sqrt(np.mean(misfit**2)):.2f} counts rms")
    for name, part in fit.parts(v).items():
        print(f"{name:10s}", *(f"{x:8.3f}" for x in part))
    for k, led in enumerate(sensor.leds):
        print(
            f"{led.name}: center_mm {np.round(led.center_mm, 2)} normal {np.round(led.normal, 3)} size_mm {led.size_mm}"
        )
        print("  radiance", np.round(radiance[:, k], 3))
    print("ambient", np.round(radiance[:, -1], 4))


if __name__ == "__main__":
    main()
