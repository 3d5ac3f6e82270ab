"""Tetrahedral meshes of gels by fTetWild (Hu et al. 2020), fine under the contact.

The same input gives the same mesh (see ftetwild). Meshes are cached by a hash of the input, and each bundle stores the
hash of its mesh.
"""

from importlib.metadata import version

import numpy as np

from tacgen.base import array_cache
from tacgen.base.errors import UserError
from tacgen.fem.elements import TET_EDGES, boxes, quadratic
from tacgen.fem.mesh_quality import nodal_volume
from tacgen.geometry import mesh_import
from tacgen.geometry.gel import GelBody
from tacgen.mechanics import ftetwild

Array = np.ndarray
TET_CACHE_VERSION = 2  # of the meshes in the cache
EDGE_GROWTH = 0.4  # growth of the edge per distance from the touched region [-]
MAX_TET_EDGE_RATIO = 7.4  # edge far from the contact over the edge under it [-]
# largest distance of fTetWild's mesh from the surface, over the box's diagonal [-]; projected later
ENVELOPE_RATIO = 1e-3
# step and sag of the gel's surface, over the longer side [-]
MESHED_SURFACE_RATIOS = (0.04, 4e-3)  # for the surface that is meshed
PROJECTED_SURFACE_RATIOS = (0.012, 4e-6)  # for the surface onto which nodes are projected
MAX_AMIPS_ENERGY = 10.0  # AMIPS energy of the worst tet at which fTetWild stops [-]
# at a tet's nodes and of its corners, over that before projection [-]; below, nodes go back
MIN_NODAL_VOLUME_RATIO = 0.1
TET_FACES = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])  # seen from outside


def build(gel: GelBody, touched: Array, edge: float, nodes: int) -> tuple[Array, Array, Array, dict[str, Array]]:
    """Points, tets of 4 or 10 nodes, their layers, and the named facets of a gel.

    Args:
        touched: points (n, 3) [mm] of the untouched face that the indenter can reach; edges there are about `edge`.
    """
    vertices, triangles, between = gel.surface(*MESHED_SURFACE_RATIOS)
    low, high = vertices.min(0), vertices.max(0)
    reach = ENVELOPE_RATIO * float(np.linalg.norm(high - low))
    coarsest = MAX_TET_EDGE_RATIO * edge
    background = _background(low, high, touched, edge, coarsest)
    asked = (
        vertices,
        triangles,
        np.concatenate([triangles[:0], *between]),
        *background,
        coarsest,
        ENVELOPE_RATIO,
        MAX_AMIPS_ENERGY,
    )
    key = array_cache.digest((TET_CACHE_VERSION, version("pytetwild"), *asked))
    points, tets = array_cache.kept("meshes", key, lambda: _tetrahedralise(*asked))
    if not len(tets):
        raise UserError("gel: no mesh of tetrahedra could be made inside its surface")
    layer = gel.layer_of(points[tets].mean(1))
    facets, between_layers = _facets(gel, points, tets, layer, 3 * reach)
    if nodes == 10:
        points, tets, *lists = quadratic(points, tets, *facets.values(), *between_layers)
        facets, between_layers = dict(zip(facets, lists, strict=False)), lists[len(facets) :]
    points = _on_true_surface(gel, points, tets, facets, between_layers)
    return points, tets, layer, {name: facets[name] for name in ("bonded", "coated")}


def _background(low: Array, high: Array, touched: Array, edge: float, coarsest: float) -> tuple[Array, Array, Array]:
    """fTetWild's background mesh: a grid of tets around the gel with the wanted edge at each of its points."""
    from scipy.spatial import cKDTree

    step = max(edge, float((high - low).max()) / 60)
    ticks = [np.linspace(a - step, b + step, int(np.ceil((b - a) / step)) + 3) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*ticks, indexing="ij"), -1).reshape(-1, 3)
    hexes = boxes(np.arange(len(points)).reshape([len(t) for t in ticks])).reshape(-1, 8)
    ways = [(0, 1, 2, 6), (0, 5, 1, 6), (0, 4, 5, 6), (0, 7, 4, 6), (0, 3, 7, 6), (0, 2, 3, 6)]
    tets = np.concatenate([hexes[:, way] for way in ways]).astype(np.int32)
    away = cKDTree(touched).query(points)[0]
    return points, tets, np.minimum(edge + EDGE_GROWTH * away, coarsest)


def _tetrahedralise(
    vertices: Array,
    triangles: Array,
    between: Array,
    sizing_points: Array,
    tets: Array,
    edges: Array,
    coarsest: float,
    envelope: float,
    energy: float,
) -> tuple[Array, Array]:
    """fTetWild on one thread: vertices (n, 3) and tets (e, 4) inside the closed triangles, no tet across `between`."""
    try:
        points, cells = ftetwild.tetrahedralised(
            vertices, np.concatenate([triangles, between]).astype(np.uint32), True, False, 0.05, coarsest, envelope,
            energy, False, 1, 80, 6, True, False, True, sizing_points, tets, edges,
        )  # fmt: skip
    except ftetwild.Unseeded as unseeded:
        text = "cannot be given a seed as 0.4.2 can: its meshes would differ from run to run; install that version"
        raise UserError(f"pytetwild {unseeded}: {text}") from None
    # fTetWild's own inside test would count the open triangles `between` too
    cells = cells[mesh_import.inside(vertices, triangles, points[cells].mean(1))]
    used, compact = np.unique(cells, return_inverse=True)
    points, cells = points[used], compact.reshape(-1, 4)
    turned = np.linalg.det(points[cells[:, 1:]] - points[cells[:, :1]]) < 0
    cells[turned] = cells[turned][:, [0, 2, 1, 3]]
    return points, cells


def _facets(
    gel: GelBody, points: Array, tets: Array, layer: Array, reach: float
) -> tuple[dict[str, Array], list[Array]]:
    """The boundary's triangles by name, where "sides" is the rest; and the triangles between neighbouring layers."""
    faces = tets[:, TET_FACES].reshape(-1, 3)
    owner = np.repeat(np.arange(len(tets)), 4)
    order = np.sort(faces, 1)
    keys = (order[:, 0] * len(points) + order[:, 1]) * len(points) + order[:, 2]
    _, first, count = np.unique(keys, return_index=True, return_counts=True)
    outer = faces[first[count == 1]]
    patches = {name: outer[mask] for name, mask in _patches(gel, points, outer, reach).items()}
    rank = np.argsort(keys, kind="stable")
    pairs = np.flatnonzero(keys[rank][1:] == keys[rank][:-1])
    one, two = rank[pairs], rank[pairs + 1]
    low = np.minimum(layer[owner[one]], layer[owner[two]])
    apart = layer[owner[one]] != layer[owner[two]]
    between = [faces[one[apart & (low == number)]] for number in range(len(gel.layers) - 1)]
    return patches, between


def _patches(gel: GelBody, points: Array, triangles: Array, reach: float) -> dict[str, Array]:
    """Which of a surface's triangles (f, 3) are bonded, coated or, the rest, sides (f,)."""
    x = points[triangles]
    normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    patches = gel.patches(x, normal, reach)
    return {**patches, "sides": ~np.any(list(patches.values()), axis=0)}


def _on_true_surface(gel: GelBody, points: Array, tets: Array, facets: dict[str, Array], between: list[Array]) -> Array:
    """Points with the nodes of boundary and interfaces projected onto the true surfaces, except where a tet inverts."""
    new = points.copy()
    vertices, triangles, _ = gel.surface(*PROJECTED_SURFACE_RATIOS)
    true = _patches(gel, vertices, triangles, 1e-6)
    for name in ("sides", "bonded"):
        there = np.unique(facets[name])
        if len(there) and true[name].any():
            new[there] = mesh_import.nearest(vertices, triangles[true[name]], new[there])
    parts = [*zip(between, gel.interfaces[:-1], strict=True), (facets["coated"], 1.0)]
    for which, part in parts:
        there = np.unique(which)
        new[there] = gel.at_height(float(part), new[there, :2])
    return _without_folds(new, points, tets)


def _without_folds(new: Array, old: Array, tets: Array) -> Array:
    """The new points; where they invert a tet, its edge nodes go back to the edges' midpoints and, if that is not
    enough, its corners to the old points."""
    straight = nodal_volume(old, tets[:, :4]).min(1)
    for corners_too in (False, True):
        for _ in range(10):
            curved, flat = nodal_volume(new, tets).min(1), nodal_volume(new, tets[:, :4]).min(1)
            bad = tets[np.minimum(curved, flat) <= MIN_NODAL_VOLUME_RATIO * straight]
            if not len(bad):
                return new
            if corners_too:
                corner = np.unique(bad[:, :4])
                new[corner] = old[corner]
            if tets.shape[1] == 10:
                near = tets[np.isin(tets[:, :4], bad[:, :4]).any(1)] if corners_too else bad
                new[near[:, 4:]] = new[near[:, TET_EDGES]].mean(2)
    return new
