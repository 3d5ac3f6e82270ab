"""Chunks as they stand in the file."""

import zlib
from pathlib import Path

import h5py
import numpy as np
from helpers.synthetic import write


def test_small_chunks_are_packed_by_zlib(tmp_path: Path) -> None:
    """ISA-L packs a few bytes now and then otherwise in another process: the same scene would have other bytes."""
    path = write(tmp_path / "small.h5", outputs=frozenset({"force", "height"}), shape=(200, 300))
    with h5py.File(path) as file:
        for name in ("frames/segment", "frames/force", "frames/pose"):
            data = file[name]
            block = np.zeros(data.chunks, data.dtype)
            block[: len(data)] = data[: data.chunks[0]]
            planes = block.reshape(-1).view(np.uint8).reshape(-1, data.dtype.itemsize).T
            assert data.id.read_direct_chunk((0,) * data.ndim)[1] == zlib.compress(planes.tobytes(), 1)
        large = file["frames/height"].id.read_direct_chunk((0, 0, 0))[1]
    assert len(zlib.decompress(large)) == 50 * 75 * 4
