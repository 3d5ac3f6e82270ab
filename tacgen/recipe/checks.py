"""Checks that need the recipe and the sensor together: what this sensor cannot do."""

import math
from contextlib import suppress
from pathlib import Path

from tacgen.base.errors import UserError
from tacgen.outputs import IMAGE_OUTPUTS, OUTPUT_NAMES, OUTPUTS
from tacgen.recipe import assets, background_photo, grasp_checks, trajectory_checks, usual_sizes
from tacgen.recipe.indenters import Indenter
from tacgen.recipe.model import Recipe
from tacgen.recipe.trajectory import Paced, Replay, Slide, Timed
from tacgen.recipe.trajectory_checks import Folders
from tacgen.sensor.model import LIGHT_FIELDS, Gel, Sensor
from tacgen.sensor.validation_messages import Issue
from tacgen.sensor.yaml_source import KeyPath

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
    wrong = output_problems(recipe, sensor)
    if recipe.grasp is None:
        wrong += [*_depths(recipe, sensor), *_times(recipe, sensor, folders)]
    if recipe.mesh == "hex" and sensor.gel.solid is not None:
        text = f"cannot be hex: the gel of {sensor.name} is a solid, which is meshed by tets: leave mesh out"
        wrong.append(Issue(("mesh",), text))
    if recipe.uncertainty is not None and (recipe.grasp is not None or timed(recipe, sensor)):
        text = "needs quasi-static frames without a grasp: leave it out, or grasp, dynamics and viscosity"
        wrong.append(Issue(("uncertainty",), text))
    most = sensor.gel.thickness_mm
    if recipe.uncertainty is not None and (depth := recipe.uncertainty.pose.depth_mm) > most:
        text = f"must be at most the gel's thickness, {most:g} mm (got {depth:g})"
        wrong.append(Issue(("uncertainty", "pose", "depth_mm"), text))
    wrong += [*_too_large(recipe.indenter, sensor.gel), *_too_coarse(recipe, sensor.gel)]
    edge = recipe.resolved().edge_mm
    wrong += _too_thin(recipe.indenter, edge)
    wrong += _mesh_file(recipe.indenter, edge, folders.get(("indenter", "file")))
    wrong += grasp_checks.problems(recipe, sensor, folders)
    wrong += [] if recipe.grasp else trajectory_checks.problems(recipe, sensor.gel, folders)
    return wrong + background_photo.problems(recipe, sensor, folders.get(background_photo.BACKGROUND_KEY))


def _depths(recipe: Recipe, sensor: Sensor) -> list[Issue]:
    """A press must be less deep than the gel is thick under the start."""
    thick = usual_sizes.thickness_mm(recipe, sensor.gel)
    return [
        Issue(
            ("trajectory", i, "press", "depth_mm"),
            f"must be less than the gel is thick, {thick:g} mm (got {segment.press.depth_mm:g})",
        )
        for i, segment in enumerate(recipe.trajectory)
        if segment.press and segment.press.depth_mm is not None and segment.press.depth_mm >= thick
    ]


def timed(recipe: Recipe, sensor: Sensor) -> bool:
    """Whether time matters: with dynamics, or on a viscoelastic gel if any movement has a duration."""
    moves = (step.move for step in recipe.trajectory)
    return recipe.dynamics is not None or (
        sensor.gel.viscous and any(not isinstance(move, Timed) or move.seconds(1.0) is not None for move in moves)
    )


def _times(recipe: Recipe, sensor: Sensor, folders: Folders) -> list[Issue]:
    """If time matters, every movement needs a duration; if not, none may have one."""
    count, dynamics, forced, wrong = timed(recipe, sensor), recipe.dynamics, False, []
    for i, step in enumerate(recipe.trajectory):
        where: KeyPath = ("trajectory", i, step.kind)
        known = not isinstance(step.move, Timed) or step.move.seconds(1.0) is not None
        paced = isinstance(step.move, Paced) and step.move.speed_mm_s is not None
        forced = forced or getattr(step.move, "force_n", None) is not None
        forced = forced or (isinstance(step.move, Replay) and step.move.matched)
        if not count:
            if isinstance(step.move, Timed) and known:
                text = "has no effect without dynamics or a viscoelastic gel: leave it out, or add one of them"
                wrong.append(Issue((*where, "speed_mm_s" if paced else "duration_s"), text, at_key=True))
        elif forced and paced and not isinstance(step.move, Slide):
            text = "needs a way that is known, which force_n leaves open: say duration_s"
            wrong.append(Issue((*where, "speed_mm_s"), text, at_key=True))
        elif dynamics is None or dynamics.frame_s is None:
            if isinstance(step.move, Replay):
                with suppress(UserError):  # told already
                    known = len(trajectory_checks.replayed(step.move, folders.get((*where, "file")))) > 1
            if not known:
                more = "as others do" if dynamics is None else "or frame_s under dynamics"
                wrong.append(Issue(where, f"must say how long it takes: duration_s, {more}"))
    return wrong


def output_problems(recipe: Recipe, sensor: Sensor) -> list[Issue]:
    """Problems of outputs that need what the sensor does not have."""
    wrong = []
    named = " and ".join(n for n in OUTPUT_NAMES if n in recipe.outputs and OUTPUTS[n].needs == "markers")
    if named and sensor.markers is None:
        text = f"asks for {named}, and the sensor {sensor.name} has none: leave them out, or add markers to its file"
        wrong.append(Issue(("outputs",), text))
    if named and not _on_gel(sensor):
        text = f"asks for {named}, and some of the sensor {sensor.name} would lie beside its gel: fewer, or closer ones"
        wrong.append(Issue(("outputs",), text))
    if (images := recipe.outputs & IMAGE_OUTPUTS) and not sensor.lit:
        asked = " and ".join(sorted(images))
        lacking = ", ".join(name for name in LIGHT_FIELDS if getattr(sensor, name) is None)
        text = f"asks for {asked}: the sensor {sensor.name} has no {lacking}: add them to its file"
        wrong.append(Issue(("outputs",), text))
    if images and recipe.render.method == "table" and any(layer.scattering for layer in sensor.gel.clear_layers):
        text = (
            f"cannot be table, whose light follows the face's slope: the gel of {sensor.name} scatters; take transport"
        )
        wrong.append(Issue(("render", "method"), text))
    if images and recipe.render.method != "transport" and sensor.camera.aspect != 1:
        text = f"must be transport: the pixels of {sensor.name} are not square (camera.pixel_aspect)"
        wrong.append(Issue(("render", "method"), text))
    if recipe.markers.method == "analytic" and (sensor.markers is None or sensor.markers.motion is None):
        text = f"cannot be analytic: the sensor file {sensor.name} holds no markers.motion: take fem"
        wrong.append(Issue(("markers", "method"), text))
    return wrong


def _on_gel(sensor: Sensor) -> bool:
    """Whether both ends of each row of markers lie on the pad, and so all of it."""
    if (dots := sensor.markers) is None:
        return True
    (across, down), (right, below) = dots.spacing_mm, dots.middle_mm
    middle = (len(dots.row_counts) - 1) / 2
    ends = [((n - 1) / 2 * across, (row - middle) * down + below) for row, n in enumerate(dots.row_counts)]
    return all(trajectory_checks.on_pad(sensor.gel, right + side * x, y) for x, y in ends for side in (-1, 1))


def _too_coarse(recipe: Recipe, gel: Gel) -> list[Issue]:
    edge, longest = recipe.resolved().edge_mm, MAX_EDGE_PER_THICKNESS * gel.thickness_mm
    if edge <= longest * (1 + 1e-9):
        return []
    text = (
        f"gives edges of {edge:g} mm, longer than half the gel's thickness, {longest:g} mm: forces would be off by half"
        f" and more; ask for quality: {{edge_mm: {longest / 2:.2g}}} or finer"
    )
    where: KeyPath = ("quality",) if isinstance(recipe.quality, str) else ("quality", "edge_mm")
    return [Issue(where, text)]


def _too_large(indenter: Indenter, gel: Gel) -> list[Issue]:
    """Sizes far beyond the pad are a wrong unit or mean a plate, and rounding errors of their distances grow."""
    most = MAX_INDENTER_SIZE_RATIO * math.hypot(gel.width_mm, gel.height_mm)
    text = (
        f"must be at most {most:.4g}, {MAX_INDENTER_SIZE_RATIO:g} times the pad's diagonal (got {{:g}}): a wrong unit? "
        f"A flat plate is"
        f" {{{{shape: box, size_x_mm: {1.5 * gel.width_mm:.3g}, size_y_mm: {1.5 * gel.height_mm:.3g}}}}}"
    )
    return [
        Issue(("indenter", name), text.format(value))
        for name, value in indenter
        if name.endswith("_mm") and isinstance(value, float) and value > most
    ]


def _too_thin(indenter: Indenter, edge: float) -> list[Issue]:
    """A thin body must be thicker than the distance between contact points, or it passes between them."""
    sizes = {key: getattr(indenter, key) for key in indenter.thin}
    half = {key: indenter.thin[key] * size for key, size in sizes.items() if size is not None}
    return [
        Issue(
            ("indenter", key),
            f"is too thin for a mesh of edge {edge:g} mm: it would slip between the points where contact acts; "
            + (
                usual_sizes.in_metres(key, sizes[key])
                or f"ask for quality: {{edge_mm: {value / MIN_HALF_THICKNESS_EDGES:.2g}}} or finer"
            ),
        )
        for key, value in half.items()
        if value < MIN_HALF_THICKNESS_EDGES * edge * (1 - 1e-9)
    ]


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
