"""The layout of a bundle: the outputs' datasets, and a table of attributes. scripts/bundle_page.py makes docs/BUNDLE.md
from them, and check.py compares finished files with them."""

from typing import Any

import numpy as np
from pydantic import ConfigDict, Field

from tacgen.bundle.stored_json import Stored, Value
from tacgen.outputs import LAYOUT
from tacgen.outputs.base import Entry

BUNDLE_FORMAT = 1
UNIT_SYSTEM = "mm N MPa s rad"

BUNDLE_ATTRS: dict[str, tuple[type, str]] = {
    "tacgen_format": (int, f"format of this file, {BUNDLE_FORMAT}"),
    "tacgen_version": (str, "version of tacgen that wrote it"),
    "recipe": (str, "resolved recipe, JSON"),
    "scene_index": (int, "row of the plan"),
    "seed": (int, "seed of this scene's random numbers"),
    "sensor": (str, "name of the sensor"),
    "sensor_sha256": (str, "of the resolved sensor"),
    "units": (str, f"unit system, `{UNIT_SYSTEM}`"),
    "solver": (str, "linear solver, or batch engine and device, and versions"),
    "input_key": (str, "sha256 of all resolved inputs: equal keys, equal bundles"),
    "frames_planned": (int, "frames the trajectory asks for; `status` tells whether all are here"),
    "status": (
        str,
        "`ok`, or `rejected`: the solver gave up and only the frames before that are here, or none touches the gel",
    ),
    "reason": (str, "why it was rejected, or ended before a fold; empty if all frames are here"),
    "digest": (str, "sha256 over every dataset's path, type, shape, bytes and attributes, and these attributes"),
    "complete": (bool, "true, written last"),
}
OPTIONAL_ATTRS: dict[str, tuple[type, str]] = {
    "sensor_document": (str, "resolved sensor, JSON"),
    "mesh": (str, "quality of the mesh and its sha256, JSON: two tetrahedral meshes are never alike"),
    "contact": (str, "formulation of contact; no longer written, since there is one"),
    "renderer": (str, "what rendered images: `transport` (and on which GPU), `table`, or Mitsuba, version and variant"),
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
    bonded_share: float | None = None


# Attributes that are JSON, and the types that readers rely on.
JSON_ATTRS: dict[str, Any] = {
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
        raise ValueError(f"format {BUNDLE_FORMAT} has no dataset {path}")
    return row


def attributes(path: str) -> dict[str, str]:
    """The attributes of a dataset; `rounding` if its values are rounded."""
    row = entry(path)
    known = {"units": row.units, "long_name": row.long_name, "axes": row.axes}
    return known | ({"rounding": row.rounding} if row.rounding else {})


def as_stored(path: str, values: np.ndarray) -> np.ndarray:
    """Values in the type in which they are stored. Raises TypeError: of a kind that cannot be cast to it."""
    return np.asarray(values).astype(entry(path).dtype, order="C", casting="same_kind", copy=False)


def finite_problem(path: str, values: np.ndarray) -> str | None:
    """Where values as they are stored are inf, or nan that the layout does not allow; or None."""
    row = entry(path)
    if row.dtype[1] != "f":
        return None
    fine = ~np.isinf(values) if row.nan else np.isfinite(values)
    return None if fine.all() else f"{path} is not finite at {tuple(np.argwhere(~fine)[0].tolist())}"


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
