"""Seeded damage: each mutation takes a random generator and a folder, spoils one file in it, and says what it did.

Damage to bytes is what a disk or a transfer does; the rest is what somebody crafts.
"""

import contextlib
import copy
import json
import os
import re
import socket
from collections.abc import Callable
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import h5py
import numpy as np

from tacgen.bundle.schema import JSON_ATTRS

Mutation = Callable[[Random, Path], str]
DEEP = "[" * 5000 + "]" * 5000
VALUES: tuple[Any, ...] = (
    *(None, True, -1, 0, 10**30, 2**63, 1e308, float("nan"), float("inf"), 1.5),
    *("", "../../etc/passwd", "/etc/passwd", "..", "a/b", "\ud800", "\x1b[31mred\x07", "<script>alert(1)</script>"),
    *("x" * 100_000, "nul\0", "{", "1" * 5000, [], {}, [[]], [None], {"": {}}, ["\udfff"]),
)


def files(folder: Path, *suffixes: str) -> list[Path]:
    found = sorted(path for path in folder.rglob("*") if path.is_file())
    return [path for path in found if not suffixes or path.suffix in suffixes]


def damaged_bytes(rng: Random, folder: Path) -> str:
    """Flip, cut, zero, insert, exchange."""
    path = rng.choice([path for path in files(folder) if path.stat().st_size])
    data = path.read_bytes()
    changed: dict[str, Callable[[], bytes]] = {
        "flip": lambda: data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :],
        "cut": lambda: data[:at],
        "zero": lambda: data[:at] + bytes(len(data[at : at + 200])) + data[at + 200 :],
        "insert": lambda: data[:at] + rng.randbytes(rng.randrange(1, 50)) + data[at:],
        "double": lambda: data * 2,
        "exchange": lambda: rng.choice(files(folder)).read_bytes(),
        "junk": lambda: rng.randbytes(rng.randrange(2000)),
    }
    how, at = rng.choice(list(changed)), rng.randrange(len(data))
    path.write_bytes(changed[how]())
    return f"{how} of {path.name} at {at}"


def special(rng: Random, folder: Path) -> str:
    """A pipe, folder, socket, link or nothing in a file's place, or one that nobody may read."""
    path = rng.choice(files(folder))
    made: dict[str, Callable[[], object]] = {
        "fifo": lambda: os.mkfifo(path),
        "folder": path.mkdir,
        "socket": lambda: _socket(path),
        "loop": lambda: path.symlink_to(path.name),
        "zero": lambda: path.symlink_to("/dev/zero"),
        "gone": lambda: None,
        "sparse": lambda: (path.touch(), os.truncate(path, 2**43)),
    }
    kind = rng.choice(list(made))
    path.unlink()
    made[kind]()
    return f"{kind} for {path.name}"


def _socket(path: Path) -> None:
    with contextlib.chdir(path.parent), socket.socket(socket.AF_UNIX) as made:  # a socket's path is short
        made.bind(path.name)


def crafted_json(rng: Random, folder: Path) -> str:
    """A hostile value anywhere in index.json, a plan, a journal or a list of times."""
    path = rng.choice(files(folder, ".json", ".jsonl"))
    if rng.random() < 0.05:
        path.write_text(DEEP)
        return f"{path.name} nested deeply"
    lines = path.read_text().splitlines() if path.suffix == ".jsonl" else [path.read_text()]
    number = rng.randrange(len(lines))
    said, lines[number] = _spoilt(rng, lines[number])
    path.write_text("\n".join(lines) + "\n")
    return f"{path.name}: {said}"


def _spoilt(rng: Random, text: str) -> tuple[str, str]:
    """JSON with one node exchanged, dropped, renamed or doubled."""
    root = {"": json.loads(text)}
    places: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        for key, value in list(node.items() if isinstance(node, dict) else enumerate(node)):
            places.append((node, key))
            if isinstance(value, dict | list):
                walk(value)

    walk(root)
    node, key = rng.choice(places)
    how = rng.choice(("exchange", "exchange", "drop", "rename", "double"))
    if how == "exchange" or node is root:
        node[key] = rng.choice(VALUES)
    elif how == "drop":
        node.pop(key)
    elif how == "rename" and isinstance(node, dict):
        node[str(rng.choice(VALUES))] = node.pop(key)
    elif isinstance(node, list):
        node.append(copy.deepcopy(node[key]))
    return f"{how} {str(key)[:20]}", json.dumps(root[""])


def crafted_hdf5(rng: Random, folder: Path) -> str:
    """An HDF5 file of sound bytes whose attributes, datasets and links are not a bundle's; its digest may be right."""
    path = rng.choice([path for path in files(folder, ".h5") if path.name != "frames.h5"])
    with h5py.File(path, "a") as file:
        group = file if "tacgen_format" in file.attrs else file[rng.choice(sorted(file))]
        said = rng.choice((_attribute, _attribute, _json_attribute, _dataset, _dataset))(rng, group, path)
    if rng.random() < 0.5:
        said += reseal(path, group.name if group else "/")
    return f"{path.name}: {said}"


def _attribute(rng: Random, group: Any, path: Path) -> str:
    name, attrs = rng.choice(sorted(group.attrs)), group.attrs
    if rng.random() < 0.2:
        attrs = group[rng.choice(datasets(group))].attrs
        name = rng.choice(sorted(attrs))

    def value() -> Any:
        found = rng.choice([v for v in VALUES if isinstance(v, str | float | bool)])
        return found.replace("\0", "").encode(errors="surrogatepass")[:60000] if isinstance(found, str) else found

    made: dict[str, Callable[[], object]] = {
        "drop": lambda: attrs.pop(name),
        "value": lambda: attrs.update({name: value()}),
        "bytes": lambda: attrs.create(name, b"\xff\xfe\xed", dtype=h5py.string_dtype()),
        "array": lambda: attrs.update({name: np.arange(rng.randrange(5))}),
        "reference": lambda: attrs.update({name: group.ref}),
        "empty": lambda: attrs.update({name: h5py.Empty("f8")}),
        "struct": lambda: attrs.update({name: np.zeros(2, [("a", "i4"), ("b", "f8", 3)])}),
        "new": lambda: attrs.update({f"new {rng.randrange(9)}\x1b": "x"}),
    }
    kind = rng.choice(list(made))
    made[kind]()
    return f"attribute {name} {kind}"


def _json_attribute(rng: Random, group: Any, path: Path) -> str:
    name = rng.choice([name for name in JSON_ATTRS if name in group.attrs])
    said, text = _spoilt(rng, group.attrs[name])
    group.attrs[name] = DEEP[:60000] if rng.random() < 0.1 else text[:60000]
    return f"{name}: {said}"


def _dataset(rng: Random, group: Any, path: Path) -> str:
    name = rng.choice(datasets(group))
    old = group[name]
    shape, values, attrs = old.shape, old[...], dict(old.attrs)
    where, _, last = name.rpartition("/")
    parent, ones = group[where], (1,) * (len(shape) - 1)
    put, new = partial(parent.__setitem__, last), partial(parent.create_dataset, last)

    def virtual() -> None:
        layout = h5py.VirtualLayout(shape, values.dtype)
        layout[...] = h5py.VirtualSource(str(path), f"{group.name}/frames/elsewhere", shape, values.dtype)
        parent.create_virtual_dataset(last, layout)

    def nan() -> None:
        if values.dtype.kind == "f" and values.size:
            old[(0,) * values.ndim] = np.nan

    made: dict[str, Callable[[], object]] = {
        "drop": lambda: None,
        "external link": lambda: put(
            h5py.ExternalLink("/etc/passwd" if rng.random() < 0.3 else "scene-00001.h5", "/frames/force")
        ),
        "soft link": lambda: put(h5py.SoftLink(f"{group.name}/frames/pose")),
        "loop": lambda: parent.update({"loop": group}),
        "dangling": lambda: put(h5py.SoftLink("/frames/nothing")),
        "objects": lambda: new(shape[:1], dtype=h5py.vlen_dtype("f8")),
        "huge": lambda: new((10**9, *shape[1:]), values.dtype, chunks=(1, *shape[1:]), compression="gzip"),
        "virtual": virtual,
        "storage": lambda: new(shape, values.dtype, external=[("/etc/passwd", 0, h5py.h5f.UNLIMITED)]),
        "type": lambda: put(values.astype(rng.choice(("f2", "f4", "i8", "u1", "c16", "S3")))),
        "scalar": lambda: put(1.0),
        "struct": lambda: put(np.zeros(shape[:1], [("a", "i4")])),
        "group": lambda: parent.create_group(last),
        "new": lambda: parent.create_dataset(rng.choice(("colour", "..", "a b", "rgb\x1b", "x" * 3000)), data=[1.0]),
        "long": lambda: put(np.concatenate([values, values])),
        "flat": lambda: put(values.ravel()),
        "nan": nan,
        "strings": lambda: new(data=["\x1b[2J"] * (shape[0] if shape else 1)),
        "huge chunk": lambda: new(
            shape[:1] + ones, "u1", maxshape=(None,) * len(shape), chunks=(2**31, *ones), compression="gzip"
        ),
    }
    kind = rng.choice(list(made))
    if kind not in ("new", "nan", "loop"):
        del group[name]
    made[kind]()
    if kind not in ("external link", "soft link", "dangling") and isinstance(group.get(name), h5py.Dataset):
        group[name].attrs.update(attrs)
    return f"{name} {kind}"


def datasets(group: Any) -> list[str]:
    found: list[str] = []
    group.visititems(lambda name, item: found.append(name) if isinstance(item, h5py.Dataset) else None)
    return sorted(found)


def reseal(path: Path, group: str) -> str:
    """Give the file the digest of what it now holds, as somebody would who knows how."""
    from tacgen.bundle import bundle

    real, seen = bundle._digest, []
    bundle._digest = lambda attrs, found: seen.append(real(attrs, found)) or real(attrs, found)
    try:
        bundle.read(path, group).verify()
    except Exception:
        pass
    finally:
        bundle._digest = real
    if not seen:
        return ""
    with h5py.File(path, "a") as file:
        file[group].attrs["digest"] = seen[0]
    return ", resealed"


def damaged_input(rng: Random, folder: Path) -> str:
    """Damage to bytes, or words and numbers of a text exchanged for others."""
    path = rng.choice(files(folder))
    try:
        words = re.split(r"(\s+|[,:{}\[\]/])", path.read_text())
    except UnicodeDecodeError:
        return damaged_bytes(rng, folder)
    if rng.random() < 0.3:
        return damaged_bytes(rng, folder)
    for _ in range(rng.randrange(1, 4)):
        at = rng.randrange(len(words))
        words[at] = rng.choice((*WORDS, rng.choice(words), words[at] * 2, ""))
    path.write_text("".join(words))
    return f"words of {path.name}"


WORDS = (
    *("nan", "inf", "-1", "0", "1e400", "-1e-320", "9" * 400, "0x" + "f" * 5000, "1_0", "null", "true", "~", "---"),
    *("&a", "*a", "!!int", "!!python/object:os.system", "<<", "{", "]", "\t", "\r", "\x0b", "\u2028", "#", "|", "%TAG"),
    *("../../etc/passwd", "/dev/zero", "\N{RIGHT-TO-LEFT OVERRIDE}", "x" * 100_000, "[" * 3000, "mtllib /dev/zero\n"),
)


def odd_numbers(rng: Random, folder: Path) -> str:
    """A number of the recipe or its sensor exchanged for one that nobody measures."""
    path = folder / rng.choice(("recipe.yaml", "sensor.yaml"))
    text = path.read_text()
    found = rng.choice(list(re.finditer(r"(?<=[:\[,] )-?\d+(\.\d+)?(?=[\s,}\]])", text)))
    number = rng.choice(("1e300", "-1e300", "1e-300", "1e-320", "1e11", "1e-9", "1000000", "100000000000", "0", "-1"))
    path.write_text(text[: found.start()] + number + text[found.end() :])
    return f"{number} in {path.name} at {found.start()}"


def spoilt_log(rng: Random, folder: Path) -> str:
    """Damage to the bytes of a log, or an array of it exchanged for an odd one."""
    path = rng.choice(files(folder))
    if path.suffix == ".csv" or rng.random() < 0.6:
        data = bytearray(path.read_bytes())
        at, junk = rng.randrange(len(data)), rng.randbytes(rng.choice((1, 4, 40)))
        data[at : at + rng.choice((0, len(junk)))] = junk
        path.write_bytes(data[: rng.choice((len(data), len(data), at))])
        return f"bytes of {path.name} at {at}"
    odd = rng.choice((b"\xff", np.zeros((4, 0)), np.full((4, 3), np.nan), np.zeros(2), np.full((4, 3), 1e300), np.inf))
    name = rng.choice(("time", "object_position", "object_quaternion", "force", "units"))
    if path.suffix == ".npz":
        with np.load(path) as found:
            np.savez_compressed(path, **{**found, name: odd})
        return f"{name} of {path.name}"
    with h5py.File(path, "a") as file:
        del file[name]
        file[name] = rng.choice((odd, h5py.Empty("f8"), h5py.SoftLink(f"/{name}"), h5py.ExternalLink("log.npz", "/a")))
    return f"{name} of {path.name}"


MUTATIONS: dict[str, Mutation] = {
    "inputs": damaged_input,
    "logs": spoilt_log,
    "numbers": odd_numbers,
    "bytes": damaged_bytes,
    "special": special,
    "json": crafted_json,
    "hdf5": crafted_hdf5,
}
