"""About how far a frame's force is off because of the mesh, from the element edge and the width of the contact."""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np

from tacgen.geometry.analytic_sdf import MAX_SLOPE
from tacgen.geometry.pose import Pose

if TYPE_CHECKING:
    from tacgen.geometry.analytic_sdf import Shape
    from tacgen.geometry.gel import GelBody

Array = np.ndarray
AT_1_MM, EDGE_POWER, WIDTH_POWER = 0.110, 1.8, -0.45  # fitted by scripts/edge_law.py to 45 ordinary scenes
FACTOR = 2  # within which most measured errors are: 77 % of 75 errors of 15 scenes that the fit has not seen
POINTS = 15_000  # of the face's bounding box at which the overlap is counted: some .2 mm apart
BLOCK = 8  # points along the side of a block, in which none is looked at if the indenter is far away


def expected_force_error(edge: float, width: float) -> float:
    """Expected error of the force by the mesh, over the force [-]: .110 edge^1.8 width^-.45, within a factor of 2.

    It says how large the error is, not its sign (mostly the force is too large). Measured for hexahedra and contact by
    distance, with edges from .3 to 1.2 mm against .21 mm, in presses of ordinary scenes (benchmarks/draws.py). Long
    frames with friction, folds and the gel's constants have errors of their own.

    Args:
        edge: element edge under the contact [mm].
        width: twice the area over the perimeter of the contact [mm], of a disc its radius; nan without contact.
    """
    return float(AT_1_MM * edge**EDGE_POWER * width**WIDTH_POWER) if width > 0 else math.nan


@dataclass(frozen=True)
class FaceGrid:
    """Points (n, 3) [mm] of the untouched face on a grid of `shape`, `step` [mm] apart, and which are on the gel."""

    points: Array
    shape: tuple[int, int]
    inside: Array
    step: float

    @classmethod
    @lru_cache(maxsize=2)
    def of(cls, gel: "GelBody", step: float = 0.0) -> "FaceGrid":
        """The face of a gel, shared by the scenes of a sensor; a grasp has two. A `step` of 0 gives POINTS points."""
        step = step or math.sqrt(gel.width * gel.height / POINTS)
        x, y = (np.arange(-size / 2, size / 2, step) for size in (gel.width, gel.height))
        at = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
        inside = gel.contains(*at.T)
        top = np.where(inside, gel.top(*at.T), 0.0)
        return cls(np.column_stack([at, top]), (len(x), len(y)), inside, step)

    def overlap(self, shape: "Shape", pose: Array) -> tuple[float, float]:
        """Area [mm^2] and perimeter [mm] of the part that lies inside an indenter at a pose (4, 4)."""
        placed, (numbers, middle, radius) = Pose.of(pose), self._blocks
        near = numbers[shape.value(placed.local(middle)) < MAX_SLOPE * radius].ravel()
        hit = np.zeros(self.shape, bool)
        hit.flat[near] = self.inside[near] & (shape.value(placed.local(self.points[near])) < 0)
        # Crofton's formula: crossings along two directions, times pi / 4
        crossings = np.count_nonzero(hit[1:] != hit[:-1]) + np.count_nonzero(hit[:, 1:] != hit[:, :-1])
        return np.count_nonzero(hit) * self.step**2, crossings * self.step * math.pi / 4

    @cached_property
    def _blocks(self) -> tuple[Array, Array, Array]:
        """Numbers (b, k) of the points in each block of BLOCK x BLOCK; a sphere around them: centres (b, 3), radii (b,)
        [mm]. Numbers at the ends come twice."""
        number = np.arange(len(self.points)).reshape(self.shape)
        number = np.pad(number, [(0, -n % BLOCK) for n in self.shape], mode="edge")
        x, y = number.shape
        number = number.reshape(x // BLOCK, BLOCK, y // BLOCK, BLOCK).swapaxes(1, 2).reshape(-1, BLOCK**2)
        points = self.points[number]
        middle = points.mean(1)
        return number, middle, np.linalg.norm(points - middle[:, None], axis=-1).max(1)

    def width(self, shape: "Shape", pose: Array) -> float:
        """Twice the area over the perimeter of the overlap [mm]; nan if there is none."""
        area, perimeter = self.overlap(shape, pose)
        return 2 * area / perimeter if perimeter else math.nan
