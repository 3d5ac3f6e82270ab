"""Grain of real coatings: contrast and correlation length from photographs, and the spectra of rendered ones beside.

What stays in place while presses come and go is the unit's; what differs is the camera's noise. So presses are taken in
two halves, and only what the medians of both have in common counts; and only what two colours have in common, since
grain is of the same share in all colours. Slow changes of brightness are divided out.
"""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.optimize import least_squares

from benchmarks import mini_units
from benchmarks.results_page import Cell, Say, Table, columns
from tacgen.render.images import Renderer
from tacgen.sensor.imperfections import Grain
from tacgen.sensor.model import LitSensor

Array = np.ndarray
SMOOTH = 12.0  # standard deviation of the Gaussian of slow changes [px]
FADE = 4.0  # the same of the rim of hidden dots [px]
EDGE = 10  # left out along the picture's edges [px]
BANDS = np.array([0.06, 0.09, 0.13, 0.18, 0.24, 0.32, 0.42, 0.5])  # of frequency [1/px]; below is slow light
PAIRS = (0, 1), (0, 2), (1, 2)  # of colours
PICTURES = 10  # rendered pictures, each with its noise


def spectrum(pictures: Sequence[Array], hidden: Array) -> Array:
    """Power of the pattern (bands,) [% of the light, squared, px^2] that pictures (H, W, 3) of one unit share.

    `hidden` (H, W): pixels that are left out in all of them.
    """
    halves = [np.median([_relative(p, hidden) for p in pictures[k::2]], axis=0) for k in (0, 1)]
    inner = (slice(EDGE, -EDGE), slice(EDGE, -EDGE))
    height, width, _ = halves[0][inner].shape
    window = np.hanning(height)[:, None] * np.hanning(width) * gaussian_filter((~hidden).astype(float), 1.0)[inner]
    one, other = (np.fft.fft2(half[inner] * window[..., None], axes=(0, 1)) for half in halves)
    cross = [(one[..., a] * other[..., b].conj() + one[..., b] * other[..., a].conj()).real / 2 for a, b in PAIRS]
    band = np.digitize(np.hypot(np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width)), BANDS)
    power = np.mean(cross, axis=0) / (window**2).sum()
    return np.array([power[band == k].mean() for k in range(1, len(BANDS))])


def _relative(picture: Array, hidden: Array) -> Array:
    """Change against the slow light [%], 0 where it is hidden."""
    seen = gaussian_filter((~hidden).astype(float), SMOOTH)[..., None] + 1e-9
    light = np.where(hidden[..., None], 0.0, picture.astype(float))
    slow = gaussian_filter(light, (SMOOTH, SMOOTH, 0)) / seen
    return np.where(hidden[..., None], 0.0, 100 * (light - slow) / np.maximum(slow, 10.0))


def expected(contrast: float, length: float) -> Array:
    """The spectrum (bands,) of grain of a contrast [%] and a length [px], averaged over pixels; see `Grain`."""
    f = np.fft.fftfreq(256)
    squared = f[:, None] ** 2 + f**2
    power = 2 * np.pi * (contrast * length) ** 2 / (1 + (2 * np.pi * length) ** 2 * squared) ** 1.5
    power = power * (np.sinc(f)[:, None] * np.sinc(f)) ** 2
    band = np.digitize(np.sqrt(squared), BANDS)
    return np.array([power[band == k].mean() for k in range(1, len(BANDS))])


def fitted(power: Array) -> tuple[float, float]:
    """Contrast [%] and length [px] of the grain that suits a spectrum best, each band weighing the same."""
    least = np.log(np.maximum(power, 1e-3))
    found = least_squares(lambda u: np.log(expected(*np.exp(u))) - least, np.zeros(2))
    contrast, length = np.exp(found.x)
    return float(contrast), float(length)


def table(sensor: LitSensor, say: Say) -> Table:
    """Of each unit, the grain that is found, the spectrum, and that of pictures rendered with it."""
    rows: list[list[Cell]] = []
    scale, middle = sensor.camera.mm_per_px, [f"{f:.2f}/px: .2f" for f in (BANDS[:-1] + BANDS[1:]) / 2]
    for name in mini_units.FOLDERS:
        unit = mini_units.unit(name)
        real = spectrum(unit.pictures, np.any(unit.hidden, axis=0))
        contrast, length = fitted(real)
        rows.append([f"{name}, photographs", contrast, length * scale, *map(float, real)])
        grain = Grain(contrast=contrast / 100, length_mm=length * scale, source="fitted")
        made = spectrum(rendered(sensor, grain), np.any(unit.hidden, axis=0))
        rows.append(["rendered with it", contrast, length * scale, *map(float, made)])
        say(f"{name}: grain of {contrast:.2f} %, {length * scale:.3f} mm")
    heads = columns("pictures", "contrast [%]: .2f", "length [mm]: .3f", *middle)
    note = (
        "Power by frequency [% of the light squared times px^2]: what medians of two halves of a unit's presses, and"
        " two colours, have in common. Contrast and length are fitted to the photographs."
    )
    return Table("Grain of the coating", heads, rows, note)


def rendered(sensor: LitSensor, grain: Grain) -> list[Array]:
    """Untouched pictures of a sensor with a grain, each with the camera's noise of its own."""
    grainy = sensor.model_copy(update={"coating": sensor.coating.model_copy(update={"grain": grain})})
    camera = Renderer(grainy, 16, 0, markers=False)
    flat = camera.flat()
    return [camera.develop(flat, np.random.default_rng(k)) for k in range(PICTURES)]
