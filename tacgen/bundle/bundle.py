"""Writing, reading and verifying bundles: one HDF5 file per scene, with the contents of the table in schema.py.

The same inputs give the same bytes, so nothing here depends on the clock: the pipeline writes the time of each stage
to `<name>.timing.json` beside the bundle.
"""

import hashlib
import json
import math
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from errno import EIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen.base import atomic_file
from tacgen.base.errors import UserError, printable
from tacgen.base.version import __version__
from tacgen.bundle import schema
from tacgen.bundle.chunks import Column, FrameReader, rounded
from tacgen.bundle.hdf5_file import Damaged, add_attributes, attributes_of, datasets, opened, written_file
from tacgen.bundle.scene_words import finger_text, shape_text
from tacgen.bundle.stored_json import parsed

if TYPE_CHECKING:
    from tacgen.sensor.model import Sensor

NOT_IN_DIGEST = ("digest", "complete")  # attributes that are written after the digest is known
PACKED_HINT = ": it holds packed scenes; give the folder it is in"


class Unfinished(UserError):
    """The writer was stopped; the bundle has to be written again."""


class Missing(UserError, KeyError):
    """The bundle has no dataset of this name."""


class Writer:
    """Writes one bundle. The file gets its name only after `finish` has read everything back.

        with Writer(path, attrs, frames=15) as writer:
            writer.put("/reference/rgb", flat)
            for ...:
                writer.append({"/frames/force": force, "/frames/rgb": image})
            writer.finish()

    Leaving the block without `finish` removes the part file. `attrs` are those of BUNDLE_ATTRS and OPTIONAL_ATTRS that
    the writer does not set itself; mappings and lists are stored as JSON. Arrays must have the shape and kind of the
    layout.

    Raises:
        ValueError, TypeError: an attribute, path, shape or type that is not in the tables (a bug in the caller).
        OSError: with its errno, e.g. ENOSPC when the disk is full.
        UserError: another process is writing the same bundle.
    """

    def __init__(self, path: Path, attrs: Mapping[str, Any], frames: int) -> None:
        self.path, self.frames, self.appended = Path(path), frames, 0
        own = {"tacgen_format": schema.BUNDLE_FORMAT, "tacgen_version": __version__, "units": schema.UNIT_SYSTEM}
        own["frames_planned"] = frames
        self._attrs: dict[str, Any] = _checked({**{k: _plain(v) for k, v in attrs.items()}, **own})
        self._sizes: dict[str, int] = {}
        self._columns: dict[str, Column] = {}
        self._finished = False

    def __enter__(self) -> "Writer":
        self.path.parent.mkdir(parents=True, exist_ok=True)
        atomic_file.sweep(self.path.parent)
        self._sink = atomic_file.Sink(self.path)
        try:
            with self._sink.guard():
                # v110: all metadata have checksums; readable by every HDF5 since 1.10
                self._file = written_file(self._sink, libver=("v110", "v110"))
                add_attributes(self._file.id, dict(sorted(self._attrs.items())))
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        if not self._finished:
            self._sink.dead = True  # ignore what HDF5 still flushes
            with suppress(Exception):
                self._file.close()
            self._sink.discard()

    def put(self, path: str, array: np.ndarray) -> None:
        """Store a dataset of the scene, without a frame axis: /reference, /mesh."""
        values = self._cast(path, array, per_frame=False)
        with self._sink.guard():
            self._write(path, values, None)

    def append(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Store the next frame: the same datasets for every frame, without the frame axis."""
        if self.appended and arrays.keys() != {p for p in self._columns if schema.entry(p).per_frame}:
            raise ValueError(f"frame {self.appended} has other datasets than frame 0: {sorted(arrays)}")
        if self.appended == self.frames:
            raise ValueError(f"{self.frames} frames were planned and are all written")
        values = {path: self._cast(path, array, per_frame=True) for path, array in arrays.items()}
        with self._sink.guard():
            for path, value in sorted(values.items()):
                self._write(path, value, self.frames)
        self.appended += 1

    def finish(
        self, status: str = "ok", reason: str = "", notes: Sequence[str] = (), renderer: str | None = None
    ) -> "Bundle":
        """Close the file, read everything back, and rename it; `status` is ok or rejected, `notes` those of the end,
        `renderer` the attribute, if it may have changed.

        A scene that ends early or is rejected has a reason.
        """
        unsaid = bool(reason) != (status == "rejected" or self.appended < self.frames)
        if status not in ("ok", "rejected") or unsaid or (status == "ok" and not self.appended):
            raise ValueError(f"{status!r} ({reason!r}) with {self.appended} of {self.frames} frames")
        late: dict[str, Any] = {"status": status, "reason": reason}
        if notes:
            late["notes"] = json.dumps([*json.loads(self._attrs.get("notes", "[]")), *notes])
        if renderer not in (None, self._attrs.get("renderer")):
            late["renderer"] = renderer
        self._attrs.update(late)
        described = {}
        with self._sink.guard():
            for path, column in self._columns.items():
                column.finish()
                data, content = column.data, column.hash.hexdigest()
                described[path] = Dataset(data.dtype.str, data.shape, column.attrs, content)  # as `verify` finds it
            last = {"digest": _digest(self._attrs, described), "complete": True}
            self._attrs.update(last)
            self._file.attrs.update({**late, **last})
            self._file.close()
        try:
            with opened(self._sink.path) as file:
                bundle = _bundle(self._sink.path, file)
                shapes = {path: one.shape for path, one in described.items()}
                alike = bundle.attrs == self._attrs and bundle.shapes == shapes
                if not (alike and all(column.is_stored(file) for column in self._columns.values())):
                    raise Damaged("its contents are not those that were written")
        except UserError as error:
            raise OSError(EIO, "what was written does not read back", str(self.path)) from error
        self._sink.publish()
        self._finished = True
        return replace(bundle, path=self.path)

    def _cast(self, path: str, array: np.ndarray, *, per_frame: bool) -> np.ndarray:
        row = schema.entry(path)
        if row.per_frame != per_frame:
            raise ValueError(f"{path}: {'put' if per_frame else 'append'} it, not {'append' if per_frame else 'put'}")
        values = rounded(path, schema.as_stored(path, array))
        self._sizes.pop("N", None)
        known = path in self._columns and self._columns[path].shape == values.shape
        shape = (self.appended + 1, *values.shape) if per_frame else values.shape
        if not known and (problem := schema.shape_problem(path, shape, self._sizes)):
            raise ValueError(problem)
        return values

    def _write(self, path: str, values: np.ndarray, frames: int | None) -> None:
        if path not in self._columns:
            self._columns[path] = Column(self._file, path, values, frames, schema.attributes(path))
        self._columns[path].append(values)


@dataclass(frozen=True, repr=False)
class Bundle:
    """A finished bundle. Arrays are read on access; no file stays open, so it can be pickled and needs no closing."""

    path: Path
    attrs: dict[str, Any]
    shapes: dict[str, tuple[int, ...]]
    group: str = "/"  # in the file; a shard holds a scene in each group

    def __repr__(self) -> str:
        return f"Bundle({self.line})"

    @property
    def line(self) -> str:
        """`scene-00000.h5: 10 frames, sphere, radius 4 mm, on gelsight_mini`, and why it is rejected if it is."""
        name, attrs = self.path.name + self.group.rstrip("/"), self.attrs
        planned, reason = attrs["frames_planned"], attrs["reason"]
        count = f"{self.frames} frames" if self.frames == planned else f"{self.frames} of {planned} frames"
        why = f": {attrs['status']}: {reason}" if reason else ""
        shape = shape_text(self.recipe.get("indenter", {}))
        return printable(f"{name}: {count}, {shape}, on {finger_text(attrs)}{why}")

    def __setstate__(self, state: dict[str, Any]) -> None:
        """From another process, with shared strings as from a file."""
        state["attrs"] = {sys.intern(name): _shared(value) for name, value in state["attrs"].items()}
        self.__dict__.update(state)

    def __contains__(self, path: str) -> bool:
        return path in self.shapes

    def __getitem__(self, path: str) -> np.ndarray:
        """A whole dataset. Raises Missing if there is none of this name, UserError if the file is damaged."""
        return self._read(path, None)

    def frame(self, path: str, index: int) -> np.ndarray:
        """One frame of a dataset whose first axis is the frame."""
        if not 0 <= index < self.frames:
            raise IndexError(f"{self.path} has no frame {index}")
        return self._read(path, index)

    @property
    def recipe(self) -> dict[str, Any]:
        """The resolved recipe of this scene, with nothing left to vary."""
        recipe: dict[str, Any] = json.loads(self.attrs["recipe"])
        return recipe

    @property
    def frames(self) -> int:
        """Number of stored frames; fewer than planned in a rejected scene."""
        return max((n[0] for p, n in self.shapes.items() if p.startswith(("/frames/", "/fields/"))), default=0)

    @property
    def segments(self) -> tuple[str, ...]:
        """For each frame, the kind of its trajectory segment (press, slide, ...)."""
        moves = self.recipe.get("trajectory", ())
        kinds = [next((kind for kind, move in s.items() if move is not None), "") for s in moves]
        if "/frames/segment" not in self:
            return ("",) * self.frames
        return tuple(kinds[i] if 0 <= i < len(kinds) else "" for i in self["/frames/segment"])

    @property
    def sensor(self) -> "Sensor":
        """The sensor of the scene. Raises UserError: the bundle does not hold it, or this version cannot read it."""
        from tacgen.sensor.model import Sensor

        if "sensor_document" not in self.attrs:
            raise UserError(f"{self.path}: does not hold its sensor")
        try:
            return parsed(Sensor, str(self.attrs["sensor_document"]))
        except ValueError as error:
            raise UserError(f"{self.path}: its sensor cannot be read by this version of tacgen: {error}") from None

    def verify(self) -> dict[str, "Dataset"]:
        """Compare all contents with the digest; UserError if a single bit has changed. Returns the datasets by path."""
        datasets = {}
        with opened(self.path, self.group) as file:
            for path in self.shapes:
                data = file[path[1:]]
                attrs = {name: _plain(value) for name, value in attributes_of(data).items()}
                datasets[path] = Dataset(data.dtype.str, data.shape, attrs, FrameReader(data).sha256())
        if _digest(self.attrs, datasets) != self.attrs["digest"]:
            raise Damaged(f"{self.path}: damaged: its contents do not match its digest")
        return datasets

    def _read(self, path: str, index: int | None) -> np.ndarray:
        if path not in self.shapes:
            raise Missing(f"{self.path}: has no {path}" + f", did you mean /{path}?" * (f"/{path}" in self.shapes))
        with opened(self.path, self.group) as file:
            data = FrameReader(file[path[1:]])
            values = data.whole() if index is None else data[index]
        row = schema.entry(path)
        low, high = (0, self._size(row.below) - 1) if row.below else (-row.most, row.most)
        if math.isfinite(high) and values.size and not low <= values.min() <= values.max() <= high:  # nor if nan
            raise Damaged(f"{self.path}: damaged: {path} has values beyond {low:g} to {high:g}")
        return values

    def _size(self, axis: str) -> int:
        """The size of an axis that the layout names by a letter."""
        places = ((shape, schema.entry(path).shape.split()) for path, shape in self.shapes.items())
        return next((shape[dims.index(axis)] for shape, dims in places if axis in dims), 0)


def read(path: Path, group: str = "/") -> Bundle:
    """Open a finished bundle, or a scene of a shard. The data themselves are checked by `Bundle.verify`.

    Raises:
        Unfinished, Damaged: it has to be written again.
        UserError: the file is missing, is not a bundle, or has a newer format.
    """
    path = Path(path)
    if atomic_file.is_part(path):
        raise Unfinished(f"{path}: unfinished: part file of a writer that was stopped or is still running")
    with opened(path, group) as file:
        return _bundle(path, file, group)


def _bundle(path: Path, file: Any, group: str = "/") -> Bundle:
    """The bundle in an open group of a file; raises as `read`."""
    attrs = {sys.intern(name): _shared(value) for name, value in attributes_of(file).items()}
    shapes, wrong = dict[str, tuple[int, ...]](), ""
    try:
        shapes = datasets(file)
    except ValueError as error:
        wrong = str(error)
    if not isinstance(attrs.get("tacgen_format"), int):
        raise UserError(f"{path}: an HDF5 file, but no tacgen bundle" + PACKED_HINT * ("tacgen_pack" in attrs))
    if attrs["tacgen_format"] > schema.BUNDLE_FORMAT:
        newer = f"bundle format {attrs['tacgen_format']}, written by tacgen {attrs.get('tacgen_version')}"
        raise UserError(f"{path}: {newer}; this tacgen reads up to {schema.BUNDLE_FORMAT}: upgrade it")
    if attrs.get("complete") is not True:
        raise Unfinished(f"{path}: unfinished: its writer was stopped")
    try:
        attrs = _checked(attrs, finished=True)
        if wrong:
            raise ValueError(wrong)
        bundle, planned = Bundle(path, attrs, shapes, group), attrs["frames_planned"]
        early = bundle.frames < planned and bool(attrs["reason"])
        if attrs["status"] == "ok" and not (bundle.frames and (early or bundle.frames == planned)):
            raise ValueError(f"{bundle.frames} frames, {planned} planned, but status is ok")
        return bundle
    except ValueError as error:
        raise Damaged(f"{path}: damaged: {error}") from error


def complete(path: Path, key: str) -> Bundle | None:
    """The bundle at `path` if it is complete, undamaged and has this input key; reads all of it.

    A rejected scene counts as complete: the same inputs would be rejected again.
    """
    try:
        bundle = read(path)
        if bundle.attrs["input_key"] == key:
            bundle.verify()
            return bundle
    except UserError:
        pass
    return None


@dataclass(frozen=True)
class Dataset:
    """The properties of a dataset that the digest covers."""

    dtype: str
    shape: tuple[int, ...]
    attrs: dict[str, Any]
    sha256: str


def _digest(attrs: Mapping[str, Any], datasets: Mapping[str, Dataset]) -> str:
    """Digest of the content, not of the file: paths, types, shapes, bytes and attributes, sorted."""
    root = {name: value for name, value in attrs.items() if name not in NOT_IN_DIGEST}
    rows = [[path, d.dtype, list(d.shape), d.attrs, d.sha256] for path, d in sorted(datasets.items())]
    return hashlib.sha256(json.dumps([root, rows], sort_keys=True, default=repr).encode()).hexdigest()


def _plain(value: Any) -> Any:
    """An attribute as a Python str, int, float or bool; mappings and sequences as JSON."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, Mapping | list | tuple):
        return json.dumps(value, sort_keys=True)
    return value


def _shared(value: Any) -> Any:
    """An attribute as `_plain` gives it, with interned strings: thousands of scenes share a sensor document of 4 kB."""
    value = _plain(value)
    return sys.intern(value) if type(value) is str else value


def _checked(attrs: dict[str, Any], *, finished: bool = False) -> dict[str, Any]:
    """The attributes unchanged; ValueError unless they are those of BUNDLE_ATTRS and OPTIONAL_ATTRS."""
    last = set() if finished else {"status", "reason", *NOT_IN_DIGEST}
    if missing := [name for name in schema.BUNDLE_ATTRS if name not in attrs and name not in last]:
        raise ValueError(f"attribute {missing[0]!r} is missing")
    for name, value in attrs.items():
        wanted = (schema.BUNDLE_ATTRS | schema.OPTIONAL_ATTRS).get(name)
        if wanted is None or name in last:
            raise ValueError(f"attribute {name!r} is not in the table of format {schema.BUNDLE_FORMAT}")
        if type(value) is not wanted[0]:
            raise ValueError(f"attribute {name!r} is {str(value)[:60]!r}, expected {wanted[0].__name__}")
        if isinstance(value, str):
            value.encode()  # ValueError if it is not valid text: HDF5 stores any bytes
        if isinstance(value, str) and name in schema.JSON_ATTRS:
            try:
                parsed(schema.JSON_ATTRS[name], value)
            except ValueError as error:
                raise ValueError(f"attribute {name!r}: {error}") from None
    if finished and attrs["status"] not in ("ok", "rejected"):
        raise ValueError(f"status is {attrs['status']!r}, expected 'ok' or 'rejected'")
    return attrs
