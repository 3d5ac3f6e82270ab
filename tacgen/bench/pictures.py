"""Error of pictures against seconds: every method and setting against traced paths, and where the coating goes."""

from collections.abc import Iterator, Sequence
from typing import cast

from tacgen.bench import flow, optics
from tacgen.bench.kit import Cell, Level, Plot, Result, Say, Series, Table, columns
from tacgen.image import variants
from tacgen.spec import assets, load
from tacgen.spec.sensor import LitSensor

ABOUT = (
    "Pictures of solved faces against Mitsuba's `path`: PSNR on developed sRGB before rounding and without the"
    " camera's noise, the reference's own noise taken off, and the processor's seconds of a frame on one core; ready:"
    " of what is made once a sensor, where it was not in the cache. Pictures are made smaller by the same part in"
    " width and height."
)
TABLE = [("table", "64")]  # Taxim's, for gels that do not scatter; calibrated with so many paths
SENSORS = ("gelsight_mini", "digit", "ninedtact")
SIZES: dict[Level, tuple[int, int, int]] = {"smoke": (8, 16, 8), "normal": (4, 512, 64), "full": (2, 2048, 256)}


def bench(level: Level, say: Say) -> Result:
    """Every sensor, method and setting, on more faces and with more paths the fuller it is asked for."""
    variant, (shrink, spp, paths) = variants.best().variant, SIZES[level]
    names = SENSORS[:1] if level == "smoke" else SENSORS
    found = list(_pictures(level, names, spp, shrink, variant, say))
    rows: list[list[Cell]] = []
    for one in found:
        size = f"{one.pixels[0]} x {one.pixels[1]}"
        rows.append([one.sensor, one.face, one.method, one.setting, size, one.decibel, one.seconds, one.ready])
    heads = columns("sensor", "face", "method", "setting", "pixels", "dB: .1f", "s a frame: .3f", "ready [s]: .1f")
    table = Table("Pictures", heads, rows, f"{variant}; the reference has 2 x {spp} paths a pixel.")
    plots = []
    for name in names:
        mine = [one for one in found if one.sensor == name]
        ways = dict.fromkeys((one.method, one.setting) for one in mine)
        series = [_curve(" ".join(way), [one for one in mine if (one.method, one.setting) == way]) for way in ways]
        plots.append(Plot(name, "s a frame", "PSNR against path [dB]", series, log="x"))
    return Result(ABOUT, [table] if level == "smoke" else [table, _flow(names, paths, variant, say)], plots)


def _pictures(
    level: Level, names: Sequence[str], spp: int, shrink: int, variant: str, say: Say
) -> Iterator[optics.Outcome]:
    """Outcomes, sensor by sensor, of all methods that it has."""
    faces = {"smoke": ["ball"], "normal": ["ball", "sheared dots"], "full": list(optics.FACES)}[level]
    for name in names:
        scatters = any(layer.scattering for layer in load.read_sensor(assets.sensor_path(name))[0].gel.layers)
        ways = [*optics.WAYS, *([] if scatters else TABLE)][: 1 if level == "smoke" else None]
        for one, _, _ in optics.measure([name], faces, spp, shrink, ways, variant):
            say(f"{name} {one.face} {one.method} {one.setting}: {one.decibel:.1f} dB in {one.seconds:.2f} s")
            yield one


def _curve(name: str, group: list[optics.Outcome]) -> Series:
    return Series(name, [one.seconds for one in group], [one.decibel for one in group], [one.face for one in group])


def _flow(sensors: Sequence[str], paths: int, variant: str, say: Say) -> Table:
    """Markers and dense flow against traced pictures."""
    rows: list[list[Cell]] = []
    for name in sensors:
        sensor, untouched, moved = flow.sheared(name)
        error = flow.measure(cast(LitSensor, sensor), untouched, moved, variant, paths)
        rows.append([name, *error])
        say(f"{name}: markers {error.markers_rms:.3f} px off")
    heads = columns(
        "sensor", "moved [px]: .1f", "markers, rms [px]: .3f", "most: .3f", "flow, rms [px]: .3f", "at most: .3f"
    )
    note = (
        f"A ball pressed and sheared by {flow.SHEAR:g} mm, against the coating's own places as {paths} paths see them."
    )
    return Table("Flow", heads, rows, note)
