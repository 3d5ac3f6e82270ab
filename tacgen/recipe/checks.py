"""Checks that need the recipe and the sensor together: what this sensor cannot do."""

import math
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from tacgen.base.errors import UserError
from tacgen.outputs import IMAGE_OUTPUTS, OUTPUT_NAMES, OUTPUTS
from tacgen.recipe import assets, grasp_checks, trajectory_checks, usual_sizes
from tacgen.recipe.indenters import Indenter
from tacgen.recipe.model import Recipe
from tacgen.recipe.trajectory import Move, Paced, Replay, Slide, Timed
from tacgen.recipe.trajectory_checks import Folders
from tacgen.render import photograph
from tacgen.sensor.model import LIGHT_FIELDS, Gel, Sensor
from tacgen.sensor.validation_messages import Issue
from tacgen.sensor.yaml_source import KeyPath

BACKGROUND_KEY: KeyPath = ("render", "background")
MIN_HALF_THICKNESS_EDGES = 0.8  # of an indenter, over the element edge [-]; thinner ones pass between contact points
# of the mesh, over the gel's thickness [-]; on longer ones forces are off by half and more
MAX_EDGE_PER_THICKNESS = 0.5
# of an indenter, over the pad's diagonal [-]; larger balls are flat to a thousandth of the pad
MAX_INDENTER_SIZE_RATIO = 100.0


def recipe_problems(recipe: Recipe, sensor: Sensor, folders: Folders | None = None) -> list[Issue]:
    """Problems of a recipe that asks for what this sensor cannot do; paths start at the recipe's root.

    `folders`: the folder to which the path of each of its files is relative, by default the working directory.
    """
    folders = folders or {}
    wrong = [*output_problems(recipe, sensor)]
    if recipe.grasp is None:
        wrong += [*_depths(recipe, sensor), *_times(recipe, sensor, folders)]
    wrong += [*_solved(recipe, sensor), *_too_large(recipe.indenter, sensor.gel), *_too_coarse(recipe, sensor.gel)]
    edge = recipe.resolved().edge_mm
    wrong += _too_thin(recipe.indenter, edge)
    wrong += _mesh_file(recipe.indenter, edge, folders.get(("indenter", "file")))
    wrong += grasp_checks.problems(recipe, sensor, folders)
    wrong += [] if recipe.grasp else trajectory_checks.problems(recipe, sensor.gel, folders)
    return wrong + _photo(recipe, sensor, folders.get(BACKGROUND_KEY))


def _solved(recipe: Recipe, sensor: Sensor) -> Iterator[Issue]:
    """The mesh, and the deviations that are propagated."""
    if recipe.mesh == "hex" and sensor.gel.solid is not None:
        text = f"cannot be hex: the gel of {sensor.name} is a solid, which is meshed by tets: leave mesh out"
        yield Issue(("mesh",), text)
    if recipe.uncertainty is None:
        return
    if recipe.grasp is not None or timed(recipe, sensor):
        text = "needs quasi-static frames without a grasp: leave it out, or grasp, dynamics and viscosity"
        yield Issue(("uncertainty",), text)
    if (depth := recipe.uncertainty.pose.depth_mm) > (most := sensor.gel.thickness_mm):
        text = f"must be at most the gel's thickness, {most:g} mm (got {depth:g})"
        yield Issue(("uncertainty", "pose", "depth_mm"), text)


def _depths(recipe: Recipe, sensor: Sensor) -> Iterator[Issue]:
    """A press must be less deep than the gel is thick under the start."""
    thick = usual_sizes.thickness_mm(recipe, sensor.gel)
    for i, segment in enumerate(recipe.trajectory):
        depth = segment.press.depth_mm if segment.press else None
        if depth is not None and depth >= thick:
            text = f"must be less than the gel is thick, {thick:g} mm (got {depth:g})"
            yield Issue(("trajectory", i, "press", "depth_mm"), text)


def timed(recipe: Recipe, sensor: Sensor) -> bool:
    """Whether time matters: with dynamics, or on a viscoelastic gel if any movement has a duration."""
    return recipe.dynamics is not None or (sensor.gel.viscous and any(_lasts(step.move) for step in recipe.trajectory))


def _lasts(move: Move) -> bool:
    """Whether a movement says how long it takes."""
    return not isinstance(move, Timed) or move.seconds(1.0) is not None


def _times(recipe: Recipe, sensor: Sensor, folders: Folders) -> Iterator[Issue]:
    """If time matters, every movement needs a duration; if not, none may have one."""
    count, dynamics, forced = timed(recipe, sensor), recipe.dynamics, False
    for i, step in enumerate(recipe.trajectory):
        where: KeyPath = ("trajectory", i, step.kind)
        known, paced = _lasts(step.move), isinstance(step.move, Paced) and step.move.speed_mm_s is not None
        forced = forced or getattr(step.move, "force_n", None) is not None
        forced = forced or (isinstance(step.move, Replay) and step.move.matched)
        if not count:
            if isinstance(step.move, Timed) and known:
                text = "has no effect without dynamics or a viscoelastic gel: leave it out, or add one of them"
                yield Issue((*where, "speed_mm_s" if paced else "duration_s"), text, at_key=True)
        elif forced and paced and not isinstance(step.move, Slide):
            text = "needs a way that is known, which force_n leaves open: say duration_s"
            yield Issue((*where, "speed_mm_s"), text, at_key=True)
        elif dynamics is None or dynamics.frame_s is None:
            if isinstance(step.move, Replay):
                with suppress(UserError):  # told already
                    known = len(trajectory_checks.replayed(step.move, folders.get((*where, "file")))) > 1
            if not known:
                more = "as others do" if dynamics is None else "or frame_s under dynamics"
                yield Issue(where, f"must say how long it takes: duration_s, {more}")


def output_problems(recipe: Recipe, sensor: Sensor) -> Iterator[Issue]:
    """Problems of outputs that need what the sensor does not have."""
    named = " and ".join(n for n in OUTPUT_NAMES if n in recipe.outputs and OUTPUTS[n].needs == "markers")
    if named and sensor.markers is None:
        text = f"asks for {named}, and the sensor {sensor.name} has none: leave them out, or add markers to its file"
        yield Issue(("outputs",), text)
    if named and not _on_gel(sensor):
        text = f"asks for {named}, and some of the sensor {sensor.name} would lie beside its gel: fewer, or closer ones"
        yield Issue(("outputs",), text)
    if (images := recipe.outputs & IMAGE_OUTPUTS) and not sensor.lit:
        asked = " and ".join(sorted(images))
        lacking = ", ".join(name for name in LIGHT_FIELDS if getattr(sensor, name) is None)
        text = f"asks for {asked}: the sensor {sensor.name} has no {lacking}: add them to its file"
        yield Issue(("outputs",), text)
    if images and recipe.render.method == "table" and any(layer.scattering for layer in sensor.gel.clear_layers):
        told = "whose light follows the face's slope"
        text = f"cannot be table, {told}: the gel of {sensor.name} scatters; take transport"
        yield Issue(("render", "method"), text)
    if images and recipe.render.method != "transport" and sensor.camera.aspect != 1:
        text = f"must be transport: the pixels of {sensor.name} are not square (camera.pixel_aspect)"
        yield Issue(("render", "method"), text)
    if recipe.markers.method == "analytic" and (sensor.markers is None or sensor.markers.motion is None):
        text = f"cannot be analytic: the sensor file {sensor.name} holds no markers.motion: take fem"
        yield Issue(("markers", "method"), text)


def _on_gel(sensor: Sensor) -> bool:
    """Whether both ends of each row of markers lie on the pad, and so all of it."""
    if (dots := sensor.markers) is None:
        return True
    (across, down), (right, below) = dots.spacing_mm, dots.middle_mm
    middle = (len(dots.row_counts) - 1) / 2
    ends = [((n - 1) / 2 * across, (row - middle) * down + below) for row, n in enumerate(dots.row_counts)]
    return all(trajectory_checks.on_pad(sensor.gel, right + side * x, y) for x, y in ends for side in (-1, 1))


def _too_coarse(recipe: Recipe, gel: Gel) -> Iterator[Issue]:
    edge, longest = recipe.resolved().edge_mm, MAX_EDGE_PER_THICKNESS * gel.thickness_mm
    if edge > longest * (1 + 1e-9):
        text = (
            f"gives edges of {edge:g} mm, longer than half the gel's thickness, {longest:g} mm: forces would be off by"
            f" half and more; ask for quality: {{edge_mm: {longest / 2:.2g}}} or finer"
        )
        yield Issue(("quality",) if isinstance(recipe.quality, str) else ("quality", "edge_mm"), text)


def _too_large(indenter: Indenter, gel: Gel) -> Iterator[Issue]:
    """Sizes far beyond the pad are a wrong unit or mean a plate, and rounding errors of their distances grow."""
    most = MAX_INDENTER_SIZE_RATIO * math.hypot(gel.width_mm, gel.height_mm)
    limit = f"must be at most {most:.4g}, {MAX_INDENTER_SIZE_RATIO:g} times the pad's diagonal"
    plate = f"{{shape: box, size_x_mm: {1.5 * gel.width_mm:.3g}, size_y_mm: {1.5 * gel.height_mm:.3g}}}"
    for name, value in indenter:
        if name.endswith("_mm") and isinstance(value, float) and value > most:
            text = f"{limit} (got {value:g}): a wrong unit? A flat plate is {plate}"
            yield Issue(("indenter", name), text)


def _too_thin(indenter: Indenter, edge: float) -> Iterator[Issue]:
    """A thin body must be thicker than the distance between contact points, or it passes between them."""
    for key, part in indenter.thin.items():
        size = getattr(indenter, key)
        if size is not None and part * size < MIN_HALF_THICKNESS_EDGES * edge * (1 - 1e-9):
            text = f"is too thin for a mesh of edge {edge:g} mm: it would slip between the points where contact acts; "
            finer = f"ask for quality: {{edge_mm: {part * size / MIN_HALF_THICKNESS_EDGES:.2g}}} or finer"
            yield Issue(("indenter", key), text + (usual_sizes.in_metres(key, size) or finer))


def _mesh_file(indenter: Indenter, edge: float, folder: Path | None) -> list[Issue]:
    """The file must be a closed mesh, have the right hash, and not be too small to touch a contact point."""
    if indenter.shape != "mesh":
        return []
    from tacgen.geometry import mesh_import

    try:
        path = assets.mesh_path(indenter.file, folder)
        sides = mesh_import.sizes(path, indenter.up, indenter.scale)
    except UserError as error:
        return [Issue(("indenter", "file"), error.lines[0])]
    wrong, longest = [], indenter.size_mm or max(sides)
    if indenter.sha256 not in (None, sha256 := assets.sha256(path)):
        wrong.append(Issue(("indenter", "sha256"), f"{indenter.file} {assets.changed(sha256)}"))
    if longest < 2 * MIN_HALF_THICKNESS_EDGES * edge:
        text = f"is {longest:.3g} mm long, too small for a mesh of edge {edge:g} mm: a file in metres needs scale: 1000"
        wrong.append(Issue(("indenter", "file"), text))
    return wrong


def _photo(recipe: Recipe, sensor: Sensor, folder: Path | None) -> list[Issue]:
    """Why the photograph of an untouched real sensor cannot be the background of this sensor's images."""
    name, camera = recipe.render.background, sensor.camera
    if name is None:
        return []
    if not recipe.outputs & IMAGE_OUTPUTS:
        text = "has no effect: outputs do not ask for rgb or radiance: add rgb to them, or leave background out"
        return [Issue(BACKGROUND_KEY, text, at_key=True)]
    path = assets.beside(name, folder)
    try:
        sha256 = assets.sha256(path)
        height, width = photograph.read(path).shape[:2]
    except UserError as error:
        return [Issue(BACKGROUND_KEY, error.lines[0])]
    if recipe.render.background_sha256 not in (None, sha256):
        return [Issue(("render", "background_sha256"), f"{name} {assets.changed(sha256)}")]
    if (width, height) == (camera.width_px, camera.height_px):
        return []
    pictures = f"{camera.width_px} x {camera.height_px}"
    text = f"is {width} x {height}, and the camera's pictures are {pictures}: crop and resize it"
    return [Issue(BACKGROUND_KEY, text)]
