"""A trajectory laid out: the pose of the indenter at every frame, and which of them a force will correct."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tacgen.contact.barrier import Pose
from tacgen.errors import UserError
from tacgen.geometry.analytic_sdf import Shape
from tacgen.recipe import pose_table, trajectory
from tacgen.recipe.model import Recipe
from tacgen.recipe.trajectory import Start
from tacgen.recipe.turns import Placement

if TYPE_CHECKING:
    from tacgen.geometry.gel import Gel

Array = np.ndarray
Step = tuple[Array, Array, tuple[float, ...]]  # pose, turn, and asked, part, carry, floor and below of Forced
FORCE_DEPTH = 0.8  # of the gel's thickness: no force is looked for below
FIRST_GUESS = 0.1  # of the thickness: where the search for a force starts


@dataclass(frozen=True)
class Forced:
    """Frames (N,) whose height is found from a force; without friction, history or mesh nobody can know it before.

    asked: normal force at the end of the segment [N], nan where the pose is given; part: of the way there from the
    force before the segment; carry: the part of what a height was found off its guess that later poses are off too;
    floor: height of the indenter's origin that no trial goes below [mm]; below: how far under its guess a frame may
    come, for which the mesh is made fine [mm]; hopeless: a frame whose force is known to be far beyond the gel, and
    what to say of it.
    """

    asked: Array
    part: Array
    carry: Array
    floor: Array
    below: Array
    hopeless: tuple[int, str] | None = None

    @property
    def allowance(self) -> Array:
        """How far below its guess (N,) each frame may come, those that follow a found height included [mm]."""
        below, out = 0.0, np.zeros(len(self.asked))
        for i, asked in enumerate(self.asked):
            below = self.below[i] if np.isfinite(asked) else below
            out[i] = self.carry[i] * below
        return out


@dataclass(frozen=True)
class Path:
    """Poses (N, 4, 4) at every frame, the rotation vector (N, 3) [rad] from each pose to the next, which may be more
    than half a turn, the segment (N,) each belongs to, what forces ask for, and the pose (4, 4) before the first frame,
    clear of the gel."""

    start: Array
    poses: Array
    turns: Array
    segment: Array
    forced: Forced | None


def _about(axis: Array, angle: float) -> Array:
    """Rotation (3, 3) about a unit axis by `angle` [rad]."""
    from scipy.spatial.transform import Rotation

    turn: Array = Rotation.from_rotvec(axis * angle).as_matrix()
    return turn


def shortest_turn(a: Array, b: Array) -> Array:
    """Rotation vector (3,) [rad] from pose a to pose b (4, 4) by the shorter way."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(b[:3, :3] @ a[:3, :3].T).as_rotvec())


def between(a: Array, b: Array, turn: Array, part: float) -> Array:
    """The pose (4, 4) a part of the way from a to b: straight in position, steady about `turn` (3,) [rad]."""
    out = b.copy()
    if part < 1:
        angle = float(np.linalg.norm(turn))
        out[:3, :3] = (_about(turn / angle, part * angle) if angle else np.eye(3)) @ a[:3, :3]
        out[:3, 3] = (1 - part) * a[:3, 3] + part * b[:3, 3]
    return out


def along(a: Array, b: Array, turn: Array, n: int) -> list[Array]:
    """The ends (4, 4) of n equal steps from a to b, the last of them b itself."""
    return [between(a, b, turn, k / n) for k in range(1, n + 1)]


def _sunk(shape: Shape, pose: Array, gel: "Gel") -> float:
    """How far a shape that stands on z = 0 may sink along z until it touches the untouched face [mm].

    Each round lowers it by its distance from the face, which cannot carry it past; a second grid, 20 times as fine,
    lies around the point found on the first.
    """
    if gel.flat:
        return 0.0
    most = -float(gel.top(np.array(gel.width / 2), np.array(gel.height / 2)))  # beside the pad nothing is touched
    sunk, step, middle, half = 0.0, 0.2, np.zeros(2), np.array([gel.width, gel.height]) / 2
    for _ in range(2):
        ends = zip(middle - half, middle + half, half, strict=True)
        x, y = np.meshgrid(*(np.linspace(low, high, 2 * round(h / step) + 1) for low, high, h in ends))
        here = gel.contains(x, y)
        face = np.column_stack([x[here], y[here], gel.top(x[here], y[here])])
        lowered = pose.copy()
        for _ in range(200):
            lowered[2, 3] = pose[2, 3] - sunk
            gap = shape.distance(Pose.of(lowered).local(face))[0]
            nearest = int(np.argmin(gap))
            sunk += gap[nearest]  # the finer grid, that finds points in between, takes a little back
            if abs(gap[nearest]) < 1e-6 or sunk > most:
                break
        middle, half, step = face[nearest, :2], np.array([step, step]), step / 20
    return min(float(sunk), most)


def _first(shape: Shape, start: Start, gel: "Gel") -> Array:
    """The pose before the first frame."""
    tilt = _about(np.array([np.cos(a := np.radians(start.tilt_axis_deg)), np.sin(a), 0.0]), np.radians(start.tilt_deg))
    pose = np.eye(4)
    pose[:3, :3] = tilt @ _about(np.array([0.0, 0.0, 1.0]), np.radians(start.yaw_deg))
    pose[:2, 3] = start.x_mm, start.y_mm
    pose[2, 3] = start.clearance_mm + _contact(shape, pose, gel)
    return pose


def _contact(shape: Shape, pose: Array, gel: "Gel") -> float:
    """Height of the origin at which an indenter of this turn and place would first touch the untouched face [mm]."""
    standing = pose.copy()
    standing[2, 3] = drop = shape.support(-pose[2, :3])  # how far it hangs below its own origin
    return drop - _sunk(shape, standing, gel)


def _placed(place: Placement) -> Array:
    from scipy.spatial.transform import Rotation

    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(place.quaternion, scalar_first=True).as_matrix()
    pose[:3, 3] = place.position
    return pose


def lowest(shape: Shape, rotation: Array) -> Array:
    """The lowest point (3,) of a turned shape from its own origin [mm]: the middle of them where it is an edge or face.

    The slope of the support function, by central differences.
    """
    down = -rotation[2]
    step = 1e-5 * np.eye(3)
    slope = [shape.support(_unit(down + s)) - shape.support(_unit(down - s)) for s in step]
    height = shape.support(down)
    flat = rotation @ (np.array(slope) / 2e-5)  # its part along `down` is lost in the unit vectors
    return np.array([flat[0], flat[1], -height])


def _unit(v: Array) -> Array:
    return np.asarray(v / np.linalg.norm(v))


@dataclass
class _Walk:
    """Where a path has come to, while it is laid; `home` is the height that a release goes back to [mm]."""

    shape: Shape
    gel: "Gel"
    pose: Array
    home: float
    carry: float = 0.0

    def steps(self, move: trajectory.Made, where: str) -> Iterator[Step]:
        """The frames of one segment."""
        begun, carried, turn = self.pose, self.carry, np.zeros(3)
        contact = floor = np.nan
        if isinstance(move, trajectory.Press):
            contact = _contact(self.shape, begun, self.gel)
            floor = contact - FORCE_DEPTH * self.gel.thickness
        for k in range(1, move.frames + 1):
            part = k / move.frames
            new = begun.copy()
            asked = below = np.nan
            match move:
                case trajectory.Press(force_n=float(force)):
                    asked, self.carry = force, 1.0
                    new[2, 3] = contact - FIRST_GUESS * part * self.gel.thickness
                    below = new[2, 3] - floor
                case trajectory.Press(depth_mm=float(depth)):
                    new[2, 3] += part * (contact - depth - begun[2, 3])
                    self.carry = (1 - part) * carried
                case trajectory.Release():
                    new[2, 3] += part * (self.home - begun[2, 3])
                    self.carry = (1 - part) * carried
                case trajectory.Slide(x_mm=x, y_mm=y):
                    new[0, 3] += part * x
                    new[1, 3] += part * y
                case trajectory.Twist(angle_deg=angle):
                    new[:3, :3] = _about(begun[:3, 2], part * np.radians(angle)) @ begun[:3, :3]
                    turn = begun[:3, 2] * np.radians(angle) / move.frames
                case trajectory.Tilt(angle_deg=angle, axis_deg=axis):
                    self._tilt(new, begun, part * np.radians(angle), np.radians(axis), where)
                    turn = np.array([np.cos(a := np.radians(axis)), np.sin(a), 0.0]) * np.radians(angle) / move.frames
            self.pose = new
            yield new, turn, (asked, part, self.carry, floor, below)

    def _tilt(self, new: Array, begun: Array, angle: float, axis: float, where: str) -> None:
        """Turn about the lowest point of the pose at which the segment began."""
        from_origin = lowest(self.shape, begun[:3, :3])
        turn = _about(np.array([np.cos(axis), np.sin(axis), 0.0]), angle)
        new[:3, :3] = turn @ begun[:3, :3]
        new[:3, 3] = begun[:3, 3] + from_origin - turn @ from_origin
        if new[2, 3] - self.shape.support(-new[2, :3]) <= -self.gel.thickness:
            raise UserError(f"{where}.angle_deg: would turn the indenter's edge to the base of the gel, or below")

    def replay(self, rows: tuple[pose_table.Pose, ...], where: str) -> Iterator[Step]:
        """Frames at the rows of a table; no height found before is carried into them."""
        self.carry = 0.0
        for row in rows:
            before, self.pose = self.pose, _placed(row.place)
            if self.pose[2, 3] - self.shape.support(-self.pose[2, :3]) <= -self.gel.thickness:
                raise UserError(f"{where}.file: line {row.line}: the indenter would be at the gel's base, or below")
            yield self.pose, shortest_turn(before, self.pose), (np.nan, 1.0, 0.0, np.nan, np.nan)
        self.home = max(self.home, _contact(self.shape, self.pose, self.gel))


def lay(recipe: Recipe, shape: Shape, gel: "Gel", replayed: Callable[[int], tuple[pose_table.Pose, ...]]) -> Path:
    """The path of an indenter over a gel; `replayed` gives the rows of a segment's table.

    A replay that comes first is begun from above: over its first row if that is in the gel, at it otherwise.

    Raises:
        UserError: a leaning mesh, or an indenter on a dome, that comes to the base of the gel.
    """
    if recipe.trajectory[0].replay:
        start = _placed(replayed(0)[0].place)
        start[2, 3] = max(start[2, 3], _contact(shape, start, gel))
    else:
        start = _first(shape, recipe.start, gel)
    walk = _Walk(shape, gel, start, float(start[2, 3]))
    poses: list[Array] = []
    turns: list[Array] = []
    segments: list[int] = []
    asked: list[tuple[float, ...]] = []
    for number, segment in enumerate(recipe.trajectory):
        where = f"trajectory[{number}].{segment.kind}"
        move = segment.move
        if isinstance(move, trajectory.Replay):
            steps = walk.replay(replayed(number), where)
        else:
            steps = walk.steps(move, where)
        for pose, turn, ask in steps:
            poses.append(pose)
            turns.append(turn)
            segments.append(number)
            asked.append(ask)
    of, part, carry, floor, below = np.array(asked).T
    forced = Forced(of, part, carry, floor, np.nan_to_num(below))
    held = forced if np.isfinite(forced.asked).any() else None
    return Path(start, np.array(poses), np.array(turns), np.array(segments), held)
