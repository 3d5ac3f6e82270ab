"""Bundles that somebody crafts who knows the format: laid out as a bundle, with the digest of what they now hold."""

import json
from pathlib import Path
from random import Random
from typing import Any

import h5py
import numpy as np

from hostile import mutations
from hostile.mutations import datasets, files, reseal
from tacgen.bundle.schema import entry

NUMBERS = (float("nan"), float("inf"), -float("inf"), 1e300, -1e300, 1e38, 1e-320, 1e9, -1.0, 0.0)
COUNTS = (-(2**31), 2**31 - 1, -1, 1, 7, 10**6)
SHAPES: tuple[Any, ...] = (
    *(5, None, [], {}, "", "spheroid", "mesh", "sphere", "cylinder", "cone", "box", "wedge", "capsule", "torus"),
)
SIZES: tuple[Any, ...] = (0, -1.0, 1e-300, 1e-6, 1e99, 5, True, None, "4", [4.0], {"a": 1})
KEYS = {
    "radius_mm": 4.0, "fillet_mm": 0.2, "half_angle_deg": 30.0, "tip_radius_mm": 0.5, "size_x_mm": 5.0,
    "size_y_mm": 5.0, "length_mm": 6.0, "tube_radius_mm": 1.0, "file": "ball.stl", "scale": 1.0, "up": "+z",
}  # fmt: skip


def crafted_bundle(rng: Random, folder: Path) -> str:
    """A bundle with hostile numbers, sizes, indenter or movements, and a digest that is right."""
    path = rng.choice([path for path in files(folder, ".h5") if path.name != "frames.h5"])
    with h5py.File(path, "a") as file:
        group = file if "tacgen_format" in file.attrs else file[rng.choice(sorted(file))]
        said = rng.choice((_numbers, _numbers, _width, _size, _indenter, _indenter, _movement))(rng, group)
        name = group.name
    reseal(path, name)
    return f"{path.name}: {said}"


def _numbers(rng: Random, group: Any) -> str:
    """Numbers of one dataset that no solver gives."""
    name = rng.choice(datasets(group))
    values = group[name][...]
    if not values.size:
        return f"{name} is empty"
    number = rng.choice(NUMBERS if values.dtype.kind == "f" else COUNTS)
    where = rng.choice(("one", "frame", "all"))
    with np.errstate(all="ignore"):
        value = np.array(number).astype(values.dtype)
    if where == "one":
        values.flat[rng.randrange(values.size)] = value
    elif where == "frame" and values.ndim:
        values[rng.randrange(len(values))] = value
    else:
        values[...] = value
    group[name][...] = values
    return f"{name} {where} {number}"


def _width(rng: Random, group: Any) -> str:
    """Another size of an axis that no other dataset shares."""
    free = [name for name in datasets(group) if "*" in (dims := entry(f"/{name}").shape.split()) or "|" in str(dims)]
    if not free:
        return "nothing"
    name, size = rng.choice(free), rng.choice((0, 1, 2, 3, 5, 7, 9, 11))
    values = group[name][...]
    put(group, name, np.resize(values, (len(values), size)) if size else values[:, :0])
    return f"{name} {size} wide"


def _size(rng: Random, group: Any) -> str:
    """Another size of an axis, in all datasets that share it."""
    named = {name: entry(f"/{name}").shape.split() for name in datasets(group)}
    axis = rng.choice(sorted({dim for dims in named.values() for dim in dims if dim.isalpha()}))
    size = rng.choice((0, 1, 2))
    for name, dims in named.items():
        if axis in dims:
            values = group[name][...]
            at = dims.index(axis)
            put(group, name, np.take(values, np.arange(min(size, values.shape[at])), axis=at))
    return f"{axis} = {size}"


def _indenter(rng: Random, group: Any) -> str:
    fields = {key: rng.choice(SIZES) if rng.random() < 0.3 else usual for key, usual in KEYS.items()}
    if rng.random() < 0.2:
        fields.pop(rng.choice(sorted(fields)))
    shape = rng.choice(SHAPES)
    known = {
        "sphere": ("radius_mm",), "cylinder": ("radius_mm", "fillet_mm"), "cone": ("half_angle_deg", "tip_radius_mm"),
        "box": ("size_x_mm", "size_y_mm", "fillet_mm"), "wedge": ("half_angle_deg", "tip_radius_mm", "length_mm"),
        "capsule": ("radius_mm", "length_mm"), "torus": ("radius_mm", "tube_radius_mm"), "mesh": ("file", "scale"),
    }.get(shape if isinstance(shape, str) else "", tuple(KEYS))  # fmt: skip
    made = {"shape": shape, **{key: fields[key] for key in known if key in fields}}
    return rewritten(group, indenter=made)


def _movement(rng: Random, group: Any) -> str:
    kind = rng.choice(("press", "slide", "twist", "close", "lift", "replay", "jump", ""))
    keys = rng.choice(("depth_mm", "force_n", "x_mm", "angle_deg", "height_mm", "file", "frames"))
    moves = ([], [{}], [{kind: rng.choice(SIZES)}], [{kind: {keys: rng.choice(SIZES)}}] * 3)
    return rewritten(group, trajectory=rng.choice(moves))


def rewritten(group: Any, **changes: Any) -> str:
    """Other keys of a bundle's recipe."""
    group.attrs["recipe"] = json.dumps(json.loads(group.attrs["recipe"]) | changes)
    return str(changes)


def put(group: Any, name: str, values: np.ndarray) -> None:
    """Another dataset in the place of one, with its attributes."""
    attrs = dict(group[name].attrs)
    del group[name]
    group.create_dataset(name, data=values).attrs.update(attrs)


MUTATIONS = mutations.MUTATIONS | {"resealed": crafted_bundle}
