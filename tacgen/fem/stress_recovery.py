"""Nodal stress from element stress by superconvergent patch recovery, separately for each material.

Zienkiewicz & Zhu (1992), "The superconvergent patch recovery", Part 1: around each vertex a linear polynomial is fitted
to the values at the centres of the elements that meet there (the superconvergent points of hexes) and evaluated at the
vertex. A vertex whose patch does not determine the polynomial, such as one on a face, uses that of the nearest vertices
whose patch does. A pressure that alternates from element to element, as Q1P0 may give, is orthogonal to all linear
polynomials on a patch of 2 x 2 x 2 hexes and does not reach the nodes.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tacgen.fem.elements import HEX_EDGES, TET_EDGES

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Array = np.ndarray
MIN_PATCH_SPREAD = 0.1  # spread of a patch's centres over half its extent, below which a direction is undetermined [-]
VERTEX_COUNTS = {8: 8, 4: 4, 10: 4}  # vertices of an element, by its number of nodes
VOIGT_INDEX = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])  # index of each tensor entry in xx yy zz yz xz xy


@dataclass(frozen=True)
class Recovery:
    """The recovery of a mesh as matrices. A node shared by several materials has one row for each.

    node (k,) its number; material (k,) ascending; matrix (k, e): element values (e, c) to values of the rows (k, c);
    mean (e, k): values of the rows to their means over the vertices of each element.
    """

    node: Array
    material: Array
    matrix: "csr_array"
    mean: "csr_array"

    @classmethod
    def on(cls, points: Array, cells: Array, material: Array) -> "Recovery":
        """On a mesh of points (n, 3) and cells (e, a), hexes or tetrahedra, each of one material (e,)."""
        from scipy.sparse import csr_array, vstack

        vertices = cells[:, : VERTEX_COUNTS[cells.shape[1]]]
        centres, (e, v) = points[vertices].mean(1), vertices.shape
        nodes: list[Array] = []
        materials, blocks, rows, count = [], [], np.zeros((e, v), int), 0
        for number in np.unique(material):
            here = np.flatnonzero(material == number)
            layer_nodes, local = np.unique(cells[here], return_inverse=True)
            local = local.reshape(len(here), -1)
            pick = csr_array((np.ones(len(here)), (np.arange(len(here)), here)), shape=(len(here), e))
            blocks.append(_weights(points[layer_nodes], local, centres[here]) @ pick)
            rows[here], count = count + local[:, :v], count + len(layer_nodes)
            nodes.append(layer_nodes)
            materials.append(np.full(len(layer_nodes), number))
        node = np.concatenate(nodes)
        mean = csr_array((np.full(e * v, 1 / v), (np.repeat(np.arange(e), v), rows.ravel())), shape=(e, len(node)))
        return cls(node, np.concatenate(materials), csr_array(vstack(blocks)), mean)

    def outermost(self, values: Array, nodes: int) -> Array:
        """Values (n, c) at the nodes; for a node of several materials, those of the outermost."""
        out = np.zeros((nodes, values.shape[1]))
        out[self.node] = values
        return out


def _weights(points: Array, cells: Array, centres: Array) -> "csr_array":
    """Weights (n, e) of the element values in the nodal values, for one material."""
    from scipy.sparse import csr_array

    n, corners = len(points), cells[:, : VERTEX_COUNTS[cells.shape[1]]]
    rows = np.repeat(np.arange(len(cells)), corners.shape[1])
    around = csr_array((np.ones(len(rows)), (corners.ravel(), rows)), shape=(n, len(cells)))
    middle, columns, ranks = _fits(points, corners, centres, around)
    node, used = _patches_used(cells, n, ranks)
    # one entry for each node, each patch that it uses, and each element of that patch
    share = 1 / np.bincount(node, minlength=n)[node]
    size = np.diff(around.indptr)[used]
    pair = np.repeat(np.arange(len(used)), size)
    entry = np.arange(len(pair)) - np.repeat(np.cumsum(size) - size, size) + around.indptr[used][pair]
    shift = np.concatenate([np.ones((len(used), 1)), points[node] - middle[used]], 1)
    value = share[pair] * (shift[pair] * columns[entry]).sum(1)
    return csr_array((value, (node[pair], around.indices[entry])), shape=(n, len(cells)))


def _fits(points: Array, corners: Array, centres: Array, around: "csr_array") -> tuple[Array, Array, Array]:
    """Least-squares fits of 1, x, y, z on all patches: centre (n, 3) of the patch of each vertex, columns (entries, 4)
    of the fits in the order of the patches, and how many of the four each determines (n,)."""
    sizes, n = np.diff(around.indptr), len(points)
    middle, columns, ranks = np.zeros((n, 3)), np.zeros((len(around.indices), 4)), np.zeros(n, int)
    low, high = points[corners].min(1), points[corners].max(1)
    for k in np.unique(sizes[sizes > 0]):
        which = np.flatnonzero(sizes == k)
        entry = around.indptr[which][:, None] + np.arange(k)
        patch = around.indices[entry]
        middle[which] = centres[patch].mean(1)
        half = (high[patch].max(1) - low[patch].min(1)) / 2
        x = (centres[patch] - middle[which][:, None]) / half[:, None]
        u, s, vt = np.linalg.svd(x, full_matrices=False)  # x is orthogonal to the constant
        clear = s > MIN_PATCH_SPREAD * np.sqrt(k)
        inverse = np.einsum("gik,gi,gji->gjk", vt, np.where(clear, 1 / np.where(clear, s, 1.0), 0.0), u)
        columns[entry] = np.concatenate([np.full((*entry.shape, 1), 1 / k), inverse / half[:, None]], -1)
        ranks[which] = 1 + clear.sum(1)
    return middle, columns, ranks


def _patches_used(cells: Array, n: int, ranks: Array) -> tuple[Array, Array]:
    """Pairs of a node and a vertex whose polynomial it uses, (pairs,) each."""
    from scipy.sparse import csr_array, eye_array

    edges = HEX_EDGES if cells.shape[1] == 8 else TET_EDGES
    ends = cells[:, edges].reshape(-1, 2)
    if cells.shape[1] == 10:  # nodes within edges follow those at its ends
        middle = np.repeat(cells[:, 4:].reshape(-1, 1), 2, 1)
        ends = np.concatenate([ends, np.stack([middle, ends], -1).reshape(-1, 2)])
    both = np.concatenate([ends, ends[:, ::-1]])
    beside = csr_array((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(n, n))
    known = ranks == ranks.max()
    used = csr_array(eye_array(n).tocsr()[known].T @ eye_array(n).tocsr()[known])
    while not known.all():
        follows = ~known & (beside @ known.astype(float) > 0)
        # a piece that hangs on by a corner: its own fits, as far as they go
        reached = follows if follows.any() else ~known & (ranks > 0)
        rows = csr_array((reached.astype(float), (np.arange(n), np.arange(n))), shape=(n, n))
        used = used + (rows @ beside @ used if follows.any() else rows)
        known = known | reached
    entries = used.tocoo()
    return entries.row, entries.col
