"""Where a trajectory would take the indenter, in plain Python: what cannot be is told before anything is computed."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from tacgen.errors import UserError
from tacgen.recipe import assets, pose_table
from tacgen.recipe.indenters import Indenter
from tacgen.recipe.model import Recipe
from tacgen.recipe.pose_table import Pose
from tacgen.recipe.sensor import Gel
from tacgen.recipe.trajectory import Move, Press, Release, Replay, Slide, Start, Tilt, Twist
from tacgen.recipe.turns import Placement, Quaternion, Vector, about, inverse, on, product, seen_from, turned
from tacgen.recipe.validation_messages import Problem
from tacgen.recipe.yaml_source import KeyPath

MOST = 10_000  # frames of a segment
FLANK = "the indenter's flank would meet the gel before its tip"
Folders = Mapping[KeyPath, Path]  # where the path of a file starts that is named at a place of the recipe


def replayed(move: Replay, folder: Path | None) -> tuple[Pose, ...]:
    """The poses of the indenter in the sensor's frame that a replay goes through, a frame each.

    Raises:
        UserError: the table cannot be used, or is another than the one meant; lines start with its name.
    """
    path = (folder or Path()) / Path(move.file).expanduser()
    try:
        table = pose_table.read(path, move.units)
    except UserError as error:
        raise UserError(f"{move.file}: {line}" for line in error.lines) from None
    if move.sha256 not in (None, table.sha256):
        raise UserError(f"{move.file}: is another file now ({table.sha256[:12]}...)")
    rows = table.poses[:: move.every][: move.frames]
    if len(rows) > MOST:
        raise UserError(f"{move.file}: gives {len(rows)} frames, at most {MOST} can be: thin it out by `every`")
    if len(rows) < (move.frames or 0):
        raise UserError(f"{move.file}: gives {len(rows)} frames, and {move.frames} are asked for")
    world = seen_from(Placement(move.sensor_pose.position_mm, move.sensor_pose.quaternion))
    inner = Placement(move.indenter_pose.position_mm, move.indenter_pose.quaternion)
    return tuple(replace(row, place=on(on(world, row.place), inner)) for row in rows)


def resolved(recipe: Recipe, folders: Folders) -> Recipe:
    """The recipe with its tables' hashes and numbers of frames filled in."""
    steps = []
    for i, step in enumerate(recipe.trajectory):
        if step.replay:
            folder = folders.get(("trajectory", i, "replay", "file"))
            path = (folder or Path()) / Path(step.replay.file).expanduser()
            known = {"frames": len(replayed(step.replay, folder)), "sha256": assets.sha256(path)}
            step = step.model_copy(update={"replay": step.replay.model_copy(update=known)})
        steps.append(step)
    return recipe.model_copy(update={"trajectory": tuple(steps)})


def reach(i: Indenter, d: Vector) -> float:
    """How far an indenter extends from its origin along a unit vector of its own frame [mm].

    inf where it has no end, nan for a mesh, which only its file knows. The same as `support` of geometry.analytic_sdf.
    """
    x, y, z = d
    flat = math.hypot(x, y)
    match i.shape:
        case "sphere":
            return i.radius_mm * (1 + z)
        case "capsule":
            return i.radius_mm * (1 + z) + i.length_mm / 2 * abs(x)
        case "torus":
            return i.tube_radius_mm * (1 + z) + i.radius_mm * flat
        case "cylinder":
            return i.fillet_mm * (1 + z) + (i.radius_mm - i.fillet_mm) * flat if z <= 1e-12 else math.inf
        case "box":
            sides = (i.size_x_mm / 2 - i.fillet_mm) * abs(x) + (i.size_y_mm / 2 - i.fillet_mm) * abs(y)
            return i.fillet_mm * (1 + z) + sides if z <= 1e-12 else math.inf
        case "cone" | "wedge":
            angle = math.radians(i.half_angle_deg)
            across = flat if i.shape == "cone" else abs(x)
            if across * math.sin(angle) + z * math.cos(angle) > 1e-12:
                return math.inf
            along = (i.length_mm / 2 - i.tip_radius_mm) * abs(y) if i.shape == "wedge" else 0.0
            return i.tip_radius_mm * (1 + z) + along
        case "mesh":
            return 0.0 if z + 1 < 1e-9 else math.nan


def drop(i: Indenter, q: Quaternion) -> float:
    """How far a turned indenter hangs below its own origin [mm]."""
    return reach(i, turned(inverse(q), (0.0, 0.0, -1.0)))


def lowest(i: Indenter, q: Quaternion) -> Vector:
    """The lowest point of a turned indenter from its own origin [mm], the middle of them where it is an edge or face.

    The slope of `reach`, by central differences.
    """
    step, slope = 1e-5, []
    for k in range(3):
        ends = []
        for sign in (1, -1):
            d = list(turned(inverse(q), (0.0, 0.0, -1.0)))
            d[k] += sign * step
            length = math.hypot(*d)
            ends.append(reach(i, (d[0] / length, d[1] / length, d[2] / length)))
        slope.append((ends[0] - ends[1]) / (2 * step))
    x, y, _ = turned(q, (slope[0], slope[1], slope[2]))
    return x, y, -drop(i, q)


def on_pad(gel: Gel, x_mm: float, y_mm: float) -> bool:
    """Whether a point of the plane lies inside the pad's outline, or on it."""
    if gel.tip:
        r = gel.width_mm / 2
        past = gel.tip * y_mm - (gel.height_mm / 2 - r)  # beyond the semicircle's centre, toward the tip
        beside = abs(x_mm) <= r * (1 + 1e-9) and -gel.tip * y_mm <= gel.height_mm / 2 * (1 + 1e-9)
        return beside and math.hypot(x_mm, max(past, 0.0)) <= r * (1 + 1e-9)
    r = gel.corner_radius_mm
    past_x = max(abs(x_mm) - (gel.width_mm / 2 - r), 0.0)
    past_y = max(abs(y_mm) - (gel.height_mm / 2 - r), 0.0)
    return math.hypot(past_x, past_y) <= r + 1e-9 * gel.width_mm


def problems(recipe: Recipe, gel: Gel, folders: Folders) -> list[Problem]:
    """What the indenter cannot do over this gel; the first move that cannot be is named, and ends the search.

    Heights that only a force says, a face that is domed and a mesh that leans are left to the path itself.
    """
    start, first = recipe.start, recipe.trajectory[0]
    if first.replay:
        if start != Start():
            return [Problem(("start",), "has no effect before a replay, which begins over its first row", at_key=True)]
        walk = _Walk(recipe.indenter, gel, Placement(), -math.inf)
    else:
        pad, x, y = _pad(gel), start.x_mm, start.y_mm
        if not on_pad(gel, x, y):
            path: KeyPath = ("start", "x_mm" if abs(x) > gel.width_mm / 2 else "y_mm")
            if abs(x) <= gel.width_mm / 2 and abs(y) <= gel.height_mm / 2:
                path = ("start",)  # in the cut-off corner: neither alone is to blame
            return [Problem(path, f"the indenter would start beside {pad}, at ({x:g}, {y:g})")]
        q = product(_tilt(start.tilt_deg, start.tilt_axis_deg), about((0.0, 0.0, 1.0), math.radians(start.yaw_deg)))
        hangs = drop(recipe.indenter, q)
        if math.isinf(hangs):
            return [Problem(("start", "tilt_deg"), FLANK)]
        walk = _Walk(recipe.indenter, gel, Placement((x, y, hangs + start.clearance_mm), q), hangs + start.clearance_mm)
    for i, step in enumerate(recipe.trajectory):
        folder = folders.get(("trajectory", i, "replay", "file"))
        where: KeyPath = ("trajectory", i, step.kind)
        try:
            if step.replay:
                found = walk.replay(replayed(step.replay, folder), step.replay.file)
            else:
                found = walk.take(step.move)
        except UserError as error:
            return [Problem((*where, "file"), line) for line in error.lines]
        if found:
            return [Problem((*where, *found[0]), found[1])]
    return []


def _pad(gel: Gel) -> str:
    return f"the pad of {gel.width_mm:g} x {gel.height_mm:g} mm"


def _tilt(angle_deg: float, axis_deg: float) -> Quaternion:
    axis = math.radians(axis_deg)
    return about((math.cos(axis), math.sin(axis), 0.0), math.radians(angle_deg))


@dataclass
class _Walk:
    """Where a trajectory has come to; `home` is the height that a release goes back to [mm]."""

    indenter: Indenter
    gel: Gel
    place: Placement
    home: float

    @property
    def thickness(self) -> float:
        return sum(layer.thickness_mm for layer in self.gel.layers)

    def take(self, move: Move) -> tuple[KeyPath, str] | None:
        """Go through one segment; what is wrong with it, under its own path."""
        (x, y, z), q = self.place
        match move:
            case Press():
                depth = move.depth_mm or 0.0
                depth = depth if depth < self.thickness else 0.0  # too deep is told by itself
                self.place = Placement((x, y, drop(self.indenter, q) - depth), q)
            case Release():
                self.place = Placement((x, y, self.home), q)
            case Slide():
                x, y = x + move.x_mm, y + move.y_mm
                self.place = Placement((x, y, z), q)
                if not on_pad(self.gel, x, y):
                    return (), f"would carry the indenter's axis off {_pad(self.gel)}, to ({x:g}, {y:g})"
            case Twist():
                return self._turn(turned(q, (0.0, 0.0, 1.0)), move, (0.0, 0.0, 0.0))
            case Tilt():
                axis = math.radians(move.axis_deg)
                return self._turn((math.cos(axis), math.sin(axis), 0.0), move, lowest(self.indenter, q))
        return None

    def _turn(self, axis: Vector, move: Twist | Tilt, about_point: Vector) -> tuple[KeyPath, str] | None:
        """Turn about an axis through a point, given from the indenter's origin; the worst may be on the way."""
        (x, y, z), q = self.place
        for k in range(1, move.frames + 1):
            turn = about(axis, math.radians(move.angle_deg) * k / move.frames)
            a, b, c = (p - r for p, r in zip(about_point, turned(turn, about_point), strict=True))
            self.place = Placement((x + a, y + b, z + c), product(turn, q))
            hangs = drop(self.indenter, self.place.quaternion)
            if math.isinf(hangs) or math.isinf(about_point[2]):
                return ("angle_deg",), FLANK
            if z + c - hangs <= -self.thickness:
                return ("angle_deg",), "would turn the indenter's edge to the base of the gel, or below"
        return None

    def replay(self, rows: tuple[Pose, ...], name: str) -> tuple[KeyPath, str] | None:
        """Go through the rows of a table; what is wrong with the first that cannot be."""
        for row in rows:
            (x, y, z), q = self.place = row.place
            low = z - drop(self.indenter, q)
            if math.isinf(low):
                return ("file",), f"{name}: line {row.line}: {FLANK}"
            if low <= -self.thickness:
                text = f"the indenter's lowest point, at z = {low:.4g} mm, would be at the base of the gel, or below"
                return ("file",), f"{name}: line {row.line}: {text}"
            if low < 0 and not on_pad(self.gel, x, y):
                text = (
                    f"at ({x:.4g}, {y:.4g}, {z:.4g}) the indenter would be beside {_pad(self.gel)} and below its face"
                )
                return ("file",), f"{name}: line {row.line}: {text}"
        if math.isinf(self.home):  # what begins with a replay starts over its first row, or at it
            self.home = max(rows[0].place.position[2], drop(self.indenter, rows[0].place.quaternion))
        self.home = max(self.home, drop(self.indenter, q))
        return None
