"""What the tests of physics share: small gels, paths without a recipe, and their solution."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tacgen import mechanics
from tacgen.fem.materials import NeoHooke
from tacgen.geometry.analytic_sdf import Shape
from tacgen.geometry.gel import GelBody, GelLayer
from tacgen.geometry.sdf_grid import Field
from tacgen.mechanics import mesh
from tacgen.mechanics.scene import Scene
from tacgen.outputs import gel_surface

Array = np.ndarray
Footprint = tuple[float, float, float, float]


def gel(
    width: float = 12.0, height: float = 12.0, thickness: float = 3.0, E: float = 0.15, nu: float = 0.48
) -> GelBody:
    """A pad of one layer, sharp corners; E [MPa]."""
    law = NeoHooke(E / (2 * (1 + nu)), E / (3 * (1 - 2 * nu)))
    return GelBody(width, height, layers=(GelLayer(thickness, law, E),))


def poses(positions: list[tuple[float, float, float]], yaw: float = 0.0) -> Array:
    """Upright indenters with their lowest point at these positions [mm], turned by `yaw` [rad] about z."""
    out = np.tile(np.eye(4), (len(positions), 1, 1))
    out[:, :2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    out[:, :3, 3] = positions
    return out


@dataclass(frozen=True)
class Run:
    """A scene, its mesh made ready, and the states at its frames."""

    scene: Scene
    problem: mechanics.Problem
    states: list[mechanics.State]

    @cached_property
    def face(self) -> gel_surface.GelSurface:
        """The coated face at rest."""
        return gel_surface.GelSurface(self.problem.mesh.points, self.problem.mesh.facets["coated"])

    @cached_property
    def forces(self) -> Array:
        """On the gel at every frame (N, 3) [N]."""
        return np.array([gel_surface.wrench(self.problem, state)[0] for state in self.states])


def scene(shape: Shape, path: Array, *, pad: GelBody | None = None, friction: float = 0.0, edge: float = 0.6) -> Scene:
    """Draft-like unless said otherwise: edge .6 mm, dhat .05 mm."""
    start = path[0].copy()
    start[2, 3] = 0.0
    return Scene(pad or gel(), shape, path, start, np.zeros(len(path), int), friction, edge, 0.05)


def problem_of(made: Scene, half: float = 2.0, *options: mechanics.SolverOptions) -> mechanics.Problem:
    """On a mesh of hexes that is fine within `half` [mm] of the middle, to each side."""
    return mechanics.Problem.of(made, mesh.build(made.gel, (-half, half, -half, half), made.edge), *options)


def force(state: mechanics.State) -> Array:
    """The indenter's (3,) on the gel [N]."""
    return np.asarray(state.traction_force.sum((0, 1)))


def run(made: Scene, footprint: Footprint | None = None, grid: mesh.GelMesh | None = None) -> Run:
    """Solve all frames, on a mesh of hexes that is fine over `footprint` or on the one given."""
    grid = grid or mesh.build(made.gel, footprint or mesh.footprint(made), made.edge)
    problem = mechanics.Problem.of(made, grid)
    return Run(made, problem, list(mechanics.states(made, problem)))


def thin_plate(side: float = 2.0, thickness: float = 0.1, cell: float = 0.0234) -> Field:
    """A plate whose lowest point is at the origin, by its distance on a grid that its thickness spans four times."""
    half = np.array([side, side, thickness]) / 2
    low, high = -half - [4 * cell, 4 * cell, 3 * cell + half[2]], half + 4 * cell
    lines = [a + cell * np.arange(n) for a, n in zip(low, np.ceil((high - low) / cell).astype(int), strict=True)]
    grid = np.stack(np.meshgrid(*lines, indexing="ij"), -1)
    q = np.abs(grid) - half
    d = np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (0, 2)]) * half
    return Field.through(d, low + half * (0, 0, 1), cell, smallest_radius=2 * cell, corners=corners, blunt=True)
