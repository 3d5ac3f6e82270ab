"""Element tables: connectivity, shape-function gradients and weights at the integration points."""

from dataclasses import dataclass

import numpy as np

Array = np.ndarray

# corners of the reference cube, counter-clockwise below then above
HEX_CORNERS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], float
)
QUAD_CORNERS = HEX_CORNERS[:4, :2]
GAUSS2 = np.array([-1.0, 1.0]) / np.sqrt(3.0)


@dataclass(frozen=True)
class Elements:
    """Elements of one type.

    conn (e, a) node numbers; gradients (e, q, a, 3) dN/dX [1/mm]; weights (e, q) [mm^3];
    mean_dilatation: the volumetric energy is evaluated at the element's mean J (Q1P0 for hexes); shape (q, a): N.
    """

    conn: Array
    gradients: Array
    weights: Array
    mean_dilatation: bool
    shape: Array


def hexes(points: Array, conn: Array) -> Elements:
    """Trilinear hexes with 2x2x2 points and mean dilatation, Nagtegaal, Parks & Rice (1974).

    Raises:
        ValueError: an element is turned inside out.
    """
    g = np.array([[a, b, c] for c in GAUSS2 for b in GAUSS2 for a in GAUSS2])
    f = 1 + HEX_CORNERS[None] * g[:, None]  # (q, a, 3)
    dN = np.stack([HEX_CORNERS[:, k] * np.delete(f, k, 2).prod(2) / 8 for k in range(3)], -1)
    jacobian = np.einsum("qaj,eai->eqij", dN, points[conn])
    volume = np.linalg.det(jacobian)
    if (volume <= 0).any():
        raise ValueError(f"{int((volume <= 0).any(1).sum())} hexes are turned inside out")
    gradients = np.einsum("qaj,eqjI->eqaI", dN, np.linalg.inv(jacobian))
    return Elements(conn.astype(np.int32), np.ascontiguousarray(gradients), volume, True, f.prod(2) / 8)


def quad_points() -> tuple[Array, Array]:
    """2x2 Gauss points on a quad: shape functions N (q, 4) and reference derivatives dN (q, 4, 2)."""
    g = np.array([[a, b] for b in GAUSS2 for a in GAUSS2])
    f = 1 + QUAD_CORNERS[None] * g[:, None]
    dN = np.stack([QUAD_CORNERS[:, 0] * f[..., 1], f[..., 0] * QUAD_CORNERS[:, 1]], -1) / 4
    return f.prod(2) / 4, dN


def quad_areas(points: Array, quads: Array) -> tuple[Array, Array]:
    """Areas at the 2x2 points (f, q) [mm^2] (each point's weight is 1) and unit normals (f, q, 3) of curved quads."""
    _, dN = quad_points()
    tangents = np.einsum("qak,fai->fqki", dN, points[quads])
    normal = np.cross(tangents[:, :, 0], tangents[:, :, 1])
    area = np.linalg.norm(normal, axis=2)
    return area, normal / area[..., None]
