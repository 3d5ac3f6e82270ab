"""Compile all code and fill the caches for every shipped sensor, so that later runs start at once."""

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from tacgen.base.errors import UserError
from tacgen.base.machine import cores
from tacgen.batch.local import Pool
from tacgen.recipe import assets, plan
from tacgen.recipe.row import Row

WARM_TRAJECTORY = "trajectory=[{press: {depth_mm: 0.2, frames: 1}}]"
WARM_OUTPUTS = "force, traction, force_map, height, normals, gap, flow, material, rgb, stress"


def warm() -> Iterator[tuple[str, bool, str]]:
    """Press a ball on each sensor with all outputs: yields the sensor's name, success, and a note (time or reason)."""
    with TemporaryDirectory() as folder, Pool(min(2, cores())) as pool:
        for sensor in assets.list_sensors():
            try:
                row = _touched(sensor)
            except UserError as error:  # its images need a package that is not installed
                yield sensor, False, error.lines[0]
                continue
            (result,) = pool.run([row], Path(folder) / sensor)
            seconds = sum(result.seconds.values())
            took = f"{seconds:.0f} s, {result.seconds.get('compile', 0.0):.0f} s of them compiling"
            yield sensor, result.status == "ok", result.reason or took


def _touched(sensor: str) -> Row:
    recipe = assets.recipe_path("quickstart")
    (row,) = plan.load(recipe, [f"sensor={sensor}", "outputs=[force]", WARM_TRAJECTORY]).rows
    outputs = WARM_OUTPUTS if row.sensor.markers is None else f"{WARM_OUTPUTS}, markers"
    return plan.load(recipe, [f"sensor={sensor}", f"outputs=[{outputs}]", WARM_TRAJECTORY]).rows[0]
