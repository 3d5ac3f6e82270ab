"""Chunks as they stand in the file."""

import zlib
from pathlib import Path

import deflate
import h5py
import numpy as np
from helpers.synthetic import write


def test_chunks_are_packed_by_libdeflate(tmp_path: Path) -> None:
    """Some other libraries pack a stream now and then otherwise in another process: a scene would have other bytes."""
    path = write(tmp_path / "some.h5", outputs=frozenset({"force", "height"}), shape=(200, 300))
    with h5py.File(path) as file:
        for name in ("frames/segment", "frames/force", "frames/pose", "frames/height"):
            data = file[name]
            block = np.zeros(data.chunks, data.dtype)
            block[: len(data)] = data[: data.chunks[0]]
            planes = block.reshape(-1).view(np.uint8).reshape(-1, data.dtype.itemsize).T.tobytes()
            stored = data.id.read_direct_chunk((0,) * data.ndim)[1]
            assert stored == deflate.zlib_compress(planes, 1)
            assert zlib.decompress(stored) == planes
