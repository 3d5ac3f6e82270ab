"""How often the 95 % intervals of `tacgen calibrate unit` cover the truth, on synthetic units.

    python scripts/unit_coverage.py [--units 24] [--first 0] [--sensor gelsight_mini] [--balls 4 8] [--presses 5]

Each unit is the sensor file with another thickness, modulus, zero of the gauge and strength of each LED, all drawn at
random. Balls are pressed into it at random places to random forces; faces are solved and rendered as in any scene, with
the camera's noise, and forces have an error of 2 % and 0.05 N. The fit starts from the file. A unit takes about half a
minute beyond the first, whose presses are kept in the cache.
"""

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import cast

import numpy as np
from PIL import Image

from tacgen import mechanics
from tacgen.calibrate import ball_dents, unit, unit_fitting, unit_photos
from tacgen.mechanics import mesh, presolve
from tacgen.optics.surface_grid import Surface
from tacgen.outputs import gel_surface
from tacgen.recipe import assets, loading, plan, scene_of_row
from tacgen.recipe.model import Recipe
from tacgen.render.images import Renderer
from tacgen.sensor.model import LitSensor

THICKNESS, MODULUS, POWER, ZERO = 0.35, 0.6, 0.2, 0.4  # half ranges of logarithms, and of the zero [N]
PART, EVEN = 0.02, 0.05  # error of forces: share of the force, and [N]
PLACES = 0.12  # of the gel's sides: largest distance of a press from the middle
DEPTH = (0.12, 0.38)  # range of depths over the gel's thickness; also at most the ball's radius times SHARE
SHARE = 0.3


@dataclass(frozen=True)
class Truth:
    """Numbers of a synthetic unit."""

    thickness: float  # [mm]
    modulus: float  # times the file's
    zero: float  # [N]


def made(sensor: LitSensor, truth: Truth, random: np.random.Generator) -> LitSensor:
    """The sensor of a unit."""
    one = ball_dents.with_thickness(sensor, truth.thickness)
    layers = tuple(
        layer.model_copy(update={"youngs_modulus_mpa": layer.youngs_modulus_mpa * truth.modulus})
        for layer in one.gel.layers
    )
    leds = tuple(led.model_copy(update={"power": float(np.exp(random.uniform(-2 * POWER, 0)))}) for led in one.leds)
    return one.model_copy(update={"gel": one.gel.model_copy(update={"layers": layers}), "leds": leds, "markers": None})


def pressed(
    sensor: LitSensor, ball: float, depths: list[float], at: tuple[float, float]
) -> list[tuple[Surface, float]]:
    """Face and force [N] of a ball at increasing depths [mm]."""
    recipe = {
        "tacgen": 1, "name": "press", "sensor": sensor.name, "outputs": ["force"], "quality": "draft",
        "start": {"x_mm": at[0], "y_mm": at[1]}, "contact": {"friction": unit.Asked().friction},
        "indenter": {"shape": "sphere", "radius_mm": ball},
        "trajectory": [{"press": {"depth_mm": depth, "frames": 1}} for depth in depths],
    }  # fmt: skip
    (row,) = plan.expand(loading.checked(Recipe.model_validate(recipe), sensor)).rows
    built = presolve.presolved(scene_of_row.build(row))
    problem = mechanics.Problem.of(built, mesh.of(built))
    untouched = gel_surface.seen(problem.mesh, len(sensor.gel.clear_layers))
    return [(untouched.pressed(problem, s), mechanics.normal_force(s)) for s in mechanics.states(built, problem)]


def photograph(
    sensor: LitSensor, truth: Truth, balls: list[float], presses: int, random: np.random.Generator, folder: Path
) -> None:
    """A folder as `calibrate unit` takes it."""
    camera = Renderer(sensor, 16, 0, markers=False)
    Image.fromarray(camera.develop(camera.flat(), random)).save(folder / "background.png")
    rows, gel = ["file,ball_radius_mm,force_n"], sensor.gel
    for ball in balls:
        for k in range(presses):
            depth = min(float(random.uniform(*DEPTH)) * gel.thickness_mm, SHARE * ball)
            at = tuple(float(random.uniform(-PLACES, PLACES)) * side for side in (gel.width_mm, gel.height_mm))
            (face, force) = pressed(sensor, ball, [depth / 2, depth], (at[0], at[1]))[-1]
            read = truth.zero + force + float(random.normal()) * float(np.hypot(PART * force, EVEN))
            name = f"ball_{ball:g}_{k}.png"
            Image.fromarray(camera.develop(camera.image(face), random)).save(folder / name)
            rows.append(f"{name},{ball:g},{read:.4f}")
    (folder / "presses.csv").write_text("\n".join(rows) + "\n")


def draw(
    sensor_name: str, balls: list[float], presses: int, seed: int, keep: bool
) -> dict[str, tuple[float, float, float, float]]:
    """Truth, estimate and ends of the interval of each number of one unit."""
    random = np.random.default_rng(seed)
    sensor = cast(LitSensor, loading.read_sensor(assets.sensor_path(sensor_name))[0])
    thick = sensor.gel.thickness_mm * float(np.exp(random.uniform(-THICKNESS, THICKNESS)))
    truth = Truth(thick, float(np.exp(random.uniform(-MODULUS, MODULUS))), float(random.uniform(-ZERO, ZERO)))
    with TemporaryDirectory() as scratch:
        photograph(made(sensor, truth, random), truth, balls, presses, random, Path(scratch))
        work = unit_fitting.Work.of(
            sensor, unit_photos.read(Path(scratch), sensor.camera), unit.Asked(thickness=not keep)
        )
        raw = work.fitted()
        found = work.corrected(raw)
    out = {name: (getattr(truth, name), e.value, e.low, e.high) for name, e in
           (("thickness", found.thickness), ("modulus", found.modulus), ("zero", found.zero))}  # fmt: skip
    shown = ", ".join(f"{name} {t:.3f}: {v:.3f} ({a:.3f} to {b:.3f}){'' if a <= t <= b else ' MISSED'}"
                      for name, (t, v, a, b) in out.items())  # fmt: skip
    print(f"unit {seed}: {shown}; explained {found.optics.explained:.3f}", flush=True)
    return out


def main() -> None:
    """Draw units and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=int, default=24)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--sensor", default="gelsight_mini")
    parser.add_argument("--balls", type=float, nargs="+", default=[4.0, 8.0])
    parser.add_argument("--presses", type=int, default=5, help="of each ball")
    parser.add_argument("--keep-thickness", action="store_true")
    parser.add_argument("--out", type=Path, help="also write all numbers here, as JSON")
    asked = parser.parse_args()
    seeds = range(asked.first, asked.first + asked.units)
    every = [draw(asked.sensor, asked.balls, asked.presses, seed, asked.keep_thickness) for seed in seeds]
    for name in every[0]:
        true, value, low, high = np.array([one[name] for one in every]).T
        inside, off = (low <= true) & (true <= high), np.log(value / true) if name != "zero" else value - true
        unit_of = "N" if name == "zero" else "of the logarithm"
        print(f"{name}: {inside.sum()} of {len(every)} intervals cover the truth;"
              f" error {off.mean():+.3f} +- {off.std():.3f} ({unit_of})")  # fmt: skip
    if asked.out:
        asked.out.write_text(json.dumps(every))


if __name__ == "__main__":
    main()
