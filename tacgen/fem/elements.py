"""Element tables: connectivity, shape-function gradients and weights at the integration points."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from tacgen.physics.cells import Numbering

Array = np.ndarray

# corners of the reference cube, counter-clockwise below then above
HEX_CORNERS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], float
)
HEX_EDGES = np.array([(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)])
QUAD_CORNERS = HEX_CORNERS[:4, :2]
GAUSS_POINTS_2 = np.array([-1.0, 1.0]) / np.sqrt(3.0)
# Gauss-Legendre points and weights on [-1, 1], by number of points
GAUSS_RULES = {2: (GAUSS_POINTS_2, np.ones(2)), **{n: np.polynomial.legendre.leggauss(n) for n in (3, 4)}}
TET_EDGES = np.array([(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)])
TRIANGLE_EDGES = np.array([(0, 1), (1, 2), (2, 0)])
# the smaller barycentric coordinate of the 4-point rule of degree 2 for tets
TET_POINT_COORDINATE = (5 - np.sqrt(5.0)) / 20
# Elements.pointwise [-] by nodes; of quadratic tets inf was 2.7 % too stiff at nu 0.4995, 0 was 2.6 % too soft
MAX_POINTWISE_BULK_RATIO = {8: 0.0, 10: 25.0, 4: np.inf}
# the smaller barycentric coordinate and the weight of each orbit of three points, by nodes of the triangle
DUNAVANT_RULES = {
    3: ((1 / 6, 1 / 3),),
    6: ((0.445948490915965, 0.223381589678011), (0.091576213509771, 0.109951743655322)),
}
FACET_TRIANGLES = {3: ([0, 1, 2],), 4: ([0, 1, 2], [0, 2, 3]), 6: ([0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5])}


@dataclass(frozen=True)
class Elements:
    """Elements of one type.

    conn (e, a) node numbers; gradients (e, q, a, 3) dN/dX [1/mm]; weights (e, q) [mm^3];
    pointwise: bulk modulus, over the shear modulus, up to which the volumetric energy is a function of J at each point;
    the rest of the bulk modulus acts on the element's mean J, which avoids locking [-]. shape (q, a): N.
    """

    conn: Array
    gradients: Array
    weights: Array
    pointwise: float
    shape: Array

    @cached_property
    def numbering(self) -> "Numbering":
        """Their nodes, as the kernels take them."""
        from tacgen.physics.cells import Numbering

        return Numbering.of(self.conn)


def elements(points: Array, conn: Array) -> Elements:
    """The elements of the type that has as many nodes as conn (e, a).

    8: trilinear hexes with 2x2x2 points and mean dilatation, Nagtegaal, Parks & Rice (1974). 10: quadratic tetrahedra
    with 4 points; nodes as in VTK: corners, then edge nodes in the order of TET_EDGES, which need not be at the edges'
    midpoints. 4: linear tetrahedra with 1 point, which lock.

    Raises:
        ValueError: an element is inverted.
    """
    N, dN, parts = integration(nodes := conn.shape[1])
    gradients, volume = _mapped(points, conn, dN)
    return Elements(conn.astype(np.int32), gradients, volume / parts, MAX_POINTWISE_BULK_RATIO[nodes], N)


def integration(nodes: int) -> tuple[Array, Array, int]:
    """Integration points of elements of so many nodes: N (q, a), its derivatives (q, a, 3) in the reference element,
    and the number of equal parts into which these points divide a cube of side 1."""
    if nodes == 8:
        ticks = GAUSS_POINTS_2
        return *trilinear(np.array([[a, b, c] for c in ticks for b in ticks for a in ticks])), 1
    L, least = np.full((1, 4), 0.25), TET_POINT_COORDINATE
    if nodes == 10:
        L = np.full((4, 4), least) + np.eye(4) * (1 - 4 * least)
    N, dL = barycentric(L, nodes)
    return N, dL[..., 1:] - dL[..., :1], 6 * len(L)


def trilinear(at: Array) -> tuple[Array, Array]:
    """Shape functions N (q, 8) of a hex and dN (q, 8, 3) at points (q, 3) of the reference cube."""
    f = 1 + HEX_CORNERS[None] * at[:, None]  # (q, a, 3)
    return f.prod(2) / 8, np.stack([HEX_CORNERS[:, k] * np.delete(f, k, 2).prod(2) / 8 for k in range(3)], -1)


def jacobians(points: Array, conn: Array, dN: Array) -> Array:
    """dX/dxi (e, q, 3, 3) of elements conn (e, a) at points with the derivatives dN (q, a, 3)."""
    x = np.ascontiguousarray(np.moveaxis(points[conn], 0, -1))  # elements last: the longest axis in the inner loop
    return np.ascontiguousarray(np.moveaxis(np.einsum("qaj,aie->qije", dN, x), -1, 0))


def _mapped(points: Array, conn: Array, dN: Array) -> tuple[Array, Array]:
    """dN/dX (e, q, a, 3) and det(dX/dxi) (e, q) of elements; dN (q, a, 3). Raises ValueError: an inverted element."""
    jacobian = jacobians(points, conn, dN)
    volume = np.linalg.det(jacobian)
    if (volume <= 0).any():
        raise ValueError(f"{int((volume <= 0).any(1).sum())} elements are inverted")
    inverse = np.ascontiguousarray(np.moveaxis(np.linalg.inv(jacobian), 0, -1))
    return np.ascontiguousarray(np.moveaxis(np.einsum("qaj,qjIe->qaIe", dN, inverse), -1, 0)), volume


def boxes(number: Array) -> Array:
    """Hexes (i - 1, j - 1, k - 1, 8) of a grid whose nodes have the numbers `number` (i, j, k)."""
    i, j, k = (n - 1 for n in number.shape)
    corners = ((HEX_CORNERS + 1) / 2).astype(int)
    return np.stack([number[a : a + i, b : b + j, c : c + k] for a, b, c in corners], -1)


def barycentric(L: Array, corners: int) -> tuple[Array, Array]:
    """Shape functions N (q, a) of a simplex and dN/dL (q, a, corners) at barycentric points L (q, corners).

    Linear on the corners alone, and quadratic with a node on each edge: N_i = L_i (2 L_i - 1), N_ij = 4 L_i L_j.
    """
    edges = TET_EDGES if L.shape[1] == 4 else TRIANGLE_EDGES
    if corners == L.shape[1]:
        return L, np.broadcast_to(np.eye(corners), (len(L), corners, corners)).copy()
    i, j = edges.T
    dN = np.zeros((len(L), L.shape[1] + len(edges), L.shape[1]))
    for k in range(L.shape[1]):
        dN[:, k, k] = 4 * L[:, k] - 1
    for k, (a, b) in enumerate(edges):
        dN[:, L.shape[1] + k, a], dN[:, L.shape[1] + k, b] = 4 * L[:, b], 4 * L[:, a]
    return np.concatenate([L * (2 * L - 1), 4 * L[:, i] * L[:, j]], 1), dN


def quadratic(points: Array, *conns: Array) -> tuple[Array, ...]:
    """Points and linear tets (e, 4) or triangles (f, 3), with a node in the middle of every edge."""
    ends = [np.sort(conn[:, TET_EDGES if conn.shape[1] == 4 else TRIANGLE_EDGES], -1) for conn in conns]
    keys = [low * len(points) + high for low, high in (np.moveaxis(e, -1, 0) for e in ends)]
    edges = np.unique(np.concatenate([key.ravel() for key in keys]))
    middle = (points[edges // len(points)] + points[edges % len(points)]) / 2
    more = [len(points) + np.searchsorted(edges, key) for key in keys]
    both = (np.concatenate([conn, new], 1) for conn, new in zip(conns, more, strict=True))
    return np.concatenate([points, middle]), *both


def grid_points(nodes: int) -> tuple[Array, Array]:
    """N (q, a) and its derivatives (q, a, 3) at points of the whole element, corners included: for hexes a grid of
    3 x 3 x 3 points, which determine the Jacobian; for tets the nodes."""
    if nodes == 8:
        grid = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), -1).reshape(-1, 3)
        return trilinear(grid)
    corners = np.eye(4)
    N, dL = barycentric(np.concatenate([corners, corners[TET_EDGES].mean(1)])[:nodes], nodes)
    return N, dL[..., 1:] - dL[..., :1]


def facet_points(nodes: int, along: int = 2) -> tuple[Array, Array, Array]:
    """Quadrature on a facet of 4 (quad), 6 or 3 (triangle) nodes: N (q, a), dN (q, a, 2) and weights (q,).

    Quads: `along` x `along` Gauss points. Triangles: 6 points of degree 4 or 3 of degree 2, Dunavant (1985).
    """
    if nodes == 4:
        at, weight = GAUSS_RULES[along]
        g = np.array([[a, b] for b in at for a in at])
        f = 1 + QUAD_CORNERS[None] * g[:, None]
        dN = np.stack([QUAD_CORNERS[:, 0] * f[..., 1], f[..., 0] * QUAD_CORNERS[:, 1]], -1) / 4
        return f.prod(2) / 4, dN, np.outer(weight, weight).ravel()
    rule = DUNAVANT_RULES[nodes]
    L = np.concatenate([np.full((3, 3), a) + np.eye(3) * (1 - 3 * a) for a, _ in rule])
    N, dL = barycentric(L, nodes)
    return N, dL[..., 1:] - dL[..., :1], np.repeat([w for _, w in rule], 3) / 2


def facet_corners(nodes: int) -> Array:
    """Reference coordinates of the nodes of a facet (a, 2)."""
    if nodes == 4:
        return QUAD_CORNERS
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    return np.concatenate([corners, corners[TRIANGLE_EDGES].mean(1)])[:nodes]


def facet_areas(points: Array, facets: Array, along: int = 2) -> tuple[Array, Array]:
    """Areas of the quadrature points (f, q) [mm^2] and unit normals (f, q, 3) of curved facets (f, a)."""
    _, dN, weights = facet_points(facets.shape[1], along)
    tangents = np.einsum("qak,fai->fqki", dN, points[facets])
    normal = np.cross(tangents[:, :, 0], tangents[:, :, 1])
    area = np.linalg.norm(normal, axis=2)
    return area * weights, normal / area[..., None]


def facet_hats(nodes: int, at: Array) -> Array:
    """Shape functions (n, nodes) at reference coordinates (n, 2) of a facet as it is drawn: linear on the flat
    triangles of `triangles`, bilinear on quads."""
    u, v = at.T
    if nodes == 4:
        return np.stack([(1 + a * u) * (1 + b * v) / 4 for a, b in QUAD_CORNERS], -1)
    L = np.stack([1 - u - v, u, v], -1)
    if nodes == 3:
        return L
    hats, points = np.zeros((len(L), 6)), np.arange(len(L))
    k = L.argmax(1)
    own, after, before = (L[points, (k + i) % 3] for i in range(3))
    corner = own > 0.5  # in corner k's own triangle, else in the middle one; edge 3 + i runs from corner i to the next
    hats[points, k] = np.where(corner, 2 * own - 1, 0.0)
    hats[points, 3 + k] = np.where(corner, 2 * after, 1 - 2 * before)
    hats[points, 3 + (k + 1) % 3] = np.where(corner, 0.0, 1 - 2 * own)
    hats[points, 3 + (k + 2) % 3] = np.where(corner, 2 * before, 1 - 2 * after)
    return hats


def facet_shares(N: Array, areas: Array) -> Array:
    """Shares (q, a) of the nodes in the forces at a facet's points N (q, a), of areas (f, q), for drawing maps.

    They are the `facet_hats`, which preserve the resultant and its line of action. The six points of a quadratic
    triangle do not resolve the kinks of these functions: under uniform pressure the corners would get a sixth too
    little, which shows as a pattern in maps. A correction that also preserves the resultant moves force from edge nodes
    to corners, so that each node gets the force on its own area.
    """
    nodes = N.shape[1]
    at = N @ facet_corners(nodes)
    hats = facet_hats(nodes, at)
    if nodes == 6:
        part = areas.sum(0) / areas.sum()
        for k in range(3):
            near = (hats[:, k] > 0) & (hats[:, k] < 1)  # in the corner's own triangle, but not at the corner
            moved = (1 / 12 - part @ hats[:, k]) / part[near].sum()
            hats[near] += moved * np.eye(6)[[k, 3 + (k + 1) % 3]].sum(0)
            hats[near] -= moved * np.eye(6)[[3 + k, 3 + (k + 2) % 3]].sum(0)
    return hats


def linear_pressure(N: Array, areas: Array) -> Array:
    """Forces at a triangle's points N (q, a), of areas (f, q), to those of the linear pressure with the same force and
    moments (q, q)."""
    x, y = (N @ facet_corners(N.shape[1])).T
    linear = np.stack([np.ones(len(N)), x, y], -1)
    weighted = areas.sum(0)[:, None] * linear
    return np.asarray(weighted @ np.linalg.solve(linear.T @ weighted, linear.T))


def triangles(facets: Array) -> Array:
    """Flat triangles (t, 3) with which facets (f, a) are drawn."""
    return np.concatenate([facets[:, corners] for corners in FACET_TRIANGLES[facets.shape[1]]])
