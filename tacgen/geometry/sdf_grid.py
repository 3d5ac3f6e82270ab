"""An indenter of any shape: its signed distance as a cubic B-spline on a regular grid, C2 everywhere.

Edges sharper than a cell are rounded by about one cell.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage

from tacgen.geometry.analytic_sdf import Record, Recorded
from tacgen.geometry.convex_edges import Convex
from tacgen.physics.cores import ShapeNumber
from tacgen.physics.edges import ROW_NUMBERS
from tacgen.physics.splines import COEFFICIENTS

Array = np.ndarray
EDGE_BEND_RATIO = 0.5  # sum of second differences at an edge, over the cell size [-]
MEAN_EDGE_BEND_RATIO = 0.35  # the same for the binomial mean, which spreads an edge over several cells [-]


@dataclass(frozen=True, eq=False)
class Field(Recorded):
    """A rigid indenter given by its signed distance on a grid; fits `analytic_sdf.Shape`.

    coefficients (i, j, k) of the spline [mm], the first at `origin` (3,) [mm], `cell` apart [mm]; corners (h, 3) of the
    body's convex hull [mm]; surface: its vertices (n, 3) [mm] and triangles (m, 3), and its `convex` edges, if known.
    Outside the grid the distance is a lower bound: the surface that can touch the gel must be inside, at least the
    contact range from the grid's boundary.
    """

    coefficients: Array
    origin: Array
    cell: float
    smallest_radius: float
    reach: float
    corners: Array
    surface: tuple[Array, Array] | None
    convex: Convex | None

    @classmethod
    def through(
        cls,
        distances: Array,
        origin: Array,
        cell: float,
        *,
        smallest_radius: float,
        corners: Array,
        surface: tuple[Array, Array] | None = None,
        convex: Convex | None = None,
        blunt: bool = False,
    ) -> "Field":
        """The field of signed distances (i, j, k) [mm], at least 4 a side, at the grid's nodes.

        Coefficients are c = d - w bend/6 with `bend` the sum of second differences. With w = 1 the spline is of fourth
        order (error 0.5 um on a sphere of 4 mm with cells of 0.156 mm). At edges, where bend is of the order of a cell,
        w goes to 0 and the spline smooths: an exact interpolant oscillates on flat faces, which shows in the pressure.

        `blunt` rounds edges by two cells instead of one, as a grid twice as coarse would: there c is the binomial mean
        of d, with variance cell^2 in each direction.
        """
        d = np.asarray(distances, float)
        bend = _second_differences(d)
        spline = d - np.exp(-((bend / (EDGE_BEND_RATIO * cell)) ** 2)) * bend / 6
        if blunt:
            mean = d
            for axis in range(3):
                mean = ndimage.correlate1d(mean, np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16, axis=axis, mode="nearest")
            smooth = np.exp(-((_second_differences(mean) / (MEAN_EDGE_BEND_RATIO * cell)) ** 2))
            spline = smooth * spline + (1 - smooth) * mean
        more = _half_thickness(d, cell), corners, surface, convex
        return cls(spline, np.asarray(origin, float), cell, smallest_radius, *more)

    @cached_property
    def record(self) -> Record:
        numbers = np.zeros((1, ROW_NUMBERS))
        numbers[0, :COEFFICIENTS] = ShapeNumber.field, *self.coefficients.shape, *self.origin, self.cell
        return Record(numbers, np.ascontiguousarray(self.coefficients, float).ravel())

    def support(self, direction: Array) -> float:
        """Support function of the body's convex hull along a unit vector (3,) [mm]."""
        return float((self.corners @ direction).max())


def _second_differences(d: Array) -> Array:
    """Sum of second differences (i, j, k) [mm]."""
    return np.asarray(sum(ndimage.correlate1d(d, [1.0, -2.0, 1.0], axis=a, mode="nearest") for a in range(3)))


def _half_thickness(distances: Array, cell: float) -> float:
    """Half the thinnest wall [mm]: the least depth of points that are equally far from two sides."""
    slope = np.sqrt(sum(g**2 for g in np.gradient(np.asarray(distances, float), cell)))
    # the slope is 0.7 between faces at a right angle, 0 between parallel faces
    middle = (slope < 0.4) & (distances < -cell)
    depth = -distances[middle].max() if middle.any() else -distances.min()
    return float(max(depth, cell))
