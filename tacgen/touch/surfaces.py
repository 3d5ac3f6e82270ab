"""The surface of a rigid body as an indenter: a recipe's own shape where one is exact, else one mesh file of its parts.

Mesh files have lengths in mm and the body's frame; they are named by their content and stay in the cache's folder.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from tacgen.base import array_cache, output_file
from tacgen.base.errors import UserError
from tacgen.geometry import mesh_file, mesh_import
from tacgen.recipe import assets
from tacgen.recipe.indenters import Indenter
from tacgen.sensor import yaml_source
from tacgen.touch.episode import BodySurface

if TYPE_CHECKING:
    import trimesh

Array = np.ndarray
SIDES = 96  # of a round part in a mesh: 0.05 % of the radius inside the circle
BALL_SUBDIVISIONS = 4  # of an icosahedron: a ball of 5120 triangles
MAX_FILLET_PART = 0.1  # of a rod's radius and length that its edges are rounded by [-]
LARGEST_FILLET_MM = 0.2  # rounding of the edges of a rod [mm]
MIN_SIZE_MM, MAX_SIZE_MM = 1.5, 3000.0  # longest side of what a gripper touches [mm]
# from a rod's frame, whose axis is x, to one whose axis is z
ALONG_Z = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


@dataclass(frozen=True)
class RigidPart:
    """A part of a body. kind: sphere, capsule, cylinder, ellipsoid, box or mesh; size (3,) [mm]: radii or half lengths,
    as MuJoCo has them; pose (4, 4) [mm] in the body's frame; vertices (n, 3) [mm] and triangles (m, 3) of a mesh."""

    kind: str
    size: Array
    pose: Array
    vertices: Array | None = None
    triangles: Array | None = None


def of_solids(name: str, solids: Sequence[RigidPart]) -> BodySurface:
    """The surface of a body of one or several parts. Raises UserError: of none, or too small or large for mm."""
    if not solids:
        raise UserError(f"object {name}: has no geometry: give --object {name}=MESH")
    if len(solids) == 1 and (found := _analytic(solids[0])) is not None:
        return found
    return of_mesh_file(name, _kept(name, [_mesh(solid) for solid in solids]))


def of_text(name: str, text: str) -> BodySurface:
    """The surface that an option gives: a mesh file, a shipped object or a shape `{shape: sphere, radius_mm: 10}`,
    whose centre is the body's origin. Raises UserError: it is none of these."""
    if not text.lstrip().startswith("{"):
        return of_mesh_file(name, assets.mesh_path(text).resolve())
    data = yaml_source.parse(text, yaml_source.Source(f"--object {name}")).data
    try:
        indenter: Any = TypeAdapter(Indenter).validate_python(data)
    except ValidationError as error:
        told = error.errors()[0]
        raise UserError(f"--object {name}: {'.'.join(map(str, told['loc']))}: {told['msg']}") from None
    if indenter.shape == "mesh":
        file = assets.mesh_path(indenter.file).resolve()
        return of_mesh_file(name, file, {**data, "file": str(file)})
    pose = np.eye(4)
    half = getattr(indenter, "length_mm", None) or 0.0
    lower = {"sphere": "radius_mm", "capsule": "radius_mm", "torus": "tube_radius_mm"}.get(indenter.shape)
    pose[2, 3] = -(getattr(indenter, lower) if lower else half / 2 if indenter.shape == "cylinder" else 0.0)
    return BodySurface(data, pose)


def of_mesh_file(name: str, file: Path, given: Mapping[str, Any] | None = None) -> BodySurface:
    """The surface of a mesh file, whose frame, scaled to mm, is the body's. Raises UserError: it is no closed mesh, or
    its lengths can hardly be mm."""
    indenter = {"shape": "mesh", "file": str(file), **(given or {})}
    solid = mesh_file.read(file)
    how: dict[str, Any] = {"up": "+z", "scale": 1.0, "size": None}
    how |= {key: indenter[key] for key in ("up", "scale") if key in indenter} | {"size": indenter.get("size_mm")}
    size = float(np.ptp(mesh_import.placed(solid, **how).vertices, axis=0).max())
    if not MIN_SIZE_MM <= size <= MAX_SIZE_MM:
        other = "metres: give {shape: mesh, file: ..., scale: 1000}" if size < MIN_SIZE_MM else "not mm: give a scale"
        raise UserError(f"object {name}: {file.name} is {size:.3g} mm long: its lengths are probably {other}")
    return BodySurface(indenter, mesh_import.placement(solid, **how))


def _analytic(solid: RigidPart) -> BodySurface | None:
    """A ball, a rod with round ends or a round rod; a recipe's box has no upper end."""
    if solid.kind not in ("sphere", "capsule", "cylinder"):
        return None
    radius, half, pose, down = float(solid.size[0]), float(solid.size[1]), solid.pose, np.eye(4)
    shape: dict[str, Any] = {"shape": solid.kind, "radius_mm": radius}
    down[2, 3] = -half if solid.kind == "cylinder" else -radius
    if solid.kind == "capsule":
        pose = pose @ ALONG_Z
    if solid.kind == "cylinder":
        shape["fillet_mm"] = min(LARGEST_FILLET_MM, MAX_FILLET_PART * min(radius, half))
    return BodySurface(shape if solid.kind == "sphere" else shape | {"length_mm": 2 * half}, pose @ down)


def _mesh(solid: RigidPart) -> "trimesh.Trimesh":
    """A closed mesh [mm] in the body's frame; where it is open its convex hull, with which rigid engines collide."""
    import trimesh

    radius, half = float(solid.size[0]), float(solid.size[1])
    if solid.vertices is not None:
        mesh = trimesh.Trimesh(solid.vertices, solid.triangles, process=False)
        mesh.merge_vertices()
        mesh = mesh if mesh.is_watertight else mesh.convex_hull
    elif solid.kind == "box":
        mesh = trimesh.creation.box(2 * solid.size)
    elif solid.kind == "cylinder":
        mesh = trimesh.creation.cylinder(radius, 2 * half, sections=SIDES)
    elif solid.kind == "capsule":
        mesh = trimesh.creation.capsule(2 * half, radius, count=[SIDES, SIDES])
        mesh.apply_translation([0, 0, -mesh.bounds.mean(0)[2]])
    else:
        mesh = trimesh.creation.icosphere(BALL_SUBDIVISIONS)
        mesh.apply_scale(np.full(3, radius) if solid.kind == "sphere" else solid.size)
    return mesh.apply_transform(solid.pose)


def _kept(name: str, parts: "Sequence[trimesh.Trimesh]") -> Path:
    """The file of a mesh of all parts, written where it is not there yet."""
    import trimesh

    whole: Any = trimesh.util.concatenate(list(parts))
    content = whole.export(file_type="stl")
    safe = "".join(letter if letter.isalnum() else "_" for letter in name)
    file = array_cache.cache_folder() / "surfaces" / f"{safe}-{hashlib.sha256(content).hexdigest()[:16]}.stl"
    if not output_file.holds(file, content):
        output_file.put(file, content)
    return file.resolve()
