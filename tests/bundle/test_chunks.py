"""Chunks as they stand in the file."""

import zlib
from pathlib import Path

import deflate
import h5py
import numpy as np
import pytest
from helpers.synthetic import write


@pytest.mark.parametrize(("name", "level"), [("segment", 2), ("height", 2), ("rgb", 1)])
def test_chunks_are_packed_by_libdeflate(tmp_path: Path, name: str, level: int) -> None:
    """Some other libraries pack a stream now and then otherwise in another process: a scene would have other bytes."""
    path = write(tmp_path / "some.h5", outputs=frozenset({"force", "height", "rgb"}), shape=(200, 300))
    with h5py.File(path) as file:
        data = file[f"frames/{name}"]
        block = np.zeros(data.chunks, data.dtype)
        block[: len(data)] = data[: data.chunks[0]]
        planes = block.reshape(-1).view(np.uint8).reshape(-1, data.dtype.itemsize).T.tobytes()
        stored = data.id.read_direct_chunk((0,) * data.ndim)[1]
        assert stored == deflate.zlib_compress(planes, level)
        assert zlib.decompress(stored) == planes
        assert data.compression_opts == level
