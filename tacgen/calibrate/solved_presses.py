"""Presses of a ball, solved: the face under a photographed ball, and which presses can be solved."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tacgen import mechanics
from tacgen.base.errors import UserError
from tacgen.calibrate import steps
from tacgen.calibrate.photos import PhotographedPress, Photos
from tacgen.mechanics import mesh, presolve
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.hertz_dent import BallDent
from tacgen.optics.surface_grid import Surface, Untouched
from tacgen.outputs import gel_surface
from tacgen.recipe import loading, plan, scene_of_row
from tacgen.recipe.model import Recipe
from tacgen.recipe.row import Row
from tacgen.sensor.model import Gel, LitSensor
from tacgen.sensor.yaml_source import KeyPath

# Over the thickness of the gel [-]. Below, the contact is smaller than the mesh's cells (depths in metres are, in any
# gel); above, the elements between indenter and base are crushed, and solves fail or take minutes.
MIN_PRESS_DEPTH_RATIO, MAX_PRESS_DEPTH_RATIO = 0.005, 0.6

DEPTH_SOLVE_S, FORCE_SOLVE_S = 2.0, 8.0  # expected work of a press [s of a core]


def problem(gel: Gel, at: tuple[float, float], depth: float | None = None, deeper: float = 1.0) -> str:
    """Why a press at (x, y) [mm], to a depth [mm] if it is known and to `deeper` times that, cannot be solved; empty if
    it can."""
    if abs(at[0]) > gel.width_mm / 2 or abs(at[1]) > gel.height_mm / 2:
        return f"lies beside the gel, at ({at[0]:.3g}, {at[1]:.3g}) mm: see x_px, y_px"
    if depth is None:
        return ""
    thick = gel.thickness_mm - gel.drop_mm(*at)
    low, high = MIN_PRESS_DEPTH_RATIO * thick, MAX_PRESS_DEPTH_RATIO * thick / deeper
    if low <= depth <= high:
        return ""
    return f"must be from {low:.3g} to {high:.3g} mm in a gel of {thick:.3g} mm there (got {depth:.3g}): is it in mm?"


def check(sensor: LitSensor, photos: Photos, deeper: float = 1.0) -> None:
    """Raises UserError: presses whose depth, or up to `deeper` times that, cannot be solved, and presses of known force
    that lie beside the gel, a line each."""
    wrong = []
    for press in photos.presses:
        column = "force_n" if press.depth is None else "depth_mm"
        said = problem(sensor.gel, place(sensor, press.center, 0.0), press.depth, deeper)
        if press.solved and said:
            wrong.append(f"{photos.folder / press.name}: {column}: {said}")
    if wrong:
        raise UserError(wrong)


def press_row(
    sensor: LitSensor, ball: float, at: tuple[float, float], aims: Sequence[Mapping[str, float]], quality: str,
    friction: float = 0.0,
) -> Row:  # fmt: skip
    """The scene of presses of a ball of radius `ball` [mm] at (x, y) [mm], with a recipe's aim of each press.

    Raises UserError: the recipe is refused.
    """
    recipe = {
        "tacgen": 1, "name": "press", "sensor": sensor.name, "outputs": ["force"], "quality": quality,
        "start": {"x_mm": at[0], "y_mm": at[1]}, "contact": {"friction": friction},
        "indenter": {"shape": "sphere", "radius_mm": ball},
        "trajectory": [{"press": {**aim, "frames": 1}} for aim in aims],
    }  # fmt: skip
    (row,) = plan.expand(loading.checked(Recipe.model_validate(recipe), sensor)).rows
    return row


def solved_states(row: Row) -> tuple[mechanics.Problem, Iterator[mechanics.State]]:
    """The problem of a scene and its states, a frame each. The iterator raises NotConverged where the solver fails."""
    built = presolve.presolved(scene_of_row.build(row))
    problem = mechanics.Problem.of(built, mesh.of(built))
    return problem, mechanics.states(built, problem)


def contact_radius(problem: mechanics.Problem, state: mechanics.State) -> float:
    """Radius [mm] of a circle as large as the contact."""
    return float(np.sqrt(problem.contact.faces.areas[state.normal_force > 0].sum() / np.pi))


def faces(row: Row) -> Iterator[gel_surface.GelSurface]:
    """The face seen by the camera: untouched, then in each frame of a scene. No bundle is written."""
    problem, states = solved_states(row)
    untouched = gel_surface.seen(problem.mesh, len(row.sensor.gel.clear_layers))
    yield untouched
    for state in states:
        yield untouched.pressed(problem, state)


def faced(
    sensor: LitSensor, presses: Sequence[PhotographedPress], folders: dict[KeyPath, Path]
) -> tuple[tuple[PhotographedPress, ...], list[Surface]]:
    """Presses with the radius of their contact, and their faces, of which the solved ones are made on all cores;
    `folders`: see Row."""
    solving = [press for press in presses if press.solved]
    if not solving:
        return tuple(presses), [face(sensor, press, folders) for press in presses]
    seconds = sum(DEPTH_SOLVE_S if press.depth is not None else FORCE_SOLVE_S for press in solving)
    steps.expect(seconds)
    texts = [f"{press.name}: solved" for press in solving]
    jobs = [(sensor, press, folders) for press in solving]
    made = iter(steps.on_workers(_solved_one, jobs, texts, seconds / len(solving)))
    found = [next(made) if press.solved else (press, face(sensor, press, folders)) for press in presses]
    return tuple(press for press, _ in found), [one for _, one in found]


def _solved_one(
    sensor: LitSensor, press: PhotographedPress, folders: dict[KeyPath, Path]
) -> tuple[PhotographedPress, Surface]:
    """A press with the radius of its contact, by the solver if it is not given, and its solved face."""
    aim = {"depth_mm": press.depth} if press.depth is not None else {"force_n": press.force}
    ((found, radius),) = _solved(sensor, press, [aim], folders)
    contact = radius / sensor.camera.mm_per_px if press.contact is None else press.contact
    return replace(press, contact=contact), found


def face(sensor: LitSensor, press: PhotographedPress, folders: dict[KeyPath, Path]) -> Surface:
    """The face of a press: solved at its depth or else its force if known, else by a formula from its contact radius;
    `folders`: see Row."""
    if press.solved:
        return _solved_one(sensor, press, folders)[1]
    assert press.contact is not None
    untouched, camera = Untouched.of(sensor.gel), PinholeCamera.from_sensor(sensor)
    return BallDent.seen(camera, press.ball, press.center, press.contact, untouched, mean_curvature(sensor.gel))


def mean_curvature(gel: Gel) -> float:
    """Mean curvature [1/mm] of the untouched face at its top."""
    dome = gel.dome
    return 0.0 if dome is None else (1 / dome.radius_x_mm + 1 / dome.radius_y_mm) / 2


def solved(
    sensor: LitSensor, press: PhotographedPress, depths: Sequence[float], folders: dict[KeyPath, Path]
) -> list[Surface]:
    """Solved faces at increasing depths [mm], at the position of the ball in the photograph.

    Raises UserError: the solver fails.
    """
    return [one for one, _ in _solved(sensor, press, [{"depth_mm": float(depth)} for depth in depths], folders)]


def _solved(
    sensor: LitSensor, press: PhotographedPress, aims: Sequence[Mapping[str, Any]], folders: dict[KeyPath, Path]
) -> list[tuple[gel_surface.GelSurface, float]]:
    """Solved faces and contact radii [mm]. Raises UserError: the solver fails."""
    depth = float(np.mean([aim.get("depth_mm", 0.0) for aim in aims]))  # of the face where the camera sees the ball
    try:
        at, found = place(sensor, press.center, depth), []
        row = press_row(sensor, press.ball, at, aims, "default")
        problem, states = solved_states(replace(row, folders={**row.folders, **folders}))
        untouched = gel_surface.seen(problem.mesh, len(sensor.gel.clear_layers))
        for state in states:
            found.append((untouched.pressed(problem, state), contact_radius(problem, state)))
            steps.go_on(f"{len(found)} of {len(aims)}")
        return found
    except (UserError, mechanics.NotConverged) as error:
        raise UserError(f"{press.name}: cannot be solved: {line}" for line in str(error).splitlines()) from None


def place(sensor: LitSensor, pixel: tuple[float, float], depth: float) -> tuple[float, float]:
    """Position (x, y) [mm] of the point at `pixel` on the face pressed by `depth` [mm]."""
    camera, untouched, at = PinholeCamera.from_sensor(sensor), Untouched.of(sensor.gel), np.zeros((1, 2))
    origin, ray = camera.rays(np.array([pixel]))
    for _ in range(5):
        z = untouched.at(at)[:, 2] - depth
        at = (origin + ray * ((z - origin[:, 2]) / ray[:, 2])[:, None])[:, :2]
    return float(at[0, 0]), float(at[0, 1])
