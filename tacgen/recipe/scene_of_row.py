"""The scene of one row of a plan: gel, laws, indenter, path and tolerances as arrays and numbers."""

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from tacgen.base.errors import UserError
from tacgen.geometry import mesh_file, mesh_import
from tacgen.geometry.analytic_sdf import Shape
from tacgen.geometry.gel import GelBody, GelLayer, SolidGel
from tacgen.mechanics.expected_error import Expected, expected_force_error
from tacgen.mechanics.scene import GelDynamics, Scene
from tacgen.recipe import indenters, trajectory
from tacgen.recipe.checks import MAX_EDGE_PER_THICKNESS, timed
from tacgen.recipe.model import QUALITIES, QualityNumbers
from tacgen.recipe.path import Path as IndenterPath
from tacgen.recipe.path import indenter_path, sunk_beside
from tacgen.recipe.row import Row
from tacgen.sensor.model import Sensor

Array = np.ndarray
TONNES_PER_MM3 = 1e-12  # 1 kg/m^3 in t/mm^3
MATCHED_FORCE_TOL = 2e-3  # of a force that is asked for on several sensors: within this part of it in every frame [-]
SDF_CELL_PER_EDGE = 0.25  # cell of a mesh's signed distance over the element edge [-]
# radius of a mesh's sharp edges over dhat [-]: the mean gap of a light press, which contact takes off
SHARP_RADIUS_PER_DHAT = 0.75
# element edges [mm] between which one is chosen by the error of the force: finer ones take minutes a frame
MIN_CHOSEN_EDGE_MM, MAX_CHOSEN_EDGE_MM = 0.15, 1.0
TRIED_EDGE_RATIO = 0.97  # ratio of two edges that are tried [-]


def _reach_of_gel(row: Row, solid: mesh_file.SolidMesh) -> tuple[float, float]:
    """Region of the indenter that the gel can reach: distance from its z axis, height above its lowest point [mm]."""
    gel = row.sensor.gel
    steps = row.recipe.trajectory
    if row.recipe.match == "grip":  # the table's poses are the gripper's
        return np.inf, np.inf
    poses = [row_.pose for number, step in enumerate(steps) if step.replay for row_ in row.replayed(number)]
    if row.recipe.match == "force":  # heights may be off by any amount: with those at which the face is touched
        touching = np.array(poses)
        touching[:, 2, 3] = -(touching[:, 2, :3] @ solid.vertices.T).min(axis=1)
        poses += [*touching]
    leans = any(np.hypot(*pose[2, :2]) > 2e-9 or pose[2, 2] < 0 for pose in poses)
    tilted = leans or row.recipe.start.tilt_deg > 0 or any(step.tilt for step in steps) or row.recipe.grasp is not None
    rise = gel.thickness_mm + 1.0  # [mm] largest depth, and gel bulging beside it
    diagonal = float(np.hypot(gel.width_mm, gel.height_mm))
    aside = max((float(np.hypot(*(pose[:3, :2].T @ pose[:3, 3]))) for pose in poses), default=0.0)  # pad's centre
    half = max(diagonal + 1.0, aside + diagonal / 2 + rise)
    if tilted:
        return half, np.inf
    return half, rise + sunk_beside(row.recipe, solid, gel.pad, row.replayed)


def shape_of(row: Row) -> Shape:
    """The signed distance of the indenter; of a mesh on a grid that covers what the gel can reach."""
    indenter = row.recipe.indenter
    if (shape := indenters.analytic(indenter)) is not None:
        return shape
    assert indenter.shape == "mesh"
    read = mesh_file.read(row.mesh_path)
    solid = mesh_import.placed(read, up=indenter.up, scale=indenter.scale, size=indenter.size_mm)
    (half, height), quality = _reach_of_gel(row, solid), row.recipe.resolved()
    mesh_import.refuse_thin_walls(solid, quality.dhat_mm, height)
    sizes = {"cell": SDF_CELL_PER_EDGE * quality.edge_mm, "radius": SHARP_RADIUS_PER_DHAT * quality.dhat_mm}
    return mesh_import.field(solid, **sizes, height=height, half=half)


def gel_of(sensor: Sensor, solid_path: Path | None = None) -> GelBody:
    """The gel with its laws; a solid is read from the file at `solid_path`."""
    layers = []
    for layer in sensor.gel.layers:
        law = layer.material()
        modulus = 9 * law.kappa * law.mu / (3 * law.kappa + law.mu)
        layers.append(GelLayer(layer.thickness_mm, law, modulus, layer.terms))
    g = sensor.gel
    if g.solid is not None and solid_path is not None:
        solid = mesh_import.placed(mesh_file.read(solid_path), up=g.solid.up, scale=g.solid.scale)
        bonded, coated = (float(np.radians(angle)) for angle in (g.solid.bonded_deg, g.solid.coated_deg))
        made = SolidGel(**vars(g.pad), layers=tuple(layers), solid=solid, bonded=bonded, coated=coated)
        return replace(made, held=g.solid.bonded_mm)
    return GelBody(**vars(g.pad), layers=tuple(layers))


def build(row: Row) -> Scene:
    """The scene of one row of a plan. Raises UserError: no mesh has the `force_error` that is asked for."""
    scene = _scene(row)
    if (error := row.recipe.force_error) is None:
        return scene
    if (numbers := _by_error(scene, error)) is None:  # nothing touches
        return scene
    numbers = numbers.model_copy(update={"spp": row.recipe.resolved().spp})
    return _scene(replace(row, recipe=row.recipe.model_copy(update={"quality": numbers})))


def _by_error(scene: Scene, error: float) -> QualityNumbers | None:
    """The longest edge with this expected error of the force [-], and the range of contact that belongs to it; None if
    nothing touches. Raises UserError: the error of this scene is not known, or asks for too short edges."""
    expected = Expected.of(scene)
    if expected is None:
        if scene.element == "linear_tet":
            raise UserError("quality.force_error: is not known for linear tetrahedra: give edge_mm")
        return None
    most = min(MAX_CHOSEN_EDGE_MM, MAX_EDGE_PER_THICKNESS * scene.gel.thickness)
    edge = expected.edge_with(error, most, TRIED_EDGE_RATIO)
    if edge < MIN_CHOSEN_EDGE_MM:
        least = expected_force_error(MIN_CHOSEN_EDGE_MM, expected.contact, expected.radius)
        raise UserError(
            f"quality.force_error: {error:.2g} asks for edges below {MIN_CHOSEN_EDGE_MM:g} mm, where the expected error"
            f" is {least:.2g}: ask for a larger one, or for edge_mm"
        )
    return QualityNumbers(edge_mm=float(f"{edge:.3g}"), dhat_mm=float(f"{_range_of(edge):.2g}"))


def _range_of(edge: float) -> float:
    """Range of the barrier [mm] at an element edge [mm]: the presets', between them and beyond by powers."""
    known = sorted((quality.edge_mm, quality.dhat_mm) for quality in QUALITIES.values())
    edges, ranges = np.log(known).T
    part = np.searchsorted(edges[1:-1], np.log(edge))  # of the two powers
    power = (ranges[part + 1] - ranges[part]) / (edges[part + 1] - edges[part])
    return float(np.exp(ranges[part] + power * (np.log(edge) - edges[part])))


def _scene(row: Row) -> Scene:
    recipe, quality = row.recipe, row.recipe.resolved()
    gel = gel_of(row.sensor, row.solid_path)
    shape = shape_of(row)
    path = indenter_path(recipe, shape, gel, row.replayed)
    friction, edge, dhat = recipe.contact.friction, quality.edge_mm, quality.dhat_mm
    element = recipe.mesh or ("hex" if row.sensor.gel.solid is None else "tet")
    positions = np.concatenate([path.start[None], path.poses])[:, :2, 3]
    off_face = positions[~gel.contains(*positions.T)] if isinstance(gel, SolidGel) else positions[:0]
    if len(off_face):
        x, y = off_face[0]
        raise UserError(f"trajectory: would carry the indenter's axis off the gel's coated face, to ({x:g}, {y:g})")
    forced = path.forced
    if forced is not None and row.pair is not None:
        forced = replace(forced, tol=MATCHED_FORCE_TOL)
    dynamics = None
    if (asked := recipe.dynamics) is not None:
        damping, density = asked.rayleigh, asked.density_kg_m3 * TONNES_PER_MM3
        dynamics = GelDynamics(density, damping.alpha_per_s, damping.beta_s, asked.step_s or math.inf)
    more = (forced, dynamics, _durations(row, path), element, path.turns, path.match, recipe.differentiable)
    return Scene(gel, shape, path.poses, path.start, path.segment, friction, edge, dhat, *more)


def _durations(row: Row, path: IndenterPath) -> Array | None:
    """Duration (N,) of each frame [s]. For a replay, the time between its rows; its first frame takes as long as the
    second. None if time does not matter."""
    if not timed(row.recipe, row.sensor):
        return None
    usual = 0.0 if row.recipe.dynamics is None else row.recipe.dynamics.frame_s or 0.0
    origins = np.concatenate([path.start[None], path.poses])[:, :3, 3]
    duration: list[float] = []  # recipe/checks.py has checked that each movement has one
    for number, step in enumerate(row.recipe.trajectory):
        if isinstance(step.move, trajectory.Replay):
            apart = [b.time - a.time for a, b in pairwise(row.replayed(number))] or [usual]
            duration += [apart[0], *apart][: step.frames]
        else:
            moved = origins[len(duration) + step.frames] - origins[len(duration)]
            seconds = step.move.seconds(float(np.linalg.norm(moved)))
            if seconds == 0:
                raise UserError(f"trajectory[{number}].{step.kind}.speed_mm_s: takes no time, since nothing moves")
            duration += [usual if seconds is None else seconds / step.frames] * step.frames
    return np.array(duration)
