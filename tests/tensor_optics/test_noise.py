"""Noise drawn by the batch is NumPy's, number for number; without a GPU on a core."""

import numpy as np
import pytest
from helpers.needs import needs

torch = needs("torch")

from tacgen.optics import camera_response
from tacgen.tensor_optics import noise

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"


def test_jumps_are_steps_one_after_the_other() -> None:
    factor, whole = 0x2360ED051FC65DA44385DF649FCCF645, 1 << 128
    table = noise.jumps(57600).astype(np.uint64)
    for k in (1, 2, 3, 1000, 57600):
        low, high, more, much = map(int, table[k - 1].ravel())
        assert (high << 64) + low == pow(factor, k, whole)
        # (factor - 1) is even and has no inverse, so the quotient is taken before the remainder
        assert (much << 64) + more == (pow(factor, k, whole * (factor - 1)) - 1) // (factor - 1)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (3, 3), (10, 12), (13, 31)])
def test_numbers_are_numpys(height: int, width: int) -> None:
    """Also for counts that are no multiple of four or need more than one program, and after other outputs."""
    count = 3 * height * width
    seeds = [0, 1, 12345, np.random.SeedSequence((7, 3, 1)), np.random.SeedSequence((2**31, 99, 1))]
    random = [np.random.default_rng(seed) for seed in seeds]
    random[1].random(5)  # whole outputs
    states = torch.as_tensor(noise.states(random).copy(), device=DEVICE)
    jumps = torch.as_tensor(noise.jumps(-(-count // 4)).copy(), device=DEVICE)
    made = noise.drawn(states, jumps).cpu().numpy().view(np.uint16)
    wanted = [camera_response.drawn(each, height, width).ravel() for each in random]
    assert np.array_equal(made[:, :count], wanted)


def test_every_turn_of_the_output_is_numpys() -> None:
    """An output is turned by 0 to 63 bits, and a carry goes from the low half to the high one or does not."""
    random = np.random.default_rng(5)
    states = torch.as_tensor(noise.states([random]).copy(), device=DEVICE)
    made = noise.drawn(states, torch.as_tensor(noise.jumps(2000).copy(), device=DEVICE))
    assert np.array_equal(made[0].cpu().numpy().view(np.uint64), random.bit_generator.random_raw(2000))


def test_other_generators_are_refused() -> None:
    used = np.random.default_rng(0)
    used.integers(0, 65536, 1, np.uint16)  # half of the first output is left
    others = [np.random.Generator(np.random.PCG64DXSM(0)), np.random.Generator(np.random.Philox(0)), used, None]
    for other in others:
        with pytest.raises(ValueError, match="PCG64"):
            noise.states([np.random.default_rng(0), other])
