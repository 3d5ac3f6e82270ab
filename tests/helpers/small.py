"""What the tests of fem/ share: finite differences, dense stiffness, distorted blocks, a patch of facets, a load."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tacgen.fem.assembly import Pattern, pattern
from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import HEX_CORNERS, boxes, elements, quadratic
from tacgen.fem.materials import NeoHooke
from tacgen.fem.projection import Projection
from tacgen.mechanics.barrier import Faces

Array = np.ndarray


def whole(conn: Array, nodes: int) -> Pattern:
    """The pattern of one table of elements with every dof free."""
    return pattern([conn], np.ones((nodes, 3), bool))


def full(pat: Pattern, data: Array) -> Array:
    """The dense symmetric matrix of a pattern's upper triangle."""
    out = np.zeros((pat.size, pat.size))
    rows = np.repeat(np.arange(pat.size), np.diff(pat.indptr))
    out[rows, pat.indices] = data
    return np.asarray(out + np.triu(out, 1).T)


def dense(potential: Any, x: Array, pat: Pattern, projection: Projection = Projection.NONE) -> Array:
    """A potential's stiffness (free, free)."""
    data = np.zeros(len(pat.indices))
    potential.add_hessian(x, data, projection)
    return full(pat, data)


def slope(f: Callable[[Array], Array | float], x: Array, h: float) -> Array:
    """Central differences of f over every entry of x: (x.size, *f.shape)."""
    rows = []
    for k in range(x.size):
        step = np.zeros(x.size)
        step[k] = h
        d = step.reshape(x.shape)
        rows.append((np.asarray(f(x + d)) - np.asarray(f(x - d))) / (2 * h))
    return np.array(rows)


def turn(seed: int) -> Array:
    """A random rotation (3, 3)."""
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return np.asarray(q * np.linalg.det(q))


def hexes(x: Array, y: Array, z: Array) -> tuple[Array, Array]:
    """Points and hexes of a grid of these coordinates."""
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), -1)
    number = np.arange(points[..., 0].size).reshape(points.shape[:3])
    return points.reshape(-1, 3), boxes(number).reshape(-1, 8)


def block(n: int, shake: float = 0.0, seed: int = 0) -> tuple[Array, Array]:
    """Points and hexes of a unit cube, n a side; inner nodes are moved by up to shake/n each way."""
    points, cells = hexes(*[np.linspace(0, 1, n + 1)] * 3)
    inner = np.all((points > 1e-9) & (points < 1 - 1e-9), axis=1)
    move = np.random.default_rng(seed).uniform(-1, 1, points.shape) * shake / n
    return points + inner[:, None] * move, cells


def tetrahedral(points: Array, hexes: Array, nodes: int = 10) -> tuple[Array, Array]:
    """Each hex of a block in six tets around its diagonal (Kuhn), of 4 or 10 nodes."""
    ways = [(0, a, b, 6) for a, b in ((1, 2), (1, 5), (4, 5), (4, 7), (3, 7), (3, 2))]
    cells = np.concatenate([hexes[:, way] for way in ways])
    side = points[cells[:, 1:]] - points[cells[:, :1]]
    turned = np.linalg.det(side) < 0
    cells[turned] = cells[turned][:, [0, 2, 1, 3]]
    points, cells = quadratic(points, cells) if nodes == 10 else (points, cells)
    return points, cells


def standing(points: Array) -> Array:
    """Which dofs (n, 3) of a body that stands on z = 0 are free."""
    return np.broadcast_to(points[:, 2:] != 0, points.shape).copy()


def stiff(points: Array, cells: Array, free: Array) -> tuple[Pattern, Array]:
    """The pattern of a body, and its stiffness at rest."""
    pat = pattern([cells], free)
    data = np.zeros(len(pat.indices))
    Elastic.on(pat, elements(points, cells), NeoHooke(0.05, 1.0)).add_hessian(points, data, Projection.NONE)
    return pat, data


def distorted(amount: float = 0.15, seed: int = 1) -> tuple[Array, Array]:
    """One hex of about a unit cube with every corner moved."""
    points = (HEX_CORNERS + 1) / 2
    return points + np.random.default_rng(seed).uniform(-amount, amount, points.shape), np.arange(8)[None]


def patch(n: int, size: float, nodes: int = 4) -> tuple[Array, Faces, Pattern]:
    """A flat square of n x n quads, or twice as many triangles, about the origin of z = 0, facing +z."""
    ticks = np.linspace(-size / 2, size / 2, n + 1)
    points = np.stack([*np.meshgrid(ticks, ticks, indexing="ij"), np.zeros((n + 1, n + 1))], -1).reshape(-1, 3)
    number = np.arange(len(points)).reshape(n + 1, n + 1)
    quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], -1).reshape(-1, 4)
    facets = quads if nodes == 4 else np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    if nodes == 6:
        points, facets = quadratic(points, facets)
    pat = whole(facets, len(points))
    return points, Faces.on(pat, points, facets), pat


@dataclass(frozen=True)
class Total:
    """The sum of several energies."""

    parts: tuple[Any, ...]

    def value(self, x: Array) -> float:
        return float(sum(part.value(x) for part in self.parts))

    def gradient(self, x: Array) -> Array:
        return np.asarray(sum(part.gradient(x) for part in self.parts))

    def add_hessian(self, x: Array, data: Array, projection: Projection) -> None:
        for part in self.parts:
            part.add_hessian(x, data, projection)


@dataclass(frozen=True)
class Load:
    """Dead loads (n, 3) [N]."""

    force: Array

    def value(self, x: Array) -> float:
        return -float((self.force * x).sum())

    def gradient(self, x: Array) -> Array:
        return -self.force

    def add_hessian(self, x: Array, data: Array, projection: Projection) -> None:
        pass
