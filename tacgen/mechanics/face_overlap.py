"""How an indenter overlaps the untouched face of a gel: area, perimeter, and its smallest radius there."""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tacgen.geometry.analytic_sdf import MAX_SDF_SLOPE
from tacgen.geometry.pose import Pose

if TYPE_CHECKING:
    from tacgen.geometry.analytic_sdf import Shape
    from tacgen.geometry.gel import GelBody

Array = np.ndarray
MAX_MEASURED_FRAMES = 12  # frames of a scene whose contact is measured
OVERLAP_GRID_POINTS = 15_000  # of the face's bounding box at which the overlap is counted: some .2 mm apart
OVERLAP_BLOCK_POINTS = 8  # points along the side of a block, in which none is looked at if the indenter is far away
# points of an overlap, below which it is counted on a grid that is so many times as fine
MIN_OVERLAP_POINTS, OVERLAP_REFINEMENT = 150, 8


class Overlap(NamedTuple):
    """The part of the untouched face that lies inside an indenter: area [mm^2] and perimeter [mm]."""

    area: float
    perimeter: float

    @property
    def width(self) -> float:
        """Twice the area over the perimeter [mm], of a disc its radius; nan if there is no overlap."""
        return 2 * self.area / self.perimeter if self.perimeter else math.nan


@dataclass(frozen=True)
class FaceGrid:
    """Points (n, 3) [mm] of the untouched face on a grid of `shape`, `step` [mm] apart, and which are on the gel."""

    gel: "GelBody"
    points: Array
    shape: tuple[int, int]
    inside: Array
    step: float

    @classmethod
    @lru_cache(maxsize=2)
    def of(cls, gel: "GelBody", step: float = 0.0) -> "FaceGrid":
        """The face of a gel, shared by the scenes of a sensor; a grasp has two. A `step` of 0 gives OVERLAP_GRID_POINTS
        points.
        """
        step = step or math.sqrt(gel.width * gel.height / OVERLAP_GRID_POINTS)
        x, y = (np.arange(-size / 2, size / 2, step) for size in (gel.width, gel.height))
        at = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
        inside = gel.contains(*at.T)
        top = np.where(inside, gel.top(*at.T), 0.0)
        return cls(gel, np.column_stack([at, top]), (len(x), len(y)), inside, step)

    def overlap(self, shape: "Shape", pose: Array) -> Overlap:
        """The overlap with an indenter at a pose (4, 4); one of few points is counted on a grid OVERLAP_REFINEMENT
        times as fine.
        """
        placed, (numbers, middle, radius) = Pose.of(pose), self._blocks
        near = numbers[shape.value(placed.local(middle)) < MAX_SDF_SLOPE * radius].ravel()
        gap = shape.value(placed.local(self.points[near]))
        hit = np.zeros(self.shape, bool)
        hit.flat[near] = self.inside[near] & (gap < 0)
        # a point of the finer grid is less than a step away from one of this
        near = near[gap < MAX_SDF_SLOPE * self.step] if np.count_nonzero(hit) < MIN_OVERLAP_POINTS else near[:0]
        return self._finely(shape, placed, near) if len(near) else _measured(hit, self.step)

    def _finely(self, shape: "Shape", placed: Pose, near: Array) -> Overlap:
        """The overlap around the points with numbers `near`."""
        low, high, step = self.points[near].min(0), self.points[near].max(0), self.step / OVERLAP_REFINEMENT
        x, y = (np.arange(low[k] - self.step, high[k] + self.step + step / 2, step) for k in (0, 1))
        at = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
        hit = self.gel.contains(*at.T)
        at = at[hit]
        hit[hit] = shape.value(placed.local(np.column_stack([at, self.gel.top(*at.T)]))) < 0
        return _measured(hit.reshape(len(x), len(y)), step)

    def radius(self, shape: "Shape", pose: Array) -> float:
        """Smallest radius of curvature [mm] of an indenter where it lies below the untouched face."""
        if (convex := shape.convex) is None:
            return shape.smallest_radius

        def below(points: Array) -> Array:
            x, y, z = (points @ pose[:3, :3].T + pose[:3, 3]).T
            inside = self.gel.contains(x, y)
            inside[inside] = z[inside] < self.gel.top(x[inside], y[inside])
            return inside

        return convex.smallest(below)

    @cached_property
    def _blocks(self) -> tuple[Array, Array, Array]:
        """Numbers (b, k) of the points in each block of OVERLAP_BLOCK_POINTS x OVERLAP_BLOCK_POINTS; a sphere around
        them: centres (b, 3), radii (b,) [mm]. Numbers at the ends come twice."""
        number = np.arange(len(self.points)).reshape(self.shape)
        number = np.pad(number, [(0, -n % OVERLAP_BLOCK_POINTS) for n in self.shape], mode="edge")
        x, y = number.shape
        number = (
            number.reshape(
                x // OVERLAP_BLOCK_POINTS, OVERLAP_BLOCK_POINTS, y // OVERLAP_BLOCK_POINTS, OVERLAP_BLOCK_POINTS
            )
            .swapaxes(1, 2)
            .reshape(-1, OVERLAP_BLOCK_POINTS**2)
        )
        points = self.points[number]
        middle = points.mean(1)
        return number, middle, np.linalg.norm(points - middle[:, None], axis=-1).max(1)


def _measured(hit: Array, step: float) -> Overlap:
    """Area and perimeter of the cells (x, y) of a grid that are hit; by Crofton's formula, crossings along two
    directions times pi / 4."""
    crossings = np.count_nonzero(hit[1:] != hit[:-1]) + np.count_nonzero(hit[:, 1:] != hit[:, :-1])
    return Overlap(np.count_nonzero(hit) * step**2, crossings * step * math.pi / 4)


def overlaps(gel: "GelBody", shape: "Shape", poses: Array) -> list[tuple[Overlap, Array]]:
    """The overlap in MAX_MEASURED_FRAMES frames at the most, the last among them, and their poses (4, 4)."""
    face, some = FaceGrid.of(gel), poses[:: -(-len(poses) // MAX_MEASURED_FRAMES)]
    return [(face.overlap(shape, pose), pose) for pose in (*some, poses[-1])]
