"""Maps keep the digits that they say, and no others; chunks are packed by one library."""

import zlib
from pathlib import Path

import deflate
import h5py
import numpy as np
import pytest
from helpers.synthetic import write

from tacgen.bundle.chunks import rounded, to_bits, to_multiples
from tacgen.outputs import LAYOUT

RNG = np.random.default_rng(2)


def values() -> np.ndarray:
    """Of all sizes from 1e-9 to 30 and both signs, with 0 and nan."""
    some = 10.0 ** RNG.uniform(-9, 1.5, 20000) * RNG.choice([-1, 1], 20000)
    return np.append(some, [0.0, np.nan]).astype("f4")


@pytest.mark.parametrize("power", sorted({row.power for row in LAYOUT.values() if row.power is not None}))
def test_multiples_are_the_nearest(power: int) -> None:
    x, step = values(), 2.0**power
    out = to_multiples(x, step)
    assert out.dtype == np.float32
    steps = out[:-1].astype(float) / step
    assert (steps == np.round(steps)).all()
    error = np.abs(out[:-1].astype(float) - x[:-1]) / step
    assert 0.49 < error.max() <= 0.5
    assert out[-2] == 0
    assert np.isnan(out[-1])
    assert (to_multiples(out[:-1], step) == out[:-1]).all()


def test_bits_are_the_nearest() -> None:
    x = values()
    out = to_bits(x, 13)
    assert out.dtype == np.float32
    assert (out[:-1].view("u4") % 2**11 == 0).all()  # of 24 bits the last 11
    assert (out[:-1].view("u4") % 2**12 != 0).any()
    error = np.abs(out[:-2].astype(float) / x[:-2] - 1)
    assert 0.95 * 2**-13 < error.max() <= 2**-13
    assert out[-2] == 0
    assert np.isnan(out[-1])
    assert (to_bits(out[:-1], 13) == out[:-1]).all()


def test_a_value_beyond_the_steps_keeps_its_own_digits() -> None:
    x = np.array([3e2, 1e4, 1e6], "f4")
    assert to_multiples(x, 2.0**-16) == pytest.approx(x, rel=3e-7)


def test_what_is_rounded_is_float32_of_the_layout() -> None:
    assert not [path for path, row in LAYOUT.items() if row.power and row.bits]
    assert {row.dtype for row in LAYOUT.values() if row.rounding} == {"<f4"}
    x = values()
    assert rounded("/fields/displacement", x) is x
    assert (rounded("/frames/height", x)[:-1] == to_multiples(x, 2**-16)[:-1]).all()
    assert (rounded("/frames/pressure", x)[:-1] == to_bits(x, 13)[:-1]).all()


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
