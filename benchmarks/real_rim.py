"""The rim of a dent and what surrounds it: photographs, and pictures of solved faces and of calibration's formula."""

import numpy as np
from scipy.ndimage import map_coordinates

from benchmarks.photographs import Unit
from benchmarks.results_page import Cell, Say, Table, columns
from tacgen.calibrate import press_faces
from tacgen.calibrate.photos import PhotographedPress
from tacgen.render.images import Renderer
from tacgen.sensor.model import LitSensor

Array = np.ndarray
RADII = np.array([0.5, 0.9, 1.0, 1.1, 1.25, 1.5, 1.75, 2.0])  # contact radii whose change is compared
RIM = np.linspace(0.85, 1.25, 9)  # contact radii whose ripple is measured
ANGLES = 2 * np.pi * np.arange(180) / 180
WAVES = slice(5, 40)  # around the contact; fewer are the lights', more the noise of pixels
DEPTHS = np.arange(0.6, 1.25, 0.1)  # [mm] that are tried: nobody wrote them down
QUALITIES = ("draft", "default", "reference")
SPP = 64


def tables(sensor: LitSensor, unit: Unit, say: Say) -> list[Table]:
    """Of presses that the picture shows up to the last of RADII: change by radius, and ripple of the rim."""
    renderer, random = Renderer(sensor, SPP, 0, markers=False), np.random.default_rng(0)
    flat, size = renderer.develop(renderer.flat()).astype(float), unit.untouched.shape[1::-1]
    around: list[list[Array]] = []
    rim: list[list[float]] = []
    for press in unit.presses:
        if min(*press.center, *np.subtract(size, press.center)) < RADII[-1] * (press.contact or np.inf):
            continue
        photo = press.picture.astype(float) - unit.untouched
        real = once_around(photo, press)
        tried = [
            once_around(renderer.develop(renderer.image(face)) - flat, press)
            for face in press_faces.solved(sensor, press, list(DEPTHS), {})
        ]
        depth = float(DEPTHS[np.argmin([np.linalg.norm(one - real) for one in tried])])
        say(f"{press.name}: like a press of {depth:.1f} mm")
        solved = [press_faces.solved(sensor, press, [depth], {}, quality)[0] for quality in QUALITIES]
        images = [renderer.image(face) for face in (*solved, press_faces.face(sensor, press, {}))]
        along = real[0] / np.linalg.norm(real[0])
        around.append(
            [one @ along for one in (real, *(once_around(renderer.develop(i) - flat, press) for i in images))]
        )
        rim.append([ripple(c, press) for c in (photo, *(renderer.develop(i, random) - flat for i in images[:-1]))])
    rows: list[list[Cell]] = [
        [f"{r:g}", *map(float, row)] for r, row in zip(RADII, np.mean(around, axis=0).T, strict=True)
    ]
    ripples: list[Cell] = [sensor.name, *np.sqrt(np.mean(np.square(rim), axis=0)).tolist()]
    heads = ("photograph", *QUALITIES)
    return [
        Table("Around the contact", columns("contact radii", *(f"{h}: .1f" for h in (*heads, "formula"))), rows,
              f"Counts by which the change varies once around the contact, mean of {len(rim)} presses of {sensor.name}."
              " Solved presses are as deep as fits best; the formula's face is the one that calibration fits to."),
        Table("Ripple of the rim", columns("sensor", *(f"{h}: .2f" for h in heads)), [ripples],
              f"Counts rms of the change that varies {WAVES.start} to {WAVES.stop - 1} times around the contact, at"
              f" {RIM[0]:g} to {RIM[-1]:g} contact radii, with the camera's noise."),
    ]  # fmt: skip


def rings(change: Array, press: PhotographedPress, radii: Array) -> Array:
    """A change (H, W, 3) [counts] on circles around a contact, as waves (radii, waves, 3) over the angle."""
    r = radii[:, None] * (press.contact or 0.0)
    at = [press.center[1] + r * np.sin(ANGLES) - 0.5, press.center[0] + r * np.cos(ANGLES) - 0.5]
    seen = np.stack([map_coordinates(change[..., c], at, order=1) for c in range(3)], axis=2)
    return np.asarray(2 * np.fft.rfft(seen, axis=1) / len(ANGLES))


def once_around(change: Array, press: PhotographedPress) -> Array:
    """What varies once around (radii, 6) [counts]: in first order by how steep the face is."""
    first = rings(change, press, RADII)[:, 1]
    return np.concatenate([first.real, first.imag], axis=1)


def ripple(change: Array, press: PhotographedPress) -> float:
    """What varies as WAVES say, root mean square over radii and colours [counts]."""
    return float(np.sqrt((np.abs(rings(change, press, RIM)[:, WAVES]) ** 2).sum(axis=1).mean() / 2))
