"""Rendered images next to photographs of real sensors; `tacgen bench real` has the numbers.

    python scripts/compare.py [gelsight_mini|digit|ninedtact] [--photos ../shared/reference] [-o out] [--file mine.yaml]

Without a sensor, all of them. Each row is a photograph, the rendered image, and the change of both from the untouched
image, twice as strong on grey. If there are no photographs it says so and ends with exit code 0.
"""

import argparse
import sys
from pathlib import Path
from typing import cast

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from benchmarks import photographs  # noqa: E402
from tacgen.calibrate import press_faces  # noqa: E402
from tacgen.recipe import assets, loading  # noqa: E402
from tacgen.render.images import Renderer  # noqa: E402
from tacgen.sensor.model import LitSensor  # noqa: E402


def grey(change: np.ndarray) -> np.ndarray:
    """A change of colour [counts], made visible."""
    return np.clip(128 + 2 * change, 0, 255).astype(np.uint8)


def rows(unit: photographs.Unit, sensor: LitSensor, spp: int) -> list[np.ndarray]:
    """A sensor's pictures beside a unit's."""
    renderer = Renderer(sensor, spp, 0, markers=False)
    flat, strips = renderer.develop(renderer.flat()), []
    for press in unit.presses:
        made = renderer.develop(renderer.image(press_faces.face(sensor, press, {})))
        changes = [grey(a.astype(float) - b) for a, b in ((press.picture, unit.untouched), (made, flat))]
        strips.append(np.hstack([press.picture, made, *changes]))
    return [np.hstack([unit.untouched, flat, *[np.full_like(flat, 128)] * 2]), *strips]


def main() -> None:
    """Render, lay side by side, write the pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sensor", choices=photographs.UNTOUCHED, nargs="?")
    parser.add_argument("--photos", type=Path, help="a folder a sensor in it")
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "out", help="where compare_SENSOR.png goes")
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--file", type=Path, help="the sensor file; the shipped one if not given")
    asked = parser.parse_args()
    for name in [asked.sensor] if asked.sensor else photographs.UNTOUCHED:
        unit = photographs.unit(name, asked.photos)
        if unit is None:
            print(f"{name}: no photographs in {asked.photos or photographs.reference()}, nothing to compare with")
            continue
        sensor = cast(LitSensor, loading.read_sensor(asked.file or assets.sensor_path(name))[0])
        out = asked.out / f"compare_{name}.png"
        out.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.vstack(rows(unit, sensor, asked.spp))).save(out)
        print(f"{out}: photograph, rendered, change of each")


if __name__ == "__main__":
    main()
