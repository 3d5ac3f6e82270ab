"""Five photographs of presses, drawn at random, given to `calibrate optics`: is what it writes worse on the others?"""

import math
import resource
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import numpy as np

from benchmarks import photographs
from benchmarks.results_page import Absent, Cell, Level, Result, Say, Table, columns, in_own_processes
from tacgen.calibrate import optics, solved_presses, steps
from tacgen.calibrate.photometric_model import FitLimits
from tacgen.calibrate.photos import Photos
from tacgen.calibrate.render_comparison import Comparison
from tacgen.recipe import assets, loading
from tacgen.sensor.model import LitSensor

UNITS = {"gelsight_mini_unit2": "gelsight_mini", "gelsight_mini": "gelsight_mini", "digit": "digit"}  # its sensor file
GIVEN = 5  # presses of a draw
DRAWS = {"smoke": 1, "normal": 3, "full": 20}  # of each unit, if there are as many choices
ABOUT = (
    f"{GIVEN} photographs of presses, drawn at random, are given to `calibrate optics`, which starts from the shipped"
    " file; that file and the written one are compared on all other presses of the unit, by networks for normals as in"
    " the part on real units. The shipped files of the first Mini and of the DIGIT were fitted to all presses."
)
HEADS = ("unit, photographs", "draws: d", "written: d", "written and worse: d", "worst of those by [deg]: .2f",
         "shipped [deg]: .2f", "written or kept [deg]: .2f", "all fits [deg]: .2f",
         "processor seconds of a calibration: .0f")  # fmt: skip
EACH = "unit", "given", "written", "shipped [deg]: .2f", "fit [deg]: .2f", "processor seconds: .0f", "judged by itself"


def bench(level: Level, say: Say) -> Result:
    """Every unit with photographs. Raises Absent if there are none."""
    units = {name: one for name in UNITS if (one := photographs.unit(name))}
    if not units:
        raise Absent(f"no photographs in {photographs.reference()} (set TACGEN_REFERENCE)")
    jobs: list[tuple[str, list[int]]] = [(name, []) for name in units]
    jobs += [(name, given) for name, one in units.items() for given in draws(len(one.presses), DRAWS[level])]
    shipped, each, rows = dict[str, list[float]](), list[list[Cell]](), list[list[Cell]]()
    for (name, given), found in zip(jobs, in_own_processes(f"{__name__}:judged", jobs), strict=True):
        if isinstance(found, RuntimeError):
            raise found
        off, problem, told, seconds = found
        if not given:
            shipped[name] = off
            continue
        unseen = [k for k in range(len(off)) if k not in given]
        before, after = (float(np.mean([one[k] for k in unseen])) for one in (shipped[name], off))
        each.append([name, " ".join(map(str, given)), "no" if problem else "yes", before, after, seconds, told])
        say(f"{name} {each[-1][1]}: {problem or 'written'}; unseen {before:.2f} deg before, {after:.2f} after;"
            f" {seconds:.0f} s; by itself {told}")  # fmt: skip
    for name, one in units.items():
        rows.append([f"{name}, {len(one.presses)}", *_summed([row for row in each if row[0] == name])])
        say(", ".join(f"{head.partition(':')[0]} {cell}" for head, cell in zip(HEADS, rows[-1], strict=True)))
    note = "Mean error of normals on presses not given. The error of one file scatters by 0.3 deg over seeds, the"
    tables = [Table("From five photographs", columns(*HEADS), rows, f"{note} difference of two by 0.1."),
              Table("Each draw", columns(*EACH), each, "Given: the numbers of presses, from 0.")]  # fmt: skip
    return Result(ABOUT, tables)


def _summed(each: list[list[Cell]]) -> list[Cell]:
    """Cells of HEADS after the first."""
    before, after, seconds = (np.array([row[k] for row in each], float) for k in (3, 4, 5))
    written = np.array([row[2] == "yes" for row in each])
    harm = (after - before)[written & (after > before)]
    worst = float(harm.max()) if len(harm) else None
    kept = np.where(written, after, before)
    return [len(each), int(written.sum()), len(harm), worst, *(float(v.mean()) for v in (before, kept, after, seconds))]


def draws(presses: int, count: int) -> list[list[int]]:
    """Numbers of the presses that each draw gives, no choice twice."""
    found, seed, given = list[list[int]](), 0, min(GIVEN, presses - 1)
    while len(found) < min(count, math.comb(presses, given)):
        some = sorted(np.random.default_rng(seed).permutation(presses)[:given].tolist())
        found += [some] if some not in found else []
        seed += 1
    return found


def judged(name: str, given: list[int]) -> tuple[list[float], str, str, float]:
    """Errors of normals [deg] in all presses of a unit, by the shipped file or by the fit to some of them; why that
    would not be written, what it says of itself, and its processor seconds."""
    unit, path, problem, told, seconds = photographs.unit(name), assets.sensor_path(UNITS[name]), "", "", 0.0
    assert unit is not None
    steps.MAX_WORKERS = 1  # the other cores have draws of their own
    sensor = cast(LitSensor, loading.read_sensor(path)[0])
    presses, faces = solved_presses.faced(sensor, unit.presses, {})
    if given:
        drawn = photographs.as_drawn(name, unit.folder)
        begun = _spent()
        photos = Photos(unit.folder, unit.untouched, tuple(drawn[k] for k in given))
        fit = optics.calibrated(path, photos, FitLimits(bare=True))
        problem, seconds, unseen = fit.problem(), _spent() - begun, fit.fitted.unseen
        gains = np.subtract(*unseen.degrees) if unseen is not None and unseen.degrees is not None else []
        told = f"{unseen}; gains {' '.join(f'{gain:.2f}' for gain in gains)}"
        with TemporaryDirectory() as scratch:
            fit.write(out := Path(scratch) / "fitted.yaml", anyway=True)
            sensor = cast(LitSensor, loading.read_sensor(out)[0])
    return Comparison(sensor).likeness(presses, faces, unit.untouched).each.tolist(), problem, told, seconds


def _spent() -> float:
    """Processor seconds of this process."""
    used: Any = resource.getrusage(resource.RUSAGE_SELF)
    return float(used.ru_utime + used.ru_stime)
