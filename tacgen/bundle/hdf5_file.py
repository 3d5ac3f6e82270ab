"""HDF5 files by h5py's low-level API, which takes a third of the time of the usual one.

An untrusted file's structure, types, shapes and filters are validated before any data are read.
"""

import io
import math
import os
import re
import sys
from collections.abc import Iterator, Mapping, Set
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base import regular_file
from tacgen.base.errors import UserError
from tacgen.bundle.schema import BUNDLE_FORMAT, entry, shape_problem
from tacgen.outputs import LAYOUT

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
MAX_HDF5_BYTES = 2**40  # largest file [bytes]
# deflate, shuffle, fletcher32: others would be loaded from a folder of libraries
ALLOWED_FILTERS = frozenset({1, 2, 3})
MAX_DEFLATE_RATIO = 1100  # largest ratio of decompressed to compressed size; that of deflate is 1032 [-]
MAX_PADDED_CHUNK_BYTES = 4096  # size of a chunk that may be larger than its data [bytes]
LAYOUT_GROUPS = {path[:i] for path in LAYOUT for i in range(1, len(path)) if path[i] == "/"}
HEAP_SIGNATURE = re.compile(rb"GCOL\x01\0\0\0")  # signature of a global heap, in which HDF5 stores strings
HEAP_SIGNATURE_BYTES = 8  # length of the signature [bytes]
# bytes of a read in which it is looked for: HDF5 reads the first 4096 of a heap by themselves
HEAP_SEARCH_BYTES = 2**16
MAX_HEAP_BYTES = 2**26  # largest heap that is checked [bytes]


class Damaged(UserError):
    """The bundle is not what was written: writing it again mends it."""


class BundleFile(io.FileIO):
    """The file object that HDF5 reads from.

    HDF5 1.14 never returns from a global heap that holds a free object of size 0, as zeroed disk sectors leave it. So
    each heap is checked as it is read.
    """

    def __del__(self) -> None:
        """Close it without a warning: h5py holds it until it closes its own file."""
        self.close()

    def readinto(self, buffer: Any) -> int:
        """As FileIO's. Raises OSError: a heap is damaged."""
        start = self.tell()
        count = super().readinto(buffer) or 0
        for match in HEAP_SIGNATURE.finditer(memoryview(buffer)[: min(count, HEAP_SEARCH_BYTES)]):
            self._check_heap(start + match.start())
        return count

    def _check_heap(self, start: int) -> None:
        """Each object of a heap is an index (2 bytes, 0: free), 6 other bytes, the size (8 bytes) and the content."""
        size = int.from_bytes(os.pread(self.fileno(), 8, start + HEAP_SIGNATURE_BYTES), "little")
        heap = os.pread(self.fileno(), min(size, MAX_HEAP_BYTES), start)
        at = HEAP_SIGNATURE_BYTES + 8
        while at + 16 <= len(heap):
            length = int.from_bytes(heap[at + 8 : at + 16], "little")
            used = heap[at : at + 2] != b"\0\0"
            if not (used or length):
                raise OSError("its heap of strings is damaged")
            at += 16 + (length + 7) // 8 * 8 if used else length


def open_file(path: Path) -> Any:
    """A file of h5py to read from: a regular one, whose heaps are checked.

    Raises:
        Damaged; UserError: there is no such file, or it is something else.
    """
    import h5py

    try:
        raw = BundleFile(regular_file.descriptor(path, MAX_HDF5_BYTES))
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}") from error
    try:
        if raw.read(len(HDF5_SIGNATURE)) != HDF5_SIGNATURE:
            raise UserError(f"{path}: not an HDF5 file")
        return h5py.File(raw, "r")
    except BaseException as error:
        raw.close()
        if isinstance(error, UserError | MemoryError) or not isinstance(error, Exception):
            raise
        raise _damaged(path, error) from error


def written_file(sink: Any, mode: str = "w", **options: Any) -> Any:
    """A file of h5py that is written through a sink of `atomic_file`; options as of h5py.File."""
    import h5py

    return h5py.File(sink, mode, **options)


def text_type() -> Any:
    """The type of texts of any length."""
    import h5py

    return h5py.string_dtype()


@contextmanager
def opened(path: Path, group: str = "/") -> Iterator[Any]:
    """An open group of a file. Any exception raised inside becomes a UserError, so only reading belongs there.

    Raises:
        Damaged; UserError: there is no such file, or it is something else.
    """
    with open_file(path) as file:
        try:
            yield item_at(file, group)
        except (UserError, MemoryError):
            raise
        except Exception as error:  # h5py and HDF5 fail in many ways on what is damaged or crafted
            raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> Damaged:
    return Damaged(f"{path}: damaged or cut short ({str(error).partition(chr(10))[0]})")


def item_at(group: Any, path: str) -> Any:
    """The group or dataset at a path. Raises KeyError: there is none; ValueError: a link, perhaps to another file."""
    import h5py

    for step in filter(None, path.split("/")):
        if not isinstance(group, h5py.Group) or not isinstance(group.get(step, getlink=True), h5py.HardLink):
            raise ValueError(f"{path} is a link")
        group = group[step]
    return group


def not_here(data: Any, filters: Set[int] = ALLOWED_FILTERS) -> str:
    """Why the values of a low-level dataset cannot be read from this file alone, by these filters; "" if they can."""
    from h5py import h5d

    packing = data.get_create_plist()
    if packing.get_layout() == h5d.VIRTUAL or packing.get_external_count():
        return "is not stored in this file"
    if not {packing.get_filter(i)[0] for i in range(packing.get_nfilters())} <= filters:
        return "is compressed in a way that cannot be read here: use gzip"
    claimed, stored = data.dtype.itemsize * math.prod(data.shape), data.get_storage_size()
    return f"claims {claimed} bytes, and stores {stored}" if claimed > MAX_DEFLATE_RATIO * stored else ""


def datasets(root: Any) -> dict[str, tuple[int, ...]]:
    """Shape of every dataset of an open bundle by its path.

    Raises:
        ValueError: a dataset or group is not in the layout, or differs from it.
    """
    from h5py import h5d, h5g, h5l, h5o

    shapes: dict[str, tuple[int, ...]] = {}
    sizes: dict[str, int] = {}

    def walk(group: Any, above: str) -> None:
        for name in group:
            path = sys.intern(f"{above}/{name.decode()}")
            if group.links.get_info(name).type != h5l.TYPE_HARD:
                raise ValueError(f"{path} is a link")
            item = h5o.open(group, name)
            if isinstance(item, h5d.DatasetID):
                shapes[path] = _checked_shape(path, item, sizes)
            elif path in LAYOUT_GROUPS and isinstance(item, h5g.GroupID):
                walk(item, path)
            else:
                raise ValueError(f"format {BUNDLE_FORMAT} has no group {path}")

    walk(root.id, "")
    return dict(sorted(shapes.items()))


def new_dataset(
    file: Any, path: str, dtype: np.dtype, shape: tuple[int, ...], chunk: tuple[int, ...], level: int
) -> Any:
    """A low-level dataset that is shuffled and deflated, and its groups; an empty axis may grow."""
    from h5py import h5d, h5p, h5s, h5t

    packing, groups = h5p.create(h5p.DATASET_CREATE), h5p.create(h5p.LINK_CREATE)
    packing.set_chunk(tuple(max(1, n) for n in chunk))
    packing.set_shuffle()
    packing.set_deflate(level)
    packing.set_obj_track_times(False)
    groups.set_create_intermediate_group(True)
    space = h5s.create_simple(shape, tuple(n or h5s.UNLIMITED for n in shape))
    return h5d.create(file.id, path.encode(), h5t.py_create(dtype, logical=True), space, dcpl=packing, lcpl=groups)


def dataset_at(file: Any, path: str) -> Any:
    """A low-level dataset of an open file."""
    from h5py import h5d

    return h5d.open(file.id, path.encode())


def add_attributes(item: Any, attrs: Mapping[str, Any]) -> None:
    """Give an open low-level group or dataset attributes that it does not have: text, numbers or bool."""
    from h5py import h5a, h5s, h5t, string_dtype

    scalar = h5s.create(h5s.SCALAR)
    for name, value in attrs.items():
        one = np.array(value, string_dtype() if isinstance(value, str) else None)
        stored = h5t.py_create(one.dtype, logical=True)
        h5a.create(item, name.encode(), stored, scalar).write(one, mtype=h5t.py_create(one.dtype))


def attributes_of(item: Any) -> dict[str, Any]:
    """The attributes of an open group or dataset, as h5py's `attrs` gives them."""
    from h5py import h5a, h5t, string_dtype

    found: dict[str, Any] = {}
    names: list[bytes] = []
    text, in_memory = np.empty((), object), h5t.py_create(string_dtype())
    h5a.iterate(item.id, names.append)
    for encoded in names:
        one, name = h5a.open(item.id, encoded), encoded.decode("utf-8", "surrogateescape")
        kind = one.get_type()
        if one.shape == () and isinstance(kind, h5t.TypeStringID) and kind.is_variable_str():
            one.read(text, mtype=in_memory)
            found[name] = text.item().decode("utf-8", "surrogateescape")
        else:
            found[name] = item.attrs[name]
    return found


def has_texts(item: Any, texts: Mapping[str, str]) -> bool:
    """Whether an open low-level dataset has these attributes and no others; h5py raises where one is no text."""
    from h5py import h5a, h5t, string_dtype

    found, in_memory = np.empty((), object), h5t.py_create(string_dtype())
    for name, text in texts.items():
        h5a.open(item, name.encode()).read(found, mtype=in_memory)
        if found.item() != text.encode():
            return False
    return int(h5a.get_num_attrs(item)) == len(texts)


def _checked_shape(path: str, data: Any, sizes: dict[str, int]) -> tuple[int, ...]:
    """A dataset's shape. Raises ValueError: it is stored elsewhere, differs from the layout, or claims more data than
    its compressed size can hold."""
    from h5py import h5d

    row, packing, dtype = entry(path), data.get_create_plist(), data.dtype
    shape: tuple[int, ...] = data.shape
    if dtype.str != row.dtype:
        raise ValueError(f"{path} has type {dtype.str}, expected {row.dtype}")
    if problem := shape_problem(path, shape, sizes):
        raise ValueError(problem)
    if problem := not_here(data):
        raise ValueError(f"{path} {problem}")
    most = max(dtype.itemsize * math.prod(max(1, n) for n in shape), MAX_PADDED_CHUNK_BYTES)
    if packing.get_layout() == h5d.CHUNKED and dtype.itemsize * math.prod(packing.get_chunk()) > most:
        raise ValueError(f"{path} is stored in pieces larger than itself")
    return shape
