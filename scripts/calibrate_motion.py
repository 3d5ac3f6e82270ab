"""Fit a sensor's `markers.motion` (tacgen/outputs/fots_markers.py) to the marker motion of the solved gel.

    python scripts/calibrate_motion.py [--sensor gelsight_mini] [--quality default]

A ball is pressed, slid until it slips and twisted; a smaller ball and a flat punch, which are not fitted, give the
error.
"""
# ruff: noqa: E402

import argparse
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"

import numpy as np
from scipy.optimize import least_squares

from tacgen import mechanics
from tacgen.mechanics import mesh, presolve
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.coating import centers
from tacgen.outputs import fots_markers
from tacgen.outputs.gel_surface import seen
from tacgen.recipe import assets, plan, scene_of_row
from tacgen.sensor.markers import Motion

MOVES = "[{press: {depth_mm: 0.8, frames: 3}}, {slide: {x_mm: 1.2, y_mm: 0.4, frames: 4}}, {release: {frames: 1}}, "
MOVES += "{press: {depth_mm: 0.8, frames: 1}}, {twist: {angle_deg: 30, frames: 4}}]"
FITTED = ("{shape: sphere, radius_mm: 4}",)
HELD_OUT = ("{shape: sphere, radius_mm: 2.5}", "{shape: cylinder, radius_mm: 3, fillet_mm: 0.6}")
START = (0.002, 0.05, 0.5, 0.03, 10.0, 0.05)


class Shown:
    """Solved marker motion under one indenter: poses, and sideways motion of the markers [mm], in each frame."""

    def __init__(self, sensor: str, indenter: str, quality: str) -> None:
        sets = (f"sensor={sensor}", f"indenter={indenter}", f"trajectory={MOVES}", "outputs=[markers]")
        row = plan.load(assets.recipe_path("quickstart"), (*sets, f"quality={quality}")).rows[0]
        assert row.sensor.markers is not None
        built = presolve.presolved(scene_of_row.build(row))
        problem = mechanics.Problem.of(built, mesh.of(built))
        face, self.rest = seen(problem.mesh, len(row.sensor.gel.clear_layers)), centers(row.sensor.markers)
        self.gel, self.shape, self.camera = row.sensor.gel, problem.contact.shape, PinholeCamera.from_sensor(row.sensor)
        states = list(mechanics.states(built, problem))
        self.poses = [state.pose for state in states]
        still = self.camera.project(face.at(self.rest))
        self.moved = np.array([self.camera.project(face.moved(state.x).at(self.rest)) - still for state in states])

    def drifted(self, numbers: np.ndarray) -> np.ndarray:
        """The same by the exponential functions."""
        press, shear, twist = np.reshape(numbers, (3, 2))
        motion = Motion(press=tuple(press), shear=tuple(shear), twist=tuple(twist), source="trial")
        model = fots_markers.FotsMarkers(motion, self.rest, self.gel, self.shape, self.camera)
        return np.array([model.at(pose)[0] - model.undisturbed for pose in self.poses])

    def error(self, numbers: np.ndarray) -> str:
        off, size = self.drifted(numbers) - self.moved, self.moved
        return (
            f"RMS {np.sqrt(np.mean(off**2)):.3f} px of {np.sqrt(np.mean(size**2)):.3f} px,"
            f" worst dot {np.linalg.norm(off, axis=-1).max():.2f} of {np.linalg.norm(size, axis=-1).max():.2f} px"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensor", default="gelsight_mini")
    parser.add_argument("--quality", default="default")
    asked = parser.parse_args()
    fitted = [Shown(asked.sensor, indenter, asked.quality) for indenter in FITTED]

    def residual(numbers: np.ndarray) -> np.ndarray:
        return np.concatenate([(shown.drifted(numbers) - shown.moved).ravel() for shown in fitted])

    low, high = (-1.0, 1e-4, 1e-3, 1e-4, 0.1, 1e-4), (1.0, 5.0, 5.0, 5.0, 90.0, 5.0)
    found = least_squares(residual, START, bounds=(low, high), x_scale=np.abs(START))
    press, shear, twist = np.reshape(found.x, (3, 2))
    for name, pair in (("press", press), ("shear", shear), ("twist", twist)):
        print(f"{name}: [{pair[0]:.4g}, {pair[1]:.4g}]")
    for indenter, shown in zip(FITTED, fitted, strict=True):
        print(f"fitted    {indenter}: {shown.error(found.x)}")
    for indenter in HELD_OUT:
        print(f"held out  {indenter}: {Shown(asked.sensor, indenter, asked.quality).error(found.x)}")


if __name__ == "__main__":
    main()
