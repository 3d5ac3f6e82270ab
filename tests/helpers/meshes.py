"""Triangle meshes for tests, and how they are saved."""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh


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
