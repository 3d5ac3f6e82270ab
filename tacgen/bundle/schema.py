"""The layout of a bundle: tables of its datasets and attributes. scripts/bundle_page.py makes docs/BUNDLE.md from them,
and check.py compares finished files with them."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import ConfigDict, Field

from tacgen.bundle.stored_json import Stored, Value

FORMAT = 1
UNITS = "mm N MPa s rad"


@dataclass(frozen=True)
class Entry:
    """One dataset. A letter in `shape` is a size shared by every dataset that names it; "*" is any size, and 4|8 one
    of two."""

    dtype: str
    shape: str  # sizes of the axes, such as "N h w 2"; N: the number of frames
    units: str  # "1" is dimensionless
    long_name: str
    axes: str  # one word an axis
    nan: bool = False  # may hold nan: where a pixel shows no gel, or not the point in question
    below: str = ""  # the size of which all values are indices, from 0 on
    most: float = math.inf  # largest magnitude: what is computed from larger values, or nan, fails

    @property
    def dims(self) -> tuple[str | int, ...]:
        """The sizes of the axes."""
        return tuple(int(size) if size.isdigit() else size for size in self.shape.split())

    @property
    def per_frame(self) -> bool:
        """Whether the first axis is the frame."""
        return self.dims[0] == "N"


MAP = "frame row column"
FAR = 1e6  # [mm] limit of poses and nodes

LAYOUT: dict[str, Entry] = {
    "/frames/pose": Entry(
        "<f8", "N 4 4", "mm", "pose of the indenter in the sensor frame", "frame row column", most=FAR
    ),
    "/frames/segment": Entry("<i4", "N", "1", "index of the trajectory segment the frame belongs to", "frame"),
    "/frames/time": Entry("<f8", "N", "s", "time since the start of the path, where time counts", "frame"),
    "/frames/force": Entry("<f8", "N 3", "N", "force on the gel", "frame xyz"),
    "/frames/torque": Entry("<f8", "N 3", "N mm", "torque on the gel about the sensor origin", "frame xyz"),
    "/frames/sensitivity/modulus": Entry("<f8", "N 3", "N", "change of force by all moduli, over them", "frame xyz"),
    "/frames/sensitivity/poissons_ratio": Entry("<f8", "N 3", "N", "change of force by Poisson's ratio", "frame xyz"),
    "/frames/sensitivity/friction": Entry("<f8", "N 3", "N", "change of force by friction", "frame xyz"),
    "/frames/sensitivity/depth": Entry("<f8", "N 3", "N/mm", "change of force by depth", "frame xyz"),
    "/frames/uncertainty/force": Entry("<f8", "N 3", "N", "standard deviation of the force", "frame xyz"),
    "/frames/uncertainty/pressure": Entry("<f4", "N h w", "MPa", "standard deviation of the pressure", MAP),
    "/frames/uncertainty/traction": Entry("<f4", "N h w 2", "MPa", "standard deviation of the traction", MAP + " xy"),
    "/frames/rgb": Entry("|u1", "N H W 3", "1", "camera image, sRGB", "frame row column rgb"),
    "/frames/pressure": Entry("<f4", "N h w", "MPa", "pressure normal to the deformed coated face", MAP),
    "/frames/traction": Entry("<f4", "N h w 2", "MPa", "friction on the gel, in the tangent plane", MAP + " xy"),
    "/frames/force_map": Entry("<f4", "N h w 3", "N", "force on the gel behind each sample", MAP + " xyz"),
    "/frames/area": Entry("<f4", "N h w", "mm^2", "area of the deformed coated face behind each sample", MAP),
    "/frames/height": Entry("<f4", "N h w", "mm", "z of the deformed coated face, negative in a dent", MAP, nan=True),
    "/frames/normals": Entry(
        "<f4", "N h w 3", "1", "unit normal of the deformed face, outward", MAP + " xyz", nan=True
    ),
    "/frames/gap": Entry("<f4", "N h w", "mm", "distance of the deformed coated face from the indenter", MAP, nan=True),
    "/frames/contact": Entry("|b1", "N h w", "1", "in contact", MAP),
    "/frames/slip": Entry("|b1", "N h w", "1", "in contact, and half or more of the pressure slides", MAP),
    "/frames/sliding": Entry("<f4", "N h w", "1", "share of the pressure that slides, 0 to 1", MAP),
    "/frames/events/mode": Entry(
        "<i4",
        "N",
        "1",
        "0 apart, 1 touching, 2 sticking, 3 partly slipping, 4 sliding, 5 turning, 6 releasing",
        "frame",
    ),
    "/frames/events/stick_ratio": Entry("<f8", "N", "1", "share of the normal force that does not slide", "frame"),
    "/frames/events/friction_used": Entry(
        "<f8", "N", "1", "load along the face over what friction can bear; 1 where all of it slides", "frame"
    ),
    "/frames/events/center_of_pressure": Entry(
        "<f8", "N 3", "mm", "centre of pressure in the sensor frame", "frame xyz"
    ),
    "/frames/events/contact_area": Entry("<f8", "N", "mm^2", "area of the deformed face in contact", "frame"),
    "/frames/events/patches": Entry("<i4", "N", "1", "pieces that the contact consists of", "frame"),
    "/frames/markers": Entry("<f4", "N M 2", "px", "marker centres through the optics", "frame marker xy"),
    "/frames/marker_flow": Entry("<f4", "N M 2", "px", "markers less their reference", "frame marker xy"),
    "/frames/marker_visible": Entry("|b1", "N M", "1", "in the picture, no gel before it", "frame marker"),
    "/frames/flow": Entry(
        "<f4", "N h w 2", "px", "shift of the coating's point that was here untouched", MAP + " xy", nan=True
    ),
    "/frames/material": Entry(
        "<f4", "N h w 2", "mm", "where the coating's point behind the sample rests", MAP + " xy", nan=True
    ),
    "/frames/radiance": Entry("<f4", "N H W 3", "1", "linear light, before exposure", "frame row column rgb"),
    "/frames/quality/newton_iterations": Entry("<i4", "N", "1", "Newton iterations spent on the frame", "frame"),
    "/frames/quality/damped_steps": Entry(
        "<i4",
        "N",
        "1",
        "of these, steps that needed damping: the gel folds, wrinkles or slips suddenly, and from then on forces may"
        " depend on the step size",
        "frame",
    ),
    "/frames/quality/substeps": Entry("<i4", "N", "1", "steps the frame was split into", "frame"),
    "/frames/quality/min_gap_mm": Entry("<f8", "N", "mm", "smallest gap between gel and indenter", "frame"),
    "/frames/quality/mean_gap_mm": Entry("<f8", "N", "mm", "pressure-weighted mean gap", "frame"),
    "/frames/quality/overlap_mm": Entry(
        "<f8", "N", "mm", "how deep the face is in the indenter between contact points", "frame"
    ),
    "/frames/quality/rounded": Entry(
        "<f8",
        "N",
        "1",
        "share of friction at points that crossed a sharp edge in one step; above .05 forces depend on the step size",
        "frame",
    ),
    "/frames/quality/force_balance": Entry("<f8", "N", "1", "norm of force + base reaction, over force", "frame"),
    "/frames/quality/residual": Entry("<f8", "N", "1", "2-norm of the free nodes' forces, over force", "frame"),
    "/frames/quality/least_jacobian": Entry(
        "<f8", "N", "1", "certified lower bound of det F over all of the gel", "frame"
    ),
    "/frames/quality/force_error": Entry(
        "<f8", "N", "1", "sum of recovered sigma n da less force, over force", "frame"
    ),
    "/frames/quality/traction_error": Entry("<f8", "N", "1", "L2 norm of sigma n less traction, over that", "frame"),
    "/frames/quality/pressure_resultant": Entry(
        "<f8", "N", "1", "integral of -pressure n da less the normal contact forces, over force", "frame"
    ),
    "/frames/quality/traction_resultant": Entry(
        "<f8", "N", "1", "integral of traction da less friction, over force", "frame"
    ),
    "/frames/quality/force_map_resultant": Entry("<f8", "N", "1", "sum of force_map less force, over force", "frame"),
    "/frames/quality/unseen_force": Entry(
        "<f8",
        "N",
        "1",
        "share of the normal forces that pressure and traction do not show: on gel hidden by other gel, or outside the"
        " picture",
        "frame",
    ),
    "/frames/quality/pressure_oscillation": Entry("<f8", "N", "1", "rms of element less smooth pressure", "frame"),
    "/frames/grasp/object": Entry(
        "<f8", "N 4 4", "mm", "pose of the object in the world frame of a grasp", "frame row column", most=FAR
    ),
    "/frames/grasp/sensor": Entry(
        "<f8", "N 4 4", "mm", "pose of this finger's sensor frame in the world", "frame row column", most=FAR
    ),
    "/frames/grasp/width_mm": Entry("<f8", "N", "mm", "distance of the fingers' untouched faces", "frame"),
    "/frames/grasp/mode": Entry(
        "<i4", "N", "1", "the object: 0 stands on the table, 1 is held, 2 falls: friction does not bear it", "frame"
    ),
    "/frames/grasp/unborne": Entry(
        "<f8", "N", "N", "part of the weight that the fingers do not bear: the table does, or nothing", "frame"
    ),
    "/frames/grasp/balance": Entry(
        "<f8", "N", "1", "norm of what acts on the object in the directions in which it is free, over grip", "frame"
    ),
    "/reference/rgb": Entry("|u1", "H W 3", "1", "camera image of the untouched sensor", "row column rgb"),
    "/reference/markers": Entry("<f4", "M 2", "px", "marker centres on the untouched sensor", "marker xy"),
    "/reference/height": Entry("<f4", "h w", "mm", "z of the untouched coated face", "row column", nan=True),
    "/reference/normals": Entry("<f4", "h w 3", "1", "unit normal of the untouched face", "row column xyz", nan=True),
    "/mesh/points": Entry("<f8", "n 3", "mm", "nodes of the rest mesh", "node xyz", most=FAR),
    "/mesh/cells": Entry("<i4", "m 4|8|10", "1", "nodes of each cell", "cell corner", below="n"),
    "/mesh/layer": Entry("<i4", "m", "1", "gel layer of each cell, 0 at the base", "cell", below="m"),
    "/mesh/facets/*": Entry("<i4", "* 3|4|6", "1", "nodes of each facet of a named patch", "facet corner", below="n"),
    "/mesh/surface/points": Entry("<f8", "k 3", "mm", "nodes of the coated face at rest", "node xyz", most=FAR),
    "/mesh/surface/facets": Entry(
        "<i4", "* 3|4|6", "1", "nodes of each facet, numbered as in points", "facet corner", below="k"
    ),
    "/fields/displacement": Entry("<f4", "N n 3", "mm", "nodal displacement", "frame node xyz", most=FAR),
    "/fields/cauchy_stress": Entry("<f4", "N m 6", "MPa", "stress, xx yy zz yz xz xy", "frame cell component"),
    "/fields/nodal_stress": Entry("<f4", "N n 6", "MPa", "stress, xx yy zz yz xz xy", "frame node component"),
    "/fields/surface_displacement": Entry("<f4", "N k 3", "mm", "displacement of the coated face", "frame node xyz"),
    "/fields/surface_stress": Entry(
        "<f4", "N k 6", "MPa", "stress of the coated face, xx yy zz yz xz xy", "frame node component"
    ),
}

# Maps are rounded by a hundredth of their own error or less. Errors (rms of a ball pressed and slid at `default`,
# against `reference`, on the Mini and DIGIT): height 1.6e-3 mm, normals 4e-3, gap 1.1e-3
# mm, flow .02 px, material 1.1e-3 mm, sliding .1; median of pressure 2 %, traction and force 4 %, area .4 %.
STEPS = {  # multiples of 2 to this power, in the dataset's unit
    "/frames/height": -16,
    "/frames/normals": -14,
    "/frames/gap": -15,
    "/frames/sliding": -10,
    "/frames/flow": -11,
    "/frames/material": -15,
}
BITS = dict.fromkeys(  # significant bits
    ("/frames/pressure", "/frames/traction", "/frames/area"), 13
) | {"/frames/force_map": 17}  # whose sum is the force, to 1e-5

ATTRS: dict[str, tuple[type, str]] = {
    "tacgen_format": (int, f"format of this file, {FORMAT}"),
    "tacgen_version": (str, "version of tacgen that wrote it"),
    "recipe": (str, "resolved recipe, JSON"),
    "scene_index": (int, "row of the plan"),
    "seed": (int, "seed of this scene's random numbers"),
    "sensor": (str, "name of the sensor"),
    "sensor_sha256": (str, "of the resolved sensor"),
    "units": (str, f"unit system, `{UNITS}`"),
    "solver": (str, "linear solver and versions"),
    "input_key": (str, "sha256 of all resolved inputs: equal keys, equal bundles"),
    "frames_planned": (int, "frames the trajectory asks for; `status` tells whether all are here"),
    "status": (str, "`ok`, or `rejected`: the solver gave up and only the frames before that are here"),
    "reason": (str, "why it was rejected; empty if ok"),
    "digest": (str, "sha256 over every dataset's path, type, shape, bytes and attributes, and these attributes"),
    "complete": (bool, "true, written last"),
}
OPTIONAL: dict[str, tuple[type, str]] = {
    "sensor_document": (str, "resolved sensor, JSON"),
    "mesh": (str, "quality of the mesh and its sha256, JSON: two tetrahedral meshes are never alike"),
    "contact": (str, "formulation of contact: `distance`, or `ipctk` and its version"),
    "renderer": (str, "what images were rendered by: `transport`, `table`, or Mitsuba with its version and variant"),
    "pair": (int, "number of the contact, the same in each scene of a data set that has it on another sensor"),
    "values": (str, "the varied paths of a batch and their values, JSON"),
    "finger": (str, "of a grasp, whose bundle it is: `left` or `right`"),
    "notes": (str, "what a reader should know of this scene, JSON list of lines"),
}


class StoredContact(Stored):
    """The fields of a recipe's contact that readers use."""

    friction: float = 0.0


class StoredIndenter(Stored):
    """The fields of an indenter that readers use; the other ones, by any name, differ from shape to shape."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Value] = Field(init=False)
    shape: str = ""
    file: str = ""


class StoredRecipe(Stored):
    """The fields of a resolved recipe, of this or an earlier version, that readers use."""

    name: str = ""
    indenter: StoredIndenter = StoredIndenter()
    trajectory: list[dict[str, Value]] = Field(default_factory=list)
    contact: StoredContact = StoredContact()


class StoredMesh(Stored):
    """The fields of a mesh's quality that readers use."""

    nodes: int
    cells: int
    smallest_scaled_jacobian: float
    volume_error: float
    smallest_dihedral_deg: float | None = None


# Attributes that are JSON, and the types that readers rely on.
STORED: dict[str, Any] = {
    "recipe": StoredRecipe,
    "sensor_document": dict[str, Value],
    "mesh": StoredMesh,
    "values": dict[str, Value],
    "notes": list[str],
}


def entry(path: str) -> Entry:
    """The layout's row for a dataset path; ValueError if the format has no such dataset."""
    row = LAYOUT.get(path) or LAYOUT.get(path.rpartition("/")[0] + "/*")
    if row is None:
        raise ValueError(f"format {FORMAT} has no dataset {path}")
    return row


def attributes(path: str) -> dict[str, str]:
    """The attributes of a dataset; `rounding` is that of STEPS and BITS."""
    row = entry(path)
    known = {"units": row.units, "long_name": row.long_name, "axes": row.axes}
    if path in STEPS:
        return known | {"rounding": f"multiples of 2^{STEPS[path]}"}
    return known | ({"rounding": f"{BITS[path]} bits"} if path in BITS else {})


def finite_problem(path: str, values: np.ndarray) -> str | None:
    """Where values are inf, or nan that the layout does not allow, in the type in which they are stored; or None."""
    row = entry(path)
    if np.dtype(row.dtype).kind != "f":
        return None
    with np.errstate(over="ignore"):
        values = np.asarray(values).astype(row.dtype, copy=False)
    bad = np.isinf(values) if row.nan else ~np.isfinite(values)
    return f"{path} is not finite at {tuple(np.argwhere(bad)[0].tolist())}" if bad.any() else None


def shape_problem(path: str, shape: tuple[int, ...], sizes: dict[str, int]) -> str | None:
    """Why `shape` is not what the layout gives `path`, or None. Sizes met for the first time join `sizes`."""
    wanted = [str(sizes.get(dim, dim)) for dim in entry(path).shape.split()]
    if len(wanted) != len(shape) or not all(map(_fits, shape, wanted)):
        return f"{path} has shape {shape}, expected ({', '.join(wanted)})"
    sizes.update({w: n for n, w in zip(shape, wanted, strict=True) if w.isalpha()})
    return None


def _fits(n: int, wanted: str) -> bool:
    """Whether a size is one of those given as 4|8, or any: 0 of frames or facets alone."""
    return str(n) in wanted.split("|") if wanted[0].isdigit() else n > 0 or wanted in ("N", "*")
