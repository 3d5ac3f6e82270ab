"""Triangle meshes for tests, and how they are saved."""

from pathlib import Path
from typing import Any

import trimesh


def saved(mesh: Any, path: Path) -> Path:
    mesh.export(path)
    return path


def ball(subdivisions: int = 5) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=subdivisions, radius=4.0)


def box(*size: float) -> trimesh.Trimesh:
    return trimesh.creation.box(size)
