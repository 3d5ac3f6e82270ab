"""How far a quality's forces and pressure maps are from those of `reference`, sensor by sensor."""

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tacgen import assets, fields, maps, mesh, plan, scene, solve
from tacgen.optics.layers import Camera

Array = np.ndarray
PRESS = "trajectory=[{press: {depth_mm: %g, frames: 1}}]"
SLIDE = "trajectory=[{press: {depth_mm: %g, frames: 1}}, {slide: {x_mm: 0.6, frames: 2}}]"
DEPTHS = {"gelsight_mini": 1.0, "digit": 1.0, "ninedtact": 0.8}  # of a ball of 4 mm [mm]
SCENES = {
    f"{sensor} {name}": (f"sensor={sensor}", path % depth, f"contact.friction={friction}")
    for name, path, friction in (("press", PRESS, 0), ("slide", SLIDE, 0.5))
    for sensor, depth in DEPTHS.items()
}


@dataclass(frozen=True)
class Answer:
    """The last frame: force on the gel (3,) [N], pressure (h, w) [MPa], area in contact [mm^2], and what it cost."""

    force: Array
    pressure: Array
    area: float
    nodes: int
    seconds: float

    def line(self, name: str, quality: str, reference: "Answer | None" = None) -> str:
        """A row of the table, with the errors against `reference`."""
        fx, _, fz = self.force
        said = f"{name:<22} {quality:<10} {self.nodes:>6} {fz:9.4f} {fx:8.4f} {self.area:7.2f} {self.seconds:8.1f}"
        if reference is None:
            return said
        force = np.linalg.norm(self.force) / np.linalg.norm(reference.force) - 1
        off = np.linalg.norm(self.pressure - reference.pressure) / np.linalg.norm(reference.pressure)
        peak = self.pressure.max() / reference.pressure.max() - 1
        return f"{said} {force:+8.2%} {off:7.2%} {peak:+7.2%} {self.area / reference.area - 1:+7.2%}"


HEADER = (
    f"{'scene':<22} {'quality':<10} {'nodes':>6} {'Fz N':>9} {'Fx N':>8} {'mm^2':>7} {'CPU s':>8} {'force':>8}"
    f" {'map L2':>7} {'peak':>7} {'area':>7}"
)


def answer(sets: tuple[str, ...], quality: str, start: tuple[float, float] = (0.0, 0.0)) -> Answer:
    """Solve one scene at a quality; the ball starts at `start` [mm], so that its place in a cell can be varied."""
    begun = time.process_time()
    place = f"start={{x_mm: {start[0]}, y_mm: {start[1]}}}"
    plain = ("outputs=[force]", "indenter={shape: sphere, radius_mm: 4}", place)
    row = plan.load(assets.recipe_path("quickstart"), (*plain, *sets, f"quality={quality}")).rows[0]
    made = scene.build(row)
    problem = solve.Problem.of(made, mesh.of(made))
    *_, state = solve.states(made, problem)
    seconds = time.process_time() - begun
    surface = fields.Surface(problem.mesh.points, problem.mesh.facets["coated"])
    found = maps.maps(problem, surface.moved(state.x), state, Camera.from_sensor(row.sensor))
    force = state.traction_force.sum((0, 1))
    area = float(found.area[found.contact].sum())
    return Answer(force, np.nan_to_num(found.pressure), area, len(problem.mesh.points), seconds)


def table(names: list[str], qualities: list[str]) -> Iterator[str]:
    """The table, line by line; each scene's reference is solved first."""
    for name in names:
        reference = answer(SCENES[name], "reference")
        yield reference.line(name, "reference")
        for quality in qualities:
            yield answer(SCENES[name], quality).line(name, quality, reference)
