"""Batches of scenes: which scenes go together, and their meshes, tables and factors as one batch."""

from collections.abc import Sequence

import numpy as np
import torch

from tacgen.fem.assembly import Pattern
from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import elements
from tacgen.mechanics import mesh
from tacgen.mechanics.problem import Problem, by_distance
from tacgen.mechanics.scene import Scene
from tacgen.tensor_engine.batch import Batch, Factors, Place
from tacgen.tensor_engine.condensed import Condensed
from tacgen.tensor_engine.dissection import dissected
from tacgen.tensor_engine.elements import Topology
from tacgen.tensor_engine.grids import Embedded, GridPattern, embedded
from tacgen.tensor_engine.multifrontal import Multifrontal

NONE = Pattern(*(np.zeros(0, np.int32),) * 3, 0, *(np.zeros(0, np.int32),) * 2)  # of no sparse matrix


def gathered(
    scenes: Sequence[Scene], grids: Sequence[Embedded], device: str = "cpu", dtype: torch.dtype = torch.float32
) -> Batch:
    """A batch of scenes whose meshes are embedded in one pattern, before their first load step; dtype: of the factors.

    Raises ValueError: their patterns or the points in their facets differ.
    """
    pattern = grids[0].pattern
    problems = [unassembled(scene, mesh.of(scene)) for scene in scenes]
    points = {problem.contact.faces.areas.shape[1] for problem in problems}
    if len(points) > 1 or any(grid.pattern != pattern for grid in grids):
        raise ValueError("scenes of one batch have one pattern, and facets with equally many points")
    nz = pattern.cells[2]
    places = [Place(grid.nodes, grid.cells, grid.cells[nz - 1 :: nz] // nz) for grid in grids]
    facets = pattern.hexes[nz - 1 :: nz, 4:]
    topology = Topology.of(pattern.hexes, facets, pattern.size, device)
    X = np.array([grid.points for grid in grids])
    return Batch.of(problems, places, topology, X, factors(pattern, len(scenes), device, dtype), pattern.patch, device)


def unassembled(scene: Scene, grid: mesh.GelMesh) -> Problem:
    """The problem of a scene on its mesh without the tables of the CPU's sparse stiffness, which take most of the time
    to make."""
    elastic = tuple(
        Elastic(elements(grid.points, grid.cells[grid.layer == number]), layer.law)
        for number, layer in enumerate(scene.gel.layers)
    )
    contact = by_distance(scene, grid, None)
    return Problem(grid, elastic, (), contact, NONE, scene.friction, scene.edge)


def factors(pattern: GridPattern, capacity: int, device: str, dtype: torch.dtype) -> Factors:
    """Factors of so many scenes of a pattern."""
    return Condensed(Multifrontal(dissected(pattern), device, dtype), capacity)


def grouped(scenes: Sequence[Scene]) -> tuple[dict[GridPattern, list[int]], dict[int, Embedded]]:
    """Numbers of the scenes of each pattern, and the embedded mesh of each; scenes that fit no pattern are in none."""
    groups: dict[GridPattern, list[int]] = {}
    grids = {}
    for k, scene in enumerate(scenes):
        if (grid := embedded(scene)) is not None:
            groups.setdefault(grid.pattern, []).append(k)
            grids[k] = grid
    return groups, grids
