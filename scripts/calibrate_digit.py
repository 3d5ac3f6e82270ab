"""Fit the lights of sensors/digit.yaml to photographs of a real unit; called by calibrate_optics.py.

Searched are each LED's place around the pad, size and turn, the camera's scale, axis and vignette, the ball's radius
and each dent's place and size; dents count by their change against the untouched picture, which has marks of its own.
"""

import argparse
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from ruamel.yaml import YAML
from scipy.optimize import least_squares, nnls

from tacgen.optics import response
from tacgen.optics.bounce import Bounce
from tacgen.optics.dent import BallDent
from tacgen.optics.direct import Direct
from tacgen.optics.layers import Camera
from tacgen.optics.sheet import Sheet, Untouched
from tacgen.optics.view import Samples
from tacgen.sensor import Sensor

STEP = 4  # pixels of the photograph per pixel of the fit
REACH = 72  # [px] around a dent that count
ROOM = 13.2  # [mm] off the pad at most
DENTS = {  # where the balls are, roughly [px]
    "sphere_0001.png": (138, 152), "sphere_0005.png": (114, 196), "sphere_0010.png": (98, 94),
    "sphere_0017.png": (71, 189), "sphere_0024.png": (96, 208), "sphere_0036.png": (159, 215),
}  # fmt: skip
LED = {  # start, least, most
    "z": (-2.5, -7.2, -0.8), "width": (4.0, 1.0, 10.0), "height": (2.0, 0.5, 5.0), "tilt": (0.0, -1.2, 1.2),
    "yaw": (0.0, -1.3, 1.3), "out": (5.0, -0.2, 9.5),
}  # fmt: skip
AROUND = {"red": (-42, -75, -5), "green": (-154, -178, -110), "blue": (82, 60, 120)}  # [deg]
REST = {
    "scale": (0.05, 0.04, 0.055), "x": (0, -2, 2), "y": (0, -3, 3), "vignette": (30, 8, 60), "ball": (2.2, 1.5, 5.0),
}  # fmt: skip


def searched() -> dict[str, tuple[float, float, float]]:
    """Every searched number by name: start, least, most."""
    made: dict[str, tuple[float, float, float]] = {}
    for led, around in AROUND.items():
        made[f"{led}.around"] = tuple(np.radians(around))
        made |= {f"{led}.{name}": values for name, values in LED.items()}
    made |= REST
    for name, (x, y) in DENTS.items():
        made |= {f"{name}.x": (x, x - 20, x + 20), f"{name}.y": (y, y - 20, y + 25), f"{name}.a": (1.7, 0.9, 2.6)}
    return made


def rim(gel: Any, around: float) -> tuple[np.ndarray, np.ndarray]:
    """Where the ray from the pad's middle at an angle leaves the outline (round at -y), and the normal inward there."""
    d, r, h = np.array([np.cos(around), np.sin(around)]), gel.width_mm / 2, gel.height_mm / 2
    to_side, to_end = r / max(abs(d[0]), 1e-9), h / max(d[1], 1e-9)
    point = d * min(to_side, to_end)
    if point[1] >= r - h:
        return point, np.array([0.0, -1.0]) if to_end < to_side else np.array([-np.sign(d[0]), 0.0])
    middle = np.array([0.0, r - h])
    along = d @ middle
    point = d * (along + np.sqrt(along**2 - middle @ middle + r * r))
    return point, (middle - point) / r


def light(gel: Any, q: dict[str, float], name: str) -> dict[str, Any]:
    """One LED from its searched numbers."""
    z, width, height, tilt, yaw, out = (q[f"{name}.{part}"] for part in LED)
    point, inward = rim(gel, q[f"{name}.around"])
    c, s = np.cos(yaw), np.sin(yaw)
    flat = np.array([inward[0] * c - inward[1] * s, inward[0] * s + inward[1] * c]) * np.cos(tilt)
    z = max(min(z, -0.2 - np.cos(tilt) * height / 2), -8.0 + np.cos(tilt) * height / 2)
    return {
        "name": name, "center_mm": (*(point - inward * out), z), "normal": (*flat, np.sin(tilt)),
        "size_mm": (width, height), "radiance": (1, 1, 1), "source": "fit",
    }  # fmt: skip


def linear(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse sRGB of a picture in counts, and the slope of counts against linear light there."""
    e = np.clip(picture / 255, 1e-4, 1)
    x = np.where(e <= 0.04045, e / 12.92, ((e + 0.055) / 1.055) ** 2.4)
    slope = np.where(x <= 0.0031308, 12.92, 1.055 / 2.4 * np.maximum(x, 1e-4) ** (1 / 2.4 - 1))
    return x, 255 * slope


class Fit:
    """Real pictures against trial sensors."""

    def __init__(self, base: dict[str, Any], folder: Path) -> None:
        """`base` is the sensor file as plain data."""
        self.base, self.names = base, list(searched())
        self.own = [n for n in self.names if n.startswith("sphere")]
        self.gel = Sensor.model_validate(base).gel
        self.sheet = Sheet.over(self.gel, 0.25)
        self.pictures = [self._read(folder / name) for name in ("background.png", *DENTS)]
        h, w = self.pictures[0].shape[:2]
        y, x = (np.mgrid[:h, :w] + 0.5) * STEP
        near = [np.hypot(x - cx, y - cy).ravel() < REACH for cx, cy in DENTS.values()]
        self.counts = [np.ones(h * w, bool), *near]
        self.linear = [linear(p.reshape(-1, 3)) for p in self.pictures]
        self.bounce: Bounce | None = None
        self.lit = lru_cache(8)(self._lit)
        self.column = lru_cache(400)(self._column)

    @staticmethod
    def _read(path: Path) -> np.ndarray:
        picture = np.asarray(Image.open(path).convert("RGB"), dtype=float)
        h, w = picture.shape[:2]
        return picture.reshape(h // STEP, STEP, w // STEP, STEP, 3).mean((1, 3))

    def sensor(self, q: dict[str, float]) -> Sensor:
        """The sensor file with the searched numbers put in, at the fit's resolution."""
        leds = [light(self.gel, q, name) for name in AROUND]
        eye = self.base["camera"] | {
            "mm_per_px": q["scale"] * STEP, "center_mm": (q["x"], q["y"]), "vignette_mm": q["vignette"],
            "width_px": 240 // STEP, "height_px": 320 // STEP, "ambient": (0, 0, 0),
        }  # fmt: skip
        walls = self.base["walls"] | {"margin_mm": ROOM}
        return Sensor.model_validate(self.base | {"leds": leds, "camera": eye, "walls": walls})

    def _lit(self, shared: tuple[float, ...]) -> tuple[Sensor, Direct, np.ndarray]:
        sensor = self.sensor(dict(zip(self.names, shared, strict=False)))
        direct = Direct(sensor, self.sheet, False, (3, 2))
        self.bounce = self.bounce or Bounce(sensor)
        added = self.bounce.picture(self.bounce.added(sensor, direct.points)[..., 0], direct.view)
        return sensor, direct, added.reshape(-1, len(AROUND))

    def _look(self, own: tuple[float, ...], ball: float, sensor: Sensor, direct: Direct) -> Samples:
        face: Any = Untouched.of(sensor.gel)
        if own:
            eye, (x, y, contact) = Camera.from_sensor(sensor), own
            origin, direction = eye.rays(np.array([[x, y]]) / STEP)
            place = (origin + direction * ((-0.4 - origin[:, 2:]) / direction[:, 2:]))[0, :2]
            dome = sensor.gel.dome
            bend = (1 / dome.radius_x_mm + 1 / dome.radius_y_mm) / 2
            face = BallDent(1 / (1 / ball + bend), min(contact, 0.92 * ball), (place[0], place[1]), face)
        return direct.view.look(face)

    def _column(self, picture: int, shared: tuple[float, ...], own: tuple[float, ...]) -> np.ndarray:
        """Linear light per unit radiance of each LED, and stray light: (pixels, LEDs + 1)."""
        sensor, direct, added = self.lit(shared)
        at = self._look(own, shared[self.names.index("ball")], sensor, direct)
        where = np.where(self.counts[picture][:, None], at.position, np.nan)
        seen = sensor.coating.albedo[0] * direct.light(Samples(where, at.normal, at.rest, at.nodes))[..., 0] + added
        fall = response.vignette(sensor.camera).ravel()
        return np.column_stack([np.nan_to_num(seen) * fall[:, None], np.ones(len(fall))])

    def solve(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Misfit [counts], and the best coefficients (3 channels, LEDs + 1)."""
        shared, dents = tuple(v[: -len(self.own)]), v[-len(self.own) :].reshape(-1, 3)
        columns = [self.column(0, shared, ()), *(self.column(k + 1, shared, tuple(d)) for k, d in enumerate(dents))]
        misfit, found = [], []
        for c in range(3):
            (y0, slope0), rows, right = (a[:, c] for a in self.linear[0]), [], []
            rows.append(columns[0] * slope0[:, None])
            right.append(y0 * slope0)
            for k in range(1, len(columns)):
                here, (y, slope) = self.counts[k], (a[:, c] for a in self.linear[k])
                weight = np.minimum(slope, 1500)[here]
                rows.append((columns[k] - columns[0])[here] * weight[:, None])
                right.append((y - y0)[here] * weight)
            A, b = np.concatenate(rows), np.concatenate(right)
            found.append(nnls(A, b)[0])
            misfit.append(A @ found[-1] - b)
        return np.concatenate(misfit), np.array(found)


def main(arguments: Sequence[str] | None = None) -> None:
    """Fit, and print the numbers for the sensor file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--steps", type=int, default=60, help="most evaluations of the Jacobian")
    parser.add_argument("--start", type=str, default="", help="all searched numbers in one string, to go on from")
    parser.add_argument("--sensor", type=Path, default=Path(__file__).parents[1] / "sensors" / "digit.yaml")
    asked = parser.parse_args(arguments)
    fit = Fit(YAML(typ="safe").load(asked.sensor.read_text()), asked.folder)
    start, least, most = np.array(list(searched().values()), dtype=float).T
    start = np.array(asked.start.split(), dtype=float) if asked.start else start
    share = np.clip((start - least) / (most - least), 0.03, 0.97)

    def numbers(u: np.ndarray) -> np.ndarray:
        return least + (most - least) / (1 + np.exp(-u))  # no bounds to run along

    found = least_squares(
        lambda u: fit.solve(numbers(u))[0], np.log(share / (1 - share)), diff_step=1e-2, max_nfev=asked.steps,
        verbose=2, loss="soft_l1", f_scale=15,
    )  # fmt: skip
    v = numbers(found.x)
    misfit, radiance = fit.solve(v)
    print(f"misfit {np.sqrt(np.mean(misfit**2)):.2f} counts rms; all: {' '.join(f'{x:.4f}' for x in v)}")
    q = dict(zip(fit.names, v, strict=True))
    for name in (*REST, *fit.own):
        print(f"{name:20s} {q[name]:8.3f}")
    for k, led in enumerate(fit.sensor(q).leds):
        print(f"{led.name}: center_mm {np.round(led.center_mm, 2)} normal {np.round(led.normal, 3)}", end=" ")
        print(f"size_mm {np.round(led.size_mm, 2)} radiance {np.round(radiance[:, k], 2)}")
    print("ambient", np.round(radiance[:, -1], 4))
