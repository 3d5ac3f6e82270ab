"""Numbers of a camera's noise as NumPy's PCG64 draws them, by Triton; imported only where there is a GPU.

PCG64 is O'Neill's PCG XSL RR 128/64 (PCG: A Family of Simple Fast Space-Efficient Statistically Good Algorithms for
Random Number Generation, 2014): a linear congruential generator of 128 bits, which jumps any number of steps ahead at
once (F. Brown, Random Number Generation with Arbitrary Strides, 1994). So each step is computed by itself.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import torch
import triton
import triton.language as tl
from torch import Tensor

NOISE_LANES = 256  # of a program
PCG_MULTIPLIER, PCG_MASK = 0x2360ED051FC65DA44385DF649FCCF645, (1 << 128) - 1


@lru_cache(maxsize=2)
def jumps(count: int) -> np.ndarray:
    """Factors A and C by which `k` steps lead to A state + C increment mod 2^128, for k = 1 to `count`: low and high
    half of A, then of C (4, count), int64."""
    halves, power, total = bytearray(), 1, 0
    for _ in range(count):
        total = (total + power) & PCG_MASK  # C: the sum of all powers before
        power = power * PCG_MULTIPLIER & PCG_MASK
        halves += power.to_bytes(16, "little") + total.to_bytes(16, "little")
    return np.ascontiguousarray(np.frombuffer(halves, "<i8").reshape(count, 4).T)


def states(random: Sequence[np.random.Generator | None]) -> np.ndarray:
    """State and increment of generators, low half before high, (F, 4) int64.

    Raises:
        ValueError: one is not a PCG64, or keeps half an output for the next number.
    """
    parts = bytearray()
    for each in random:
        told = {} if each is None else each.bit_generator.state
        if told.get("bit_generator") != "PCG64" or told["has_uint32"]:
            raise ValueError("noise is drawn from a PCG64 generator for each picture, with no half of an output left")
        parts += b"".join(told["state"][key].to_bytes(16, "little") for key in ("state", "inc"))
    return np.frombuffer(parts, "<i8").reshape(-1, 4)


@triton.jit
def _unsigned(AT, there):
    """Entries with the bits of int64, whose arithmetic is mod 2^64 and whose shifts and order have no sign."""
    return tl.load(AT, mask=there, other=0).to(tl.uint64, bitcast=True)


@triton.jit
def _product(low, high, other_low, other_high):
    """Low and high half of a product mod 2^128."""
    return low * other_low, tl.umulhi(low, other_low) + low * other_high + high * other_low


@triton.jit
def _outputs(STATES, JUMPS, OUT, count, LANES: tl.constexpr):
    """Outputs (F, count) of generators by `states` and `jumps`."""
    k, frame = tl.program_id(0) * LANES + tl.arange(0, LANES), tl.program_id(1).to(tl.int64)
    there, STATE = k < count, STATES + 4 * frame
    low, high = _product(
        _unsigned(JUMPS + k, there), _unsigned(JUMPS + count + k, there),
        _unsigned(STATE, True), _unsigned(STATE + 1, True),
    )  # fmt: skip
    more, much = _product(
        _unsigned(JUMPS + 2 * count + k, there), _unsigned(JUMPS + 3 * count + k, there),
        _unsigned(STATE + 2, True), _unsigned(STATE + 3, True),
    )  # fmt: skip
    low += more
    high += much + (low < more).to(tl.uint64)  # with the carry
    mixed, turn = high ^ low, high >> 58
    mixed = (mixed >> turn) | (mixed << ((64 - turn) & 63))
    tl.store(OUT + frame * count + k, mixed.to(tl.int64, bitcast=True), mask=there)


def drawn(states: Tensor, jumps: Tensor) -> Tensor:
    """Numbers (F, 4 n), 16 bits each as int16, that generators with `states` (F, 4) draw next by
    integers(0, 65536, 4 n, np.uint16); `jumps` (4, n) are those of as many steps, four numbers to each."""
    frames, count = len(states), jumps.shape[1]
    out = torch.empty((frames, count), dtype=torch.int64, device=states.device)
    _outputs[triton.cdiv(count, NOISE_LANES), frames](states, jumps, out, count, NOISE_LANES)
    return out.view(torch.int16)
