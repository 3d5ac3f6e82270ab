"""Triangle meshes for tests, how they are saved, and what of them the package makes."""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from tacgen.geometry import mesh_import
from tacgen.geometry.mesh_file import SolidMesh


def solid_of(mesh: Any, bodies: int = 1) -> SolidMesh:
    """A mesh of so many bodies, of as many triangles each."""
    body = np.repeat(np.arange(bodies), len(mesh.faces) // bodies)
    return SolidMesh("test", np.asarray(mesh.vertices), np.asarray(mesh.faces), body)


def field_of(mesh: Any, cell: float, bodies: int = 1, **how: float) -> Any:
    """The signed distance of a mesh as an indenter, with sharp edges of .02 mm, up to 1.5 mm over its lowest point."""
    known = {"height": 1.5, "half": 30.0, "radius": 0.02, **how}
    return mesh_import.field(mesh_import.placed(solid_of(mesh, bodies)), cell=cell, **known)


def differences(shape: Any, p: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Central differences (n, 3) of a shape's distance at points p (n, 3), and those (n, 3, 3) of its gradient."""
    ends = [(shape.gradient(p + step), shape.gradient(p - step)) for step in h * np.eye(3)]
    return tuple(np.stack([(ahead[k] - behind[k]) / (2 * h) for ahead, behind in ends], 1) for k in range(2))


def saved(mesh: Any, path: Path) -> Path:
    mesh.export(path)
    return path


def ball(subdivisions: int = 5) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=subdivisions, radius=4.0)


def box(*size: float) -> trimesh.Trimesh:
    return trimesh.creation.box(size)


def truncated_cone(facets: int = 180, low: float = 5.0, high: float = 3.0, height: float = 4.0) -> trimesh.Trimesh:
    """Both ends are fans of slivers from one corner, in single precision as in an STL, so that no fan is plane."""
    angle = 2 * np.pi * np.arange(facets) / facets
    ring = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    v = np.concatenate([ring * low, ring * high + [0, 0, height]])
    turned = trimesh.transform_points(v, trimesh.transformations.rotation_matrix(0.3, [1, 0.3, 0.2]))
    i, k = np.arange(facets), np.arange(1, facets - 1)
    j, n = (i + 1) % facets, facets
    sides = [np.column_stack([i, j, j + n]), np.column_stack([i, j + n, i + n])]
    ends = [np.column_stack([0 * k, k + 1, k]), np.column_stack([0 * k, k, k + 1]) + n]
    return trimesh.Trimesh(turned.astype(np.float32), np.concatenate([*sides, *ends]), process=False)


def cells(*corners: tuple[int, int, int], walls: bool = False) -> trimesh.Trimesh:
    """Unit cubes with their lowest corners here; faces between two of them are there twice if `walls`, else not."""
    points: list[np.ndarray] = []
    for corner in corners:
        for axis, side in np.ndindex(3, 2):
            across = np.eye(3, dtype=int)[axis] * (2 * side - 1)
            if not walls and tuple(corner + across) in corners:
                continue
            u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
            low = corner + np.eye(3)[axis] * side
            one, two = (low, low + u, low + u + v), (low, low + u + v, low + v)
            points += [*one, *two] if side else [*one[::-1], *two[::-1]]
    return trimesh.Trimesh(points, np.arange(len(points)).reshape(-1, 3), process=False)
