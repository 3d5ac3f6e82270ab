"""Error of pictures against seconds: every method and setting against traced paths."""

from collections.abc import Iterator, Sequence
from contextlib import nullcontext

from benchmarks import image_error
from benchmarks.image_error import Truth
from benchmarks.results_page import Cell, Level, Plot, Result, Say, Series, Table, columns, cores
from tacgen.recipe import assets, loading
from tacgen.render import mitsuba_variants

ABOUT = (
    "Images of solved faces against Mitsuba's `path`: PSNR before rounding and noise, corrected for the noise"
    " of the reference (+-: what remains of it), and processor seconds of a frame on one core; ready: setup"
    " once per sensor, if not cached. In the plots, points above each other are one method on its faces."
)
TABLE = [("table", "64")]  # Taxim's table, for clear gels; paths a pixel of its calibration
SENSORS = ("gelsight_mini", "digit", "ninedtact")
TRUTHS = {  # references
    "smoke": dict.fromkeys(SENSORS, Truth(2, 16, 16)),
    "normal": {"digit": Truth(8, 2048, 256), "gelsight_mini": Truth(8, 2048, 256), "ninedtact": Truth(8, 1024, 256)},
    "full": {"digit": Truth(8, 4096), "gelsight_mini": Truth(8, 4096), "ninedtact": Truth(5, 512)},
}
FACES = {"smoke": ["ball"], "normal": ["ball", "sheared dots"], "full": list(image_error.FACES)}
SHRINK = {"smoke": 8, "normal": 1, "full": 1}  # of the pictures


def bench(level: Level, say: Say) -> Result:
    """Every sensor, method and setting, on more faces and with more paths the fuller it is asked for."""
    variant, names = mitsuba_variants.best().variant, SENSORS[:1] if level == "smoke" else SENSORS
    found = list(_pictures(level, names, variant, say))
    rows: list[list[Cell]] = []
    for one in found:
        size = f"{one.pixels[0]} x {one.pixels[1]}"
        rows.append(
            [one.sensor, one.face, one.method, one.setting, size, one.decibel, one.sure, one.seconds, one.ready]
        )
    references = ", ".join(
        f"{name} {how.parts} x {how.spp} at {how.pixels or 'all'}"
        for name, how in TRUTHS[level].items()
        if name in names
    )
    heads = columns(
        "sensor", "face", "method", "setting", "pixels", "dB: .1f", "+-: .1f", "s a frame: .3f", "ready [s]: .1f"
    )
    note = f"{variant}; parts of the reference, paths a pixel in each and at how many pixels: {references}."
    table = Table("Pictures", heads, rows, note)
    plots = []
    for name in names:
        mine = [one for one in found if one.sensor == name]
        ways = dict.fromkeys((one.method, one.setting) for one in mine)
        series = [_curve(" ".join(way), [one for one in mine if (one.method, one.setting) == way]) for way in ways]
        plots.append(Plot(name, "s a frame", "PSNR against path [dB]", series, log="x"))
    return Result(ABOUT, [table], plots)


def _pictures(level: Level, names: Sequence[str], variant: str, say: Say) -> Iterator[image_error.Outcome]:
    """Outcomes of all methods, sensor by sensor."""
    jobs = [(name, face, SHRINK[level], how, variant) for name, how in TRUTHS[level].items() if name in names
            for face in FACES[level]]  # fmt: skip
    with cores() if level == "normal" else nullcontext(map) as every:  # tracing whole images uses all cores
        found = {
            job[:2]: one for job, one in zip(jobs, every(image_error.reference, *zip(*jobs, strict=True)), strict=True)
        }
    say("references are there")
    for name in names:
        scatters = any(layer.scattering for layer in loading.read_sensor(assets.sensor_path(name))[0].gel.layers)
        ways = [*image_error.METHODS, *([] if scatters else TABLE)][: 1 if level == "smoke" else None]
        for one in image_error.measure(name, {face: found[name, face] for face in FACES[level]}, ways, variant):
            say(f"{name} {one.face} {one.method} {one.setting}: {one.decibel:.1f} dB in {one.seconds:.2f} s")
            yield one


def _curve(name: str, group: list[image_error.Outcome]) -> Series:
    """The faces of a method, plotted at their mean time, since their times hardly differ."""
    group = sorted(group, key=lambda one: one.decibel)
    mean = sum(one.seconds for one in group) / len(group)
    ends = [*[""] * (len(group) - 1), name] if len(group) > 1 else [name]
    return Series(name, [mean] * len(group), [one.decibel for one in group], ends)
