"""Resolved scene -> Scene: gel, laws, indenter, path and tolerances as plain arrays and numbers."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from tacgen import geometry
from tacgen import recipe as recipes
from tacgen import sensor as sensors
from tacgen.errors import UserError
from tacgen.fem.contact import Pose
from tacgen.fem.field import Field
from tacgen.fem.materials import Law, MooneyRivlin, NeoHooke, StableNeoHooke, Yeoh
from tacgen.fem.shapes import Box, Capsule, Cone, Cylinder, Shape, Sphere, Torus, Wedge
from tacgen.plan import Row
from tacgen.recipe import Indenter, Recipe, Start
from tacgen.sensor import MooneyRivlinLayer, NeoHookeLayer, Sensor, StableNeoHookeLayer, YeohLayer

Array = np.ndarray
FORCE_DEPTH = 0.8  # of the gel's thickness: no force is looked for below
FIRST_GUESS = 0.1  # of the thickness: where the search for a force starts
CELLS = (0.04, 0.15)  # least and largest grid spacing of a mesh's signed distance [mm]


@dataclass(frozen=True)
class Layer:
    """A slab of one material; thickness [mm]."""

    thickness: float
    law: Law
    youngs_modulus: float  # [MPa]


@dataclass(frozen=True)
class Gel:
    """A pad bonded at its base, layers from base to face; width along x, height along y [mm].

    tip: the end in y (-1, +1) that is a semicircle over the whole width, 0 for none; radii: of the dome along x and y.
    """

    width: float
    height: float
    corner_radius: float
    layers: tuple[Layer, ...]
    tip: int = 0
    radii: tuple[float, float] = (np.inf, np.inf)

    @property
    def thickness(self) -> float:
        """At the crown [mm]."""
        return sum(layer.thickness for layer in self.layers)

    def top(self, x: Array, y: Array) -> Array:
        """z of the untouched face [mm], 0 at the crown; x and y broadcast."""
        return np.asarray(0.0 - np.hypot(x * x / (2 * self.radii[0]), y * y / (2 * self.radii[1])))

    def contains(self, x: Array, y: Array) -> Array:
        """Whether points lie inside the outline; x and y broadcast."""
        if self.tip:
            r = self.width / 2
            past = self.tip * y - (self.height / 2 - r)  # beyond the semicircle's centre, toward the tip
            return np.asarray((-self.tip * y <= self.height / 2) & (np.hypot(x, np.maximum(past, 0)) <= r))
        r = self.corner_radius
        beyond = np.hypot(
            np.maximum(np.abs(x) - (self.width / 2 - r), 0), np.maximum(np.abs(y) - (self.height / 2 - r), 0)
        )
        within = (np.abs(x) <= self.width / 2) & (np.abs(y) <= self.height / 2) & (beyond <= max(r, 1e-12))
        return np.asarray(within)


@dataclass(frozen=True)
class Forced:
    """Frames (N,) whose height is found from a force; without friction, history or mesh nobody can know it before.

    asked: normal force at the end of the segment [N], nan where the pose is given; part: of the way there from the
    force before the segment; carry: the part of what a height was found off its guess that later poses are off too;
    floor: height of the indenter's origin that no trial goes below [mm]; below: how far under its guess a frame may
    come, for which the mesh is made fine [mm].
    """

    asked: Array
    part: Array
    carry: Array
    floor: Array
    below: Array

    @property
    def allowance(self) -> Array:
        """How far below its guess (N,) each frame may come, those that follow a found height included [mm]."""
        below, out = 0.0, np.zeros(len(self.asked))
        for i, asked in enumerate(self.asked):
            below = self.below[i] if np.isfinite(asked) else below
            out[i] = self.carry[i] * below
        return out


@dataclass(frozen=True)
class Scene:
    """All that the numerics need of one scene; nothing in it is a recipe.

    poses (N, 4, 4): indenter frame to sensor frame at each frame, a guess of the height where `forced` says so;
    segment (N,): number of the trajectory segment;
    start (4, 4): the pose before the first frame, clear of the gel.
    """

    gel: Gel
    shape: Shape
    poses: Array
    start: Array
    segment: Array
    friction: float
    edge: float  # element edge under the contact [mm]
    dhat: float  # [mm]
    forced: Forced | None = None


def _shape(i: Indenter, field: Callable[[recipes.Mesh], Shape]) -> Shape:
    match i.shape:
        case "sphere":
            return Sphere(i.radius_mm)
        case "cylinder":
            return Cylinder(i.radius_mm, i.fillet_mm)
        case "cone":
            return Cone(np.radians(i.half_angle_deg), i.tip_radius_mm)
        case "box":
            return Box(i.size_x_mm, i.size_y_mm, i.fillet_mm)
        case "wedge":
            return Wedge(np.radians(i.half_angle_deg), i.tip_radius_mm, i.length_mm)
        case "capsule":
            return Capsule(i.radius_mm, i.length_mm)
        case "torus":
            return Torus(i.radius_mm, i.tube_radius_mm)
        case "mesh":
            return field(i)


def _field(i: recipes.Mesh, row: Row) -> Field:
    """A mesh as far as the gel can come to it; its grid follows the quality's edge, as what the gel resolves does."""
    gel = row.sensor.gel
    tilted = row.recipe.start.tilt_deg > 0 or any(segment.tilt for segment in row.recipe.trajectory)
    rise = sum(layer.thickness_mm for layer in gel.layers) + 1.0  # no press is deeper, and gel bulges beside it
    cell = float(np.clip(row.recipe.resolved().edge_mm / 4, *CELLS))
    solid = geometry.placed(geometry.read(row.mesh_path), up=i.up, scale=i.scale, size=i.size_mm)
    half = float(np.hypot(gel.width_mm, gel.height_mm)) + 1.0
    return geometry.field(solid, cell=cell, height=np.inf if tilted else rise, half=half)


def law_of(layer: sensors.Layer) -> Law:
    """The law of a layer; what a sensor file says in E and nu becomes mu and the bulk modulus here."""
    match layer:
        case NeoHookeLayer() | StableNeoHookeLayer():
            mu = layer.youngs_modulus_mpa / (2 * (1 + layer.poissons_ratio))
            kappa = bulk(mu, layer.poissons_ratio)
            return NeoHooke(mu, kappa) if layer.law == "neo_hooke" else StableNeoHooke(mu, kappa + mu / 3)
        case MooneyRivlinLayer():
            mu = 2 * (layer.c10_mpa + layer.c01_mpa)
            return MooneyRivlin(layer.c10_mpa, layer.c01_mpa, layer.bulk_modulus_mpa or bulk(mu, layer.poissons_ratio))
        case YeohLayer():
            kappa = layer.bulk_modulus_mpa or bulk(2 * layer.c10_mpa, layer.poissons_ratio)
            return Yeoh(layer.c10_mpa, layer.c20_mpa, layer.c30_mpa, kappa)


def bulk(mu: float, nu: float | None) -> float:
    """Bulk modulus [MPa] from the shear modulus and Poisson's ratio."""
    assert nu is not None, "the sensor file's check lets no layer through without"
    return 2 * mu * (1 + nu) / (3 * (1 - 2 * nu))


def gel_of(sensor: Sensor) -> Gel:
    """The gel with its laws."""
    layers = []
    for layer in sensor.gel.layers:
        law = law_of(layer)
        layers.append(Layer(layer.thickness_mm, law, 9 * law.kappa * law.mu / (3 * law.kappa + law.mu)))
    g = sensor.gel
    radii = (np.inf, np.inf) if g.dome is None else (g.dome.radius_x_mm, g.dome.radius_y_mm)
    return Gel(g.width_mm, g.height_mm, g.corner_radius_mm, tuple(layers), g.tip, radii)


def _about(axis: Array, angle: float) -> Array:
    """Rotation (3, 3) about a unit axis by `angle` [rad]."""
    from scipy.spatial.transform import Rotation

    turn: Array = Rotation.from_rotvec(axis * angle).as_matrix()
    return turn


def _sunk(shape: Shape, pose: Array, gel: Gel) -> float:
    """How far a shape that stands on z = 0 may sink along z until it touches the untouched face [mm].

    Each round lowers it by its distance from the face, which cannot carry it past; a second grid, 20 times as fine,
    lies around the point found on the first.
    """
    if np.isinf(gel.radii).all():
        return 0.0
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
            if abs(gap[nearest]) < 1e-6:
                break
        middle, half, step = face[nearest, :2], np.array([step, step]), step / 20
    return float(sunk)


def _first_pose(shape: Shape, start: Start, gel: Gel) -> Array:
    tilt = _about(np.array([np.cos(a := np.radians(start.tilt_axis_deg)), np.sin(a), 0.0]), np.radians(start.tilt_deg))
    pose = np.eye(4)
    pose[:3, :3] = tilt @ _about(np.array([0.0, 0.0, 1.0]), np.radians(start.yaw_deg))
    drop = shape.support(-pose[2, :3])  # how far the turned shape hangs below its own origin
    if not np.isfinite(drop):
        raise UserError(
            f"start.tilt_deg: tilted by {start.tilt_deg} deg the indenter's flank meets the gel before its tip"
        )
    pose[:3, 3] = start.x_mm, start.y_mm, drop
    pose[2, 3] = start.clearance_mm + drop - _sunk(shape, pose, gel)
    return pose


def lowest(shape: Shape, rotation: Array) -> Array:
    """The lowest point (3,) of a turned shape from its own origin [mm]: the middle of them where it is an edge or face.

    The slope of the support function, by central differences; inf in z where the shape has no lowest point.
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
    """Where a path has come to, while it is laid."""

    shape: Shape
    gel: Gel
    first: Array
    contact_z: float  # height of the origin where the lowest point meets the untouched face [mm]
    pose: Array
    carry: float = 0.0

    def steps(self, move: recipes.Move, where: str) -> Iterator[tuple[Array, tuple[float, ...]]]:
        """Pose, and asked, part, carry, floor and below of Forced, at each frame of one segment."""
        begun, carried = self.pose, self.carry
        floor = self.contact_z - FORCE_DEPTH * self.gel.thickness
        for k in range(1, move.frames + 1):
            part = k / move.frames
            new = begun.copy()
            asked = below = np.nan
            match move:
                case recipes.Press(force_n=float(force)):
                    asked, self.carry = force, 1.0
                    new[2, 3] = self.contact_z - FIRST_GUESS * part * self.gel.thickness
                    below = new[2, 3] - floor
                case recipes.Press(depth_mm=float(depth)):
                    new[2, 3] += part * (self.contact_z - depth - begun[2, 3])
                    self.carry = (1 - part) * carried
                case recipes.Release():
                    new[2, 3] += part * (self.first[2, 3] - begun[2, 3])
                    self.carry = (1 - part) * carried
                case recipes.Slide(x_mm=x, y_mm=y):
                    new[0, 3] += part * x
                    new[1, 3] += part * y
                case recipes.Twist(angle_deg=angle):
                    new[:3, :3] = _about(begun[:3, 2], part * np.radians(angle)) @ begun[:3, :3]
                case recipes.Tilt(angle_deg=angle, axis_deg=axis):
                    self._tilt(new, begun, part * np.radians(angle), np.radians(axis), where)
            self.pose = new
            yield new, (asked, part, self.carry, floor, below)

    def _tilt(self, new: Array, begun: Array, angle: float, axis: float, where: str) -> None:
        """Turn about the lowest point of the pose at which the segment began."""
        from_origin = lowest(self.shape, begun[:3, :3])
        turn = _about(np.array([np.cos(axis), np.sin(axis), 0.0]), angle)
        new[:3, :3] = turn @ begun[:3, :3]
        new[:3, 3] = begun[:3, 3] + from_origin - turn @ from_origin
        drop = self.shape.support(-new[2, :3])
        if not np.isfinite([*from_origin, drop]).all():
            raise UserError(f"{where}.angle_deg: the indenter's flank would meet the gel before its tip")
        if new[2, 3] - drop <= -self.gel.thickness:
            raise UserError(f"{where}.angle_deg: would turn the indenter's edge to the base of the gel, or below")
        standing = new.copy()
        standing[2, 3] = drop
        self.contact_z = drop - _sunk(self.shape, standing, self.gel)


def path(recipe: Recipe, first: Array, shape: Shape, gel: Gel) -> tuple[Array, Array, Forced | None]:
    """Poses (N, 4, 4) at every frame, the segment (N,) each belongs to, and what forces ask for.

    Raises:
        UserError: a tilt that cannot be.
    """
    walk = _Walk(shape, gel, first, first[2, 3] - recipe.start.clearance_mm, first)
    poses: list[Array] = []
    segments: list[int] = []
    asked: list[tuple[float, ...]] = []
    for number, segment in enumerate(recipe.trajectory):
        for pose, ask in walk.steps(segment.move, f"trajectory[{number}].{segment.kind}"):
            poses.append(pose)
            segments.append(number)
            asked.append(ask)
    of, part, carry, floor, below = np.array(asked).T
    forced = Forced(of, part, carry, floor, np.nan_to_num(below))
    return np.array(poses), np.array(segments), forced if np.isfinite(forced.asked).any() else None


def build(row: Row) -> Scene:
    """The scene of one row of a plan."""
    recipe, quality, gel = row.recipe, row.recipe.resolved(), gel_of(row.sensor)
    shape = _shape(recipe.indenter, lambda mesh: _field(mesh, row))
    first = _first_pose(shape, recipe.start, gel)
    poses, segment, forced = path(recipe, first, shape, gel)
    return Scene(gel, shape, poses, first, segment, recipe.contact.friction, quality.edge_mm, quality.dhat_mm, forced)
