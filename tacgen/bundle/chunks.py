"""Compression of chunks outside HDF5, in the format of its filters: shuffle, then deflate, by libdeflate.

Any HDF5 reads the result. libdeflate gives the same bytes for the same content in each process; ISA-L, four times as
fast, gives others for one stream in some thousands. Each stream ends with a checksum of its content (Adler-32), which
is verified on reading. Each component of a map has its own chunk, which compresses better; images are one chunk: with
three, noisy ones would be a tenth smaller but take a fifth longer to read, and dark ones would be larger. Maps are
rounded before, to the digits that their error allows, since random bits cannot be compressed. Pictures are compressed
at level 1, all else at level 2.
"""

import hashlib
import math
from typing import Any

import deflate
import numpy as np

from tacgen.bundle.hdf5_file import add_attributes, dataset_at, has_texts, new_dataset
from tacgen.bundle.schema import entry

Array = np.ndarray
# libdeflate's level: 1 takes two thirds as long as 2 for noise, twice as long for zeros
PICTURE_DEFLATE_LEVEL, OTHER_DEFLATE_LEVEL = 1, 2
CHUNK_FILTERS = (2, 1)  # HDF5's numbers of shuffle and deflate
MAX_SHARED_CHUNK_BYTES = 4096  # [bytes] chunks up to this size hold several small frames


class Column:
    """A dataset during writing, frame by frame or at once.

    Args:
        file: an open HDF5 file.
        first: the first frame, or the whole dataset.
        frames: planned number of frames; None: the dataset has no frame axis.
        attrs: attributes of the dataset.
    """

    def __init__(self, file: Any, path: str, first: Array, frames: int | None, attrs: dict[str, str]) -> None:
        self.hash, self.length, self.shape, self.attrs = hashlib.sha256(), 0, first.shape, attrs
        self._path = path
        self._sums: dict[tuple[int, ...], int] = {}  # offset of each chunk -> CRC-32 of its stored bytes
        self._waiting: list[Array] = []
        self._parts = first.shape[-1] if first.ndim == 3 and first.dtype.kind == "f" else 1
        self._level = PICTURE_DEFLATE_LEVEL if "H" in entry(path).dims else OTHER_DEFLATE_LEVEL
        chunk = (*first.shape[:-1], 1) if self._parts > 1 else first.shape
        shape, self._rows = first.shape, 0
        if frames is not None:
            self._rows = max(1, min(frames, MAX_SHARED_CHUNK_BYTES // max(1, first.nbytes)))
            shape, chunk = (frames, *shape), (self._rows, *chunk)
        self.data = new_dataset(file, path, first.dtype, shape, chunk, self._level)
        add_attributes(self.data, attrs)

    def append(self, values: Array) -> None:
        """The next frame, or the whole dataset."""
        self.hash.update(np.ascontiguousarray(values).data)
        self._waiting.append(values.copy() if self._rows > 1 else values)  # copied, because the caller may change it
        self.length += 1
        if len(self._waiting) >= self._rows:
            self._flush()

    def finish(self) -> None:
        """Remove the frames that were planned but not written, and write what is buffered."""
        if self._rows and self.length < self.data.shape[0]:
            self.data.set_extent((self.length, *self.shape))  # before writing: HDF5 would compress a cut chunk again
        if self._waiting:
            self._waiting += [np.zeros_like(self._waiting[0])] * (self._rows - len(self._waiting))
            self._flush()

    def is_stored(self, file: Any) -> bool:
        """Whether the dataset of the file, opened again, has the attributes and chunks that were written."""
        data = dataset_at(file, self._path)
        chunks = ((begin, data.read_direct_chunk(begin)[1]) for begin in self._sums)
        return has_texts(data, self.attrs) and all(deflate.crc32(c) == self._sums[begin] for begin, c in chunks)

    def _flush(self) -> None:
        block = np.stack(self._waiting) if len(self._waiting) > 1 else self._waiting[0]
        self._waiting = []
        if not block.size:
            return
        for part, stream in enumerate(_packed(block, self._parts, self._level)):
            begin = [0] * len(self.data.shape)
            begin[0] = (self.length - 1) // max(1, self._rows) * self._rows
            begin[-1] += part
            self.data.write_direct_chunk(tuple(begin), stream)
            self._sums[tuple(begin)] = deflate.crc32(stream)


class FrameReader:
    """Reads a dataset of an open file frame by frame; HDF5 decompresses chunks that are not laid out as above."""

    def __init__(self, data: Any) -> None:
        packing, chunk = data.id.get_create_plist(), data.chunks
        filters = tuple(packing.get_filter(i)[0] for i in range(packing.get_nfilters()))
        self.data, self.dtype, self.shape = data, data.dtype, data.shape[1:]
        self._parts = data.shape[-1] if chunk == (1, *self.shape[:-1], 1) else 1
        whole = filters == CHUNK_FILTERS and math.prod(data.shape) > 0
        self.ours = whole and (self._parts > 1 or chunk == (1, *self.shape))

    def __getitem__(self, index: int) -> Array:
        """One frame, as a writable array. Raises ValueError, or an error of h5py, if it is damaged."""
        if not self.ours:
            return np.asarray(self.data[index])
        begin, streams = [index] + [0] * len(self.shape), list[bytes]()
        for part in range(self._parts):
            skipped, stream = self.data.id.read_direct_chunk((*begin[:-1], begin[-1] + part))
            if skipped:
                return np.asarray(self.data[index])
            streams.append(stream)
        return _unpacked(streams, self.dtype, self.shape)

    def whole(self) -> Array:
        """All frames."""
        if not self.ours:
            return np.asarray(self.data[()])
        out = np.empty(self.data.shape, self.dtype)
        for index in range(len(out)):
            out[index] = self[index]
        return out

    def sha256(self) -> str:
        """SHA-256 of the whole content, chunk by chunk."""
        digest = hashlib.sha256()
        rows = self.data.chunks[0] if self.data.chunks else 1
        for start in range(0, self.data.shape[0] if self.data.shape else 0, rows):
            digest.update(np.asarray(self[start] if self.ours else self.data[start : start + rows]).data)
        return digest.hexdigest()


def _packed(block: Array, parts: int, level: int) -> list[bytes]:
    """Compress a block (..., c) as 1 chunk, or as c chunks of one component each."""
    values = np.ascontiguousarray(block).reshape(-1).view(np.uint8).reshape(-1, parts, block.itemsize)
    planes = (np.ascontiguousarray(values[:, part].T) for part in range(parts))  # one at a time stays in the cache
    return [bytes(deflate.zlib_compress(plane.reshape(-1), level)) for plane in planes]


def _unpacked(streams: list[bytes], dtype: np.dtype, shape: tuple[int, ...]) -> Array:
    """Decompress the streams of a block."""
    count = math.prod(shape) // len(streams)
    values = np.empty((count, len(streams), dtype.itemsize), np.uint8)
    for part, stream in enumerate(streams):
        try:
            plain = deflate.zlib_decompress(stream, values[:, part].size)  # no more than that of a malicious stream
        except deflate.DeflateError as error:
            raise ValueError(f"a chunk does not inflate: {error}") from None
        if len(plain) != values[:, part].size:
            raise ValueError("a chunk is not as long as it should be")
        for byte, plane in enumerate(np.frombuffer(plain, np.uint8).reshape(-1, count)):  # a third of the time of .T
            values[:, part, byte] = plane
    return values.reshape(-1).view(dtype).reshape(shape)


def rounded(path: str, values: Array) -> Array:
    """The values of a dataset as they are stored."""
    row = entry(path)
    if row.power is not None:
        return to_multiples(values, 2.0**row.power)
    return values if row.bits is None else to_bits(values, row.bits)


def to_multiples(values: Array, step: float) -> Array:
    """Float32 values to the nearest multiple of `step`, a power of two; nan stays.

    Adding 1.5 * 2^23 steps leaves no bit below a step. Values of 2^22 steps or more are rounded to their own last bits.
    """
    shift = np.float32(1.5 * 2**23 * step)
    out = np.asarray(values + shift)
    out -= shift
    return out


def to_bits(values: Array, bits: int) -> Array:
    """Float32 values rounded to `bits` significant bits: the upper half of Dekker's (1971) split."""
    out = np.asarray(values * np.float32(2 ** (24 - bits) + 1))
    out -= out - values
    return out
