"""A lower bound of the Jacobian at all points of the elements, not at the integration points alone.

The Jacobian determinant of an element is a polynomial, which lies between the smallest and the largest of its
Bernstein coefficients; those at the corners are its values there. Johnen, Remacle & Geuzaine, "Geometrical validity of
curvilinear finite elements", Journal of Computational Physics 233 (2013).
"""

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from tacgen.fem.elements import HEX_CORNERS, TET_EDGES, barycentric
from tacgen.physics import jacobian
from tacgen.physics.runtime import empty, run

Array = np.ndarray
MAX_SUBDIVISIONS = 6  # most subdivisions; each reduces the gap between coefficients and values about four times
MAX_PIECES = 1000  # most pieces into which an element is divided; one that is near its least value takes about 50
# coefficients of a quadratic polynomial on each half of an edge from those on the whole edge, by de Casteljau
EDGE_HALVING = np.array([[[4, 0, 0], [2, 2, 0], [1, 2, 1]], [[1, 2, 1], [0, 2, 2], [0, 0, 4]]]) / 4
# the eight pieces of a tet by its nodes, in Bey's order (1995), which keeps the shapes of repeated pieces bounded
TET_EIGHTHS = np.array(
    [(0, 4, 6, 7), (4, 1, 5, 8), (6, 5, 2, 9), (7, 8, 9, 3), (4, 6, 7, 8), (4, 6, 5, 8), (6, 7, 8, 9), (6, 5, 8, 9)]
)


@dataclass(frozen=True)
class Bernstein:
    """Constants that give the k Bernstein coefficients of the determinant from the a nodes of an element type.

    Each column of the Jacobian matrix is linear between its values at p places, so the determinant is a sum over p^3
    triples of them, and a coefficient is the mean of the triples of its monomial. columns (3, p, b): dN/dxi at the
    places, of the nodes (3, p, b) where it is not 0; monomial (p, p, p): number of the coefficient; share (k,): 1 over
    how many triples it has, so 1 at corners; pieces (c, k, k): the coefficients on each part of a divided element from
    those on the whole.
    """

    nodes: Array
    columns: Array
    monomial: Array
    share: Array
    pieces: Array

    @property
    def whole(self) -> tuple[Array, ...]:
        """All that gives the coefficients of an element that is not divided."""
        return self.nodes, self.columns, self.monomial, self.share


def _table(columns: Array, powers: Array) -> tuple[Array, Array, Array, Array]:
    """Nodes, columns, monomials and shares; powers (3, p, v): exponents of the factors of the columns' values."""
    total = powers[0][:, None, None] + powers[1][:, None] + powers[2]
    p = powers.shape[1]
    _, number, count = np.unique(total.reshape(p**3, -1), axis=0, return_inverse=True, return_counts=True)
    nodes = np.argsort(columns == 0, axis=2, kind="stable")[..., : (columns != 0).sum(2).max()]
    columns, monomial = np.take_along_axis(columns, nodes, 2), number.reshape(p, p, p).astype(np.int32)
    return nodes.astype(np.int32), columns, monomial, 1 / count


def _hexes() -> Bernstein:
    """Degree 2 in each direction: a column is bilinear in the other two directions, and its places are four edges."""
    columns, powers = np.zeros((3, 4, 8)), np.zeros((3, 4, 3), int)
    for k in range(3):
        above = np.delete(HEX_CORNERS > 0, k, 1)
        columns[k, above @ (2, 1), np.arange(8)] = HEX_CORNERS[:, k]
        powers[k] = np.insert(list(product((0, 1), repeat=2)), k, 0, axis=1)
    pieces = [np.kron(a, np.kron(b, c)) for a, b, c in product(EDGE_HALVING, repeat=3)]
    return Bernstein(*_table(columns, powers), np.array(pieces))


def _tets() -> Bernstein:
    """Degree 3: a column of a quadratic tet is linear, and its places are the corners."""
    corners = np.eye(4)
    _, dL = barycentric(corners, 10)
    nodes, columns, monomial, share = _table((dL[..., 1:] - dL[..., :1]).transpose(2, 0, 1), np.array([corners] * 3))
    pieces = np.zeros((len(TET_EIGHTHS), len(share), len(share)))
    places = np.concatenate([corners, corners[TET_EDGES].mean(1)])
    for piece, ends in zip(pieces, places[TET_EIGHTHS], strict=True):
        for triple in np.ndindex(4, 4, 4):  # the blossom at three corners of the piece; it is symmetric
            a, b, c = ends[list(triple)]
            weights = a[:, None, None] * b[:, None] * c
            piece[monomial[triple]] = np.bincount(monomial.ravel(), weights.ravel(), len(share))
    return Bernstein(nodes, columns, monomial, share, pieces)


def _linear() -> Bernstein:
    """Degree 0: the columns of a linear tet are constant."""
    dL = np.eye(4)
    return Bernstein(*_table((dL[:, 1:] - dL[:, :1]).T[:, None], np.zeros((3, 1, 1))), np.ones((1, 1, 1)))


JACOBIAN_TABLES = {8: _hexes(), 10: _tets(), 4: _linear()}  # by the number of nodes


def least_jacobian(rest: Array, points: Array, cells: Array, tol: float = 0.01) -> float:
    """Lower bound of J at all points of all elements.

    rest, points (n, 3) [mm]: positions of the nodes at rest and now; cells (e, 8, 10 or 4): trilinear hexes, quadratic
    or linear tets. J is det(dx/dxi) over the element's mean det(dX/dxi); for an element that is affine at rest it is
    the Jacobian of the deformation. The bound holds up to rounding, and is at most `tol` below the least J unless
    MAX_SUBDIVISIONS or MAX_PIECES is reached; -inf if points are not finite.

    Raises:
        ValueError: an element has no volume at rest.
    """
    table, conn = JACOBIAN_TABLES[cells.shape[1]], np.asarray(cells, np.int32)
    low, volume = bounds(rest[None], points[None], conn, np.zeros((0, 0), bool), (*table.whole, table.pieces), tol)
    if not (volume > 0).all():
        raise ValueError(f"{int((~(volume > 0)).sum())} elements have no volume at rest")
    return float(low.min())


def bounds(rest: Any, x: Any, conn: Any, exists: Any, table: tuple[Any, ...], tol: float) -> tuple[Any, Any]:
    """Lower bounds of J in elements (s, e), of which the smallest of a scene is as in `least_jacobian`, and volumes at
    rest, both of arrays of NumPy or PyTorch.

    rest, x (s, n, 3); conn (e, a) int32; exists (s, e), without rows there all do; table: a Bernstein's `whole` and
    `pieces`.
    """
    volume, low, attained = (empty(x, len(x), len(conn)) for _ in range(3))
    run(jacobian.whole_bounds, volume.shape, rest, x, conn, exists, *table[:-1], volume, low, attained)
    least = attained.min(1) if isinstance(attained, np.ndarray) else attained.amin(1)
    run(
        jacobian.divided_bounds, volume.shape, x, conn, *table, volume, least, tol, MAX_SUBDIVISIONS, MAX_PIECES, low
    )  # fmt: skip
    return low, volume
