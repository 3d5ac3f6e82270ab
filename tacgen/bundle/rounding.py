"""Rounding of maps to the digits that their error allows, since random bits cannot be compressed."""

import numpy as np

from tacgen.bundle.schema import entry


def rounded(path: str, values: np.ndarray) -> np.ndarray:
    """The values of a dataset as they are stored."""
    row = entry(path)
    if row.power is not None:
        return to_multiples(values, 2.0**row.power)
    return values if row.bits is None else to_bits(values, row.bits)


def to_multiples(values: np.ndarray, step: float) -> np.ndarray:
    """Float32 values to the nearest multiple of `step`, a power of two; nan stays.

    Adding 1.5 * 2^23 steps leaves no bit below a step. Values of 2^22 steps or more are rounded to their own last bits.
    """
    shift = np.float32(1.5 * 2**23 * step)
    out = np.asarray(values + shift)
    out -= shift
    return out


def to_bits(values: np.ndarray, bits: int) -> np.ndarray:
    """Float32 values rounded to `bits` significant bits: the upper half of Dekker's (1971) split."""
    out = np.asarray(values * np.float32(2 ** (24 - bits) + 1))
    out -= out - values
    return out
