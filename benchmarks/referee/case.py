"""The twelve cases of the referee: shapes, paths and friction on one pad, in mm and degrees.

The pad is one box, 20 x 20 x 4 mm, its upper face at z = 0, bonded at z = -4, its sides free; x right, y down, z out of
the gel. A path is quasi-static: a player with inertia moves slowly and waits for rest in each frame.
"""

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

import numpy as np

if TYPE_CHECKING:
    import trimesh

Array: TypeAlias = np.ndarray
Shape: TypeAlias = Literal["ball", "punch", "edge", "ring", "box"]
PAD_MM = (20.0, 20.0, 4.0)  # width along x, along y, thickness
YOUNGS_MPA, POISSONS, DENSITY_KG_M3 = 0.2, 0.48, 1000.0  # neo-Hookean; the density is for players with inertia
CELLS, CELL_MM = 40, 0.5  # of the grid of pressure and traction, a side
DOTS, PITCH_MM = 9, 2.0  # of the grid of markers, a side
STANDARD_GRAVITY_M_S2 = 9.80665  # of the grasp

PAD = (  # as changes to the sensor gelsight_mini
    *(f"sensor.gel.{name}={value:g}" for name, value in zip(("width_mm", "height_mm"), PAD_MM, strict=False)),
    "sensor.gel.corner_radius_mm=0",
    "sensor.walls.margin_mm=8",  # whose lamps stand beside a larger pad
    f"sensor.gel.layers[0].thickness_mm={PAD_MM[2]:g}",
    f"sensor.gel.layers[0].youngs_modulus_mpa={YOUNGS_MPA:g}",
    f"sensor.gel.layers[0].poissons_ratio={POISSONS:g}",
)

# Shapes as tacgen's recipes give them; each has its lowest point at the origin of its own frame and z up. The edge is a
# roof's ridge along y. The box, which the grasp holds, is 8 x 8 x 10 mm with edges rounded by .5 mm, as a mesh.
SHAPES: dict[Shape, str] = {
    "ball": "{shape: sphere, radius_mm: 4}",
    "punch": "{shape: cylinder, radius_mm: 3, fillet_mm: 0.3}",
    "edge": "{shape: wedge, half_angle_deg: 45, tip_radius_mm: 0.5, length_mm: 8}",
    "ring": "{shape: torus, radius_mm: 3, tube_radius_mm: 0.8}",
}


class Pose(NamedTuple):
    """Place of a shape's origin [mm], which is its lowest point before it is tilted, and its turn [deg]: about its own
    z by `yaw`, then about the sensor's x by `tilt_x`, then about the sensor's y by `tilt_y`."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    tilt_x: float = 0.0
    tilt_y: float = 0.0
    yaw: float = 0.0

    @property
    def matrix(self) -> Array:
        """The pose as a matrix (4, 4)."""
        from scipy.spatial.transform import Rotation

        out = np.eye(4)
        turn = Rotation.from_euler("zxy", (self.yaw, self.tilt_x, self.tilt_y), degrees=True)  # axes that stand still
        out[:3, :3], out[:3, 3] = turn.as_matrix(), self[:3]
        return out


@dataclass(frozen=True)
class Case:
    """A rigid shape on a path, a pose a frame; friction is Coulomb's. Errors are taken in the frames `judged`.

    A grasp (`mass_kg` > 0) has no free path: the box, of that mass and homogeneous, is between two pads. One is the
    sensor, the other its mirror image in the middle of the box, 10 mm farther along z before they close; each of them
    moves towards the middle by -z of the pose. Gravity along +y acts in all frames, and once both are closed nothing
    else holds the box. Judged is the SUM of the forces on both gels, in the sensor's frame, without torques.
    """

    name: str
    shape: Shape
    friction: float
    poses: tuple[Pose, ...]
    judged: tuple[int, ...]
    mass_kg: float = 0.0

    @property
    def weight(self) -> float:
        """Weight of what a grasp holds [N]."""
        return self.mass_kg * STANDARD_GRAVITY_M_S2

    @property
    def moved(self) -> set[str]:
        """Names of a pose's numbers that are not 0 on the whole path."""
        return {name for name, *values in zip(Pose._fields, *self.poses, strict=True) if any(values)}

    @property
    def clearance(self) -> float:
        """Height of the lowest point above the pad before the first frame [mm]: the largest z of the path."""
        return max(0.0, max(pose.z for pose in self.poses))

    @property
    def recipe(self) -> tuple[str, ...]:
        """Changes that make tacgen's recipe `quickstart` this case, as `--set` takes them; a grasp needs more."""
        moves = []
        for before, pose in zip((Pose(z=self.clearance), *self.poses), self.poses, strict=False):
            if pose.z != before.z:
                moves.append("release: {frames: 1}" if pose.z > 0 else f"press: {{depth_mm: {-pose.z:g}, frames: 1}}")
            elif (turn := pose.yaw - before.yaw) != 0:
                moves.append(f"twist: {{angle_deg: {turn:g}, frames: 1}}")
            elif (tilt := pose.tilt_x - before.tilt_x) != 0:
                moves.append(f"tilt: {{angle_deg: {tilt:g}, frames: 1}}")
            else:
                moves.append(f"slide: {{x_mm: {pose.x - before.x:g}, frames: 1}}")
        return (
            *PAD,
            f"indenter={SHAPES[self.shape]}",
            f"start.clearance_mm={self.clearance:g}",
            f"trajectory=[{', '.join(f'{{{move}}}' for move in moves)}]",
            f"contact.friction={self.friction:g}",
        )

    def mesh(self) -> "trimesh.Trimesh":
        """The shape in its own frame [mm], closed, with facets within about 1 um of it. Upper parts that never touch
        are cut off or rounded."""
        return mesh_of(self.shape).copy()


@cache
def mesh_of(shape: Shape, chord: float = 0.001) -> "trimesh.Trimesh":
    """A shape as a closed mesh [mm] whose facets are within `chord` [mm] of it."""
    import trimesh

    def arc(radius: float, start: float, end: float) -> Array:
        """Directions (n, 2) from `start` to `end` [deg] so close that chords are within `chord` of the circle."""
        count = 4 * int(np.ceil(np.radians(abs(end - start)) / np.sqrt(8 * chord / radius) / 4))
        turn = np.radians(np.linspace(start, end, count + 1))
        return np.stack([np.cos(turn), np.sin(turn)], -1)

    if shape == "edge":  # the offset of a prism is the hull of balls at its corners
        ball = trimesh.creation.icosphere(subdivisions=4, radius=0.5).vertices
        at = np.array([(x, y, 0.5 + abs(x)) for x in (-3.0, 0.0, 3.0) for y in (-3.5, 3.5)])
        turn = arc(0.5, -135.0, -45.0)
        ridge = np.stack([0.5 * turn[:, 0], np.zeros(len(turn)), 0.5 * turn[:, 1]], -1)
        hull: trimesh.Trimesh = trimesh.convex.convex_hull((at[:, None] + np.concatenate([ball, ridge])).reshape(-1, 3))
        return hull
    if shape == "box":
        corner = trimesh.creation.icosphere(subdivisions=4, radius=0.5).vertices
        at = np.array([(x, y, z) for x in (-3.5, 3.5) for y in (-3.5, 3.5) for z in (0.5, 9.5)])
        rounded: trimesh.Trimesh = trimesh.convex.convex_hull((at[:, None] + corner).reshape(-1, 3))
        return rounded
    if shape == "ball":
        profile = 4.0 * arc(4.0, -90.0, 90.0) + (0.0, 4.0)
    elif shape == "ring":
        profile = 0.8 * arc(0.8, -180.0, 180.0) + (3.0, 0.8)
    else:
        radius, fillet, height = 3.0, 0.3, 4.0
        corner = fillet * arc(fillet, -90.0, 0.0) + (radius - fillet, fillet)
        profile = np.concatenate([[(0.0, 0.0)], corner, corner[::-1] * (1, -1) + (0, height), [(0.0, height)]])
    if shape != "ring":
        profile[[0, -1], 0] = 0.0  # on the axis
    sections = 8 * int(np.ceil(np.pi / 4 / np.sqrt(8 * chord / profile[:, 0].max())))
    return trimesh.creation.revolve(profile, sections=sections)


def grid() -> Array:
    """Centres of the cells along x, and along y, of `Answer.pressure` and `traction` (CELLS,) [mm]."""
    return CELL_MM * (np.arange(CELLS) - (CELLS - 1) / 2)


def dots() -> Array:
    """Markers on the untouched face (DOTS^2, 2) [mm]: rows along x, one after the other along y."""
    at = PITCH_MM * (np.arange(DOTS) - (DOTS - 1) / 2)
    return np.stack(np.meshgrid(at, at), -1).reshape(-1, 2)


def spread(points: Array, forces: Array) -> tuple[Array, Array]:
    """Pressure (CELLS, CELLS) and traction (CELLS, CELLS, 2) [MPa], rows along y, of forces (n, 3) [N] on the gel at
    points (n, 3) [mm] of the deformed face, each shared among the four nearest cells: -z and x, y of the force per area
    of a cell."""
    place = (np.asarray(points)[:, :2] - grid()[0]) / CELL_MM
    low = np.clip(np.floor(place).astype(int), 0, CELLS - 2)
    part = np.clip(place - low, 0.0, 1.0)
    out = np.zeros((CELLS, CELLS, 3))
    for i in (0, 1):
        for j in (0, 1):
            share = np.abs(1 - i - part[:, 0]) * np.abs(1 - j - part[:, 1])
            np.add.at(out, (low[:, 1] + j, low[:, 0] + i), share[:, None] * forces)
    out /= CELL_MM**2
    return -out[..., 2], out[..., :2]


def _press(*depths: float) -> tuple[Pose, ...]:
    return tuple(Pose(z=-depth) for depth in depths)


def _then(start: Pose, count: int, **to: float) -> tuple[Pose, ...]:
    """`count` equal steps from a pose to one that differs in these numbers."""
    steps = np.arange(1, count + 1) / count
    return tuple(start._replace(**{k: getattr(start, k) + float(s) * (v - getattr(start, k)) for k, v in to.items()})
                 for s in steps)  # fmt: skip


def _slide(name: str, shape: Shape, depth: float, friction: float) -> Case:
    """Pressed in two frames, slid by 1 mm in four."""
    path = (*_press(depth / 2, depth), *_then(Pose(z=-depth), 4, x=1.0))
    return Case(name, shape, friction, path, (1, 2, 5) if friction else (5,))


CASES = (
    Case("press ball", "ball", 0.0, _press(0.4, 0.8, 1.2), (0, 1, 2)),
    Case("press punch", "punch", 0.0, _press(0.2, 0.4, 0.6), (0, 1, 2)),
    Case("press edge", "edge", 0.0, _press(0.3, 0.6, 0.9), (0, 1, 2)),
    Case("press ring", "ring", 0.0, _press(0.2, 0.4, 0.6), (0, 1, 2)),
    _slide("slide ball, friction 0", "ball", 0.8, 0.0),
    _slide("slide ball, friction .3", "ball", 0.8, 0.3),
    _slide("slide ball, friction .8", "ball", 0.8, 0.8),
    _slide("slide edge, friction .3", "edge", 0.6, 0.3),
    Case("twist punch", "punch", 0.8, (*_press(0.2, 0.4), *_then(Pose(z=-0.4), 4, yaw=20.0)), (1, 2, 5)),
    Case("tilt edge", "edge", 0.0, (*_press(0.3, 0.6), *_then(Pose(z=-0.6), 2, tilt_x=5.0)), (1, 2, 3)),
    Case("release ball", "ball", 0.8, (*_press(0.4, 0.8, 0.4), Pose(z=0.2)), (1, 3)),
    Case("grasp box", "box", 0.8, (Pose(z=-0.1), Pose(z=-0.2), Pose(z=-0.2)), (2,), mass_kg=0.05),
)
