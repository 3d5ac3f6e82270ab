"""Five photographs of presses, drawn at random, given to `calibrate optics`: is what it writes worse on the others?

python -m benchmarks.calibration [20 [UNIT ...]], a line each draw: errors on these by file and fit
"""

import sys
import time

import numpy as np

from benchmarks import photographs
from benchmarks.results_page import in_own_processes
from tacgen.base.terminal import say
from tacgen.calibrate import optics, photometric_fit, solved_presses, steps
from tacgen.calibrate.photometric_model import FitLimits
from tacgen.calibrate.photos import Photos
from tacgen.calibrate.render_comparison import Comparison
from tacgen.recipe import assets

FILES = {"gelsight_mini_unit2": "gelsight_mini", "gelsight_mini": "gelsight_mini", "digit": "digit"}
GIVEN = 5  # presses of a draw


def draws(presses: int, count: int) -> list[list[int]]:
    """Numbers of the presses that each draw gives, no choice twice."""
    tried = (np.random.default_rng(seed).permutation(presses)[:GIVEN].tolist() for seed in range(9 * count))
    return [list(some) for some in dict.fromkeys(tuple(sorted(one)) for one in tried)][:count]


def judged(name: str, given: list[int]) -> tuple[list[float], bool, str]:
    """Errors of normals [deg] in a unit's presses by the shipped file or a fit to some; whether it is written; told."""
    unit, sensor, written, told = photographs.unit(name), photographs.sensor_of(FILES[name]), True, ""
    assert unit is not None
    steps.MAX_WORKERS = 1  # the other cores have draws of their own
    presses, faces = solved_presses.faced(sensor, unit.presses, {})
    if given:
        drawn, begun = photographs.as_drawn(name, unit.folder), time.process_time()
        photos = Photos(unit.folder, unit.untouched, tuple(drawn[k] for k in given))
        fit = optics.calibrated(assets.sensor_path(FILES[name]), photos, FitLimits(bare=True))
        written, told = not fit.problem(), f"{time.process_time() - begun:.0f} s; by itself {fit.fitted.unseen}"
        sensor = photometric_fit.at_scale(sensor, fit.fitted.sensor)
    return Comparison(sensor).likeness(presses, faces, unit.untouched).each.tolist(), written, told


def main() -> None:
    """Draw, fit, judge and sum up."""
    count, *names = sys.argv[1:] or ["20"]
    for name in names or FILES:
        chosen = draws(len(photographs.as_drawn(name, photographs.reference() / name)), int(count))
        gains = list[float]()
        jobs = [(name, given) for given in [[], *chosen]]
        shipped = next(found := in_own_processes("benchmarks.calibration:judged", jobs))
        for given, (each, written, told) in zip(chosen, found, strict=True):
            before, after = (np.delete(one, given).mean() for one in (shipped[0], each))
            gains += [before - after] if written else []
            say(f"{name} {given}: {'written' if written else 'refused'}, {before:.2f} deg, fit {after:.2f}; {told}")
        say(f"{name}: {len(gains)} of {len(chosen)} written, {sum(gain < 0 for gain in gains)} of them worse")


if __name__ == "__main__":
    main()
