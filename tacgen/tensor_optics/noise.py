"""Numbers of a camera's noise for many pictures, those that NumPy's generators draw, on the tensors' device."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from tacgen.physics import noise
from tacgen.physics.runtime import launch

PCG_MULTIPLIER, PCG_MASK = 0x2360ED051FC65DA44385DF649FCCF645, (1 << 128) - 1


@lru_cache(maxsize=2)
def jumps(count: int) -> np.ndarray:
    """Factors A and C by which `k` steps lead to A state + C increment mod 2^128, for k = 1 to `count`: (count, 2, 2)
    int64, low half before high."""
    halves, power, total = bytearray(), 1, 0
    for _ in range(count):
        total = (total + power) & PCG_MASK  # C: the sum of all powers before
        power = power * PCG_MULTIPLIER & PCG_MASK
        halves += power.to_bytes(16, "little") + total.to_bytes(16, "little")
    return np.frombuffer(halves, "<i8").reshape(count, 2, 2)


def states(random: Sequence[np.random.Generator | None]) -> np.ndarray:
    """State and increment of generators (F, 2, 2) int64, low half before high.

    Raises:
        ValueError: one is not a PCG64, or keeps half an output for the next number.
    """
    parts = bytearray()
    for each in random:
        told = {} if each is None else each.bit_generator.state
        if told.get("bit_generator") != "PCG64" or told["has_uint32"]:
            raise ValueError("noise is drawn from a PCG64 generator for each picture, with no half of an output left")
        parts += b"".join(told["state"][key].to_bytes(16, "little") for key in ("state", "inc"))
    return np.frombuffer(parts, "<i8").reshape(-1, 2, 2)


def drawn(states: Tensor, jumps: Tensor) -> Tensor:
    """Numbers (F, 4 n), 16 bits each as int16, that generators with `states` (F, 2, 2) draw next by
    integers(0, 65536, 4 n, np.uint16); `jumps` (n, 2, 2) are those of as many steps, four numbers to each."""
    out = torch.empty((len(states), len(jumps)), dtype=torch.int64, device=states.device)
    launch(noise.outputs, (len(states), len(jumps)), states, jumps, out)
    return out.view(torch.int16)
