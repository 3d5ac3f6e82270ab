"""The face under a photographed ball."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tacgen import mechanics
from tacgen.calibrate import press_forces
from tacgen.calibrate.photos import PhotographedPress, Photos
from tacgen.errors import UserError
from tacgen.mechanics import mesh, presolve
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.hertz_dent import BallDent
from tacgen.optics.surface_grid import Surface, Untouched
from tacgen.outputs import gel_surface
from tacgen.recipe import loading, plan, scene_of_row
from tacgen.recipe.model import Recipe
from tacgen.recipe.row import Row
from tacgen.sensor.model import LitSensor
from tacgen.sensor.yaml_source import KeyPath


def check(sensor: LitSensor, photos: Photos, deeper: float = 1.0) -> None:
    """Raises UserError: presses whose depth, or up to `deeper` times that, cannot be solved, and presses of known force
    that lie beside the gel, a line each."""
    wrong = []
    for press in photos.presses:
        if not press.solved:
            continue
        at = place(sensor, press.center, 0.0)
        if press.depth is None:
            column, said = "force_n", press_forces.place_problem(sensor.gel, at)
        else:
            column, said = "depth_mm", press_forces.depth_problem(sensor.gel, press.depth, at, deeper)
        if said:
            wrong.append(f"{photos.folder / press.name}: {column}: {said}")
    if wrong:
        raise UserError(wrong)


def face(sensor: LitSensor, press: PhotographedPress, folders: dict[KeyPath, Path]) -> Surface:
    """The face of a press: solved at its depth or else its force if known, else by a formula from its contact radius;
    `folders`: see Row."""
    if press.depth is not None:
        return solved(sensor, press, [press.depth], folders)[0]
    if press.force is not None:
        return _solved(sensor, press, [{"force_n": press.force}], 0.0, folders, "default")[0]
    assert press.contact is not None
    dome = sensor.gel.dome
    bend = 0.0 if dome is None else (1 / dome.radius_x_mm + 1 / dome.radius_y_mm) / 2
    untouched, camera = Untouched.of(sensor.gel), PinholeCamera.from_sensor(sensor)
    return BallDent.seen(camera, press.ball, press.center, press.contact, untouched, bend)


def solved(
    sensor: LitSensor,
    press: PhotographedPress,
    depths: Sequence[float],
    folders: dict[KeyPath, Path],
    quality: str = "default",
) -> Sequence[Surface]:
    """Solved faces at increasing depths [mm], at the position of the ball in the photograph.

    Raises UserError: the solver fails.
    """
    aims = [{"depth_mm": float(depth)} for depth in depths]
    return _solved(sensor, press, aims, float(np.mean(depths)), folders, quality)


def _solved(
    sensor: LitSensor,
    press: PhotographedPress,
    aims: Sequence[dict[str, float]],
    depth: float,
    folders: dict[KeyPath, Path],
    quality: str,
) -> Sequence[Surface]:
    """Solved faces at the aims of a recipe's presses; `depth` [mm]: of the face where the camera sees the ball."""
    x, y = place(sensor, press.center, depth)
    recipe = {
        "tacgen": 1, "name": "press", "sensor": sensor.name, "outputs": ["force"], "start": {"x_mm": x, "y_mm": y},
        "indenter": {"shape": "sphere", "radius_mm": press.ball}, "quality": quality,
        "trajectory": [{"press": {**aim, "frames": 1}} for aim in aims],
    }  # fmt: skip
    try:
        (row,) = plan.expand(loading.checked(Recipe.model_validate(recipe), sensor)).rows
        return list(faces(replace(row, folders={**row.folders, **folders})))[1:]
    except (UserError, mechanics.NotConverged) as error:
        raise UserError(f"{press.name}: cannot be solved: {line}" for line in str(error).splitlines()) from None


def faces(row: Row) -> Iterator[gel_surface.GelSurface]:
    """The face seen by the camera: untouched, then in each frame of a scene. No bundle is written."""
    built = presolve.presolved(scene_of_row.build(row))
    problem = mechanics.Problem.of(built, mesh.of(built))
    untouched = gel_surface.seen(problem.mesh, len(row.sensor.gel.clear_layers))
    yield untouched
    for state in mechanics.states(built, problem):
        yield untouched.pressed(problem, state)


def place(sensor: LitSensor, pixel: tuple[float, float], depth: float) -> tuple[float, float]:
    """Position (x, y) [mm] of the point at `pixel` on the face pressed by `depth` [mm]."""
    camera, untouched, at = PinholeCamera.from_sensor(sensor), Untouched.of(sensor.gel), np.zeros((1, 2))
    origin, ray = camera.rays(np.array([pixel]))
    for _ in range(5):
        z = untouched.at(at)[:, 2] - depth
        at = (origin + ray * ((z - origin[:, 2]) / ray[:, 2])[:, None])[:, :2]
    return float(at[0, 0]), float(at[0, 1])
