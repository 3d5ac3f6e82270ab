"""Noise drawn on a GPU is NumPy's, number for number; without a GPU by Triton's interpreter."""

import os
from collections.abc import Iterator

import numpy as np
import pytest
from helpers.needs import needs

torch = needs("torch")
if not torch.cuda.is_available():
    os.environ["TRITON_INTERPRET"] = "1"  # read when the kernels are defined
needs("triton")

from tensor_engine.compiling import interpreted_and_compiled

from tacgen.optics import camera_response
from tacgen.tensor_optics import gpu_noise

pytestmark = pytest.mark.slow  # the interpreter and the compiler take seconds
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"


@pytest.fixture(autouse=True)
def interpreted(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with interpreted_and_compiled(monkeypatch):
        yield


def test_jumps_are_steps_one_after_the_other() -> None:
    factor, whole = 0x2360ED051FC65DA44385DF649FCCF645, 1 << 128
    table = gpu_noise.jumps(57600).astype(np.uint64)
    for k in (1, 2, 3, 1000, 57600):
        low, high, more, much = map(int, table[:, k - 1])
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
    states = torch.as_tensor(gpu_noise.states(random), device=DEVICE)
    jumps = torch.as_tensor(gpu_noise.jumps(-(-count // 4)), device=DEVICE)
    made = gpu_noise.drawn(states, jumps).cpu().numpy().view(np.uint16)
    wanted = [camera_response.drawn(each, height, width).ravel() for each in random]
    assert np.array_equal(made[:, :count], wanted)


def test_every_turn_of_the_output_is_numpys() -> None:
    """An output is turned by 0 to 63 bits, and a carry goes from the low half to the high one or does not."""
    random = np.random.default_rng(5)
    states = torch.as_tensor(gpu_noise.states([random]), device=DEVICE)
    made = gpu_noise.drawn(states, torch.as_tensor(gpu_noise.jumps(2000), device=DEVICE))
    assert np.array_equal(made[0].cpu().numpy().view(np.uint64), random.bit_generator.random_raw(2000))


def test_other_generators_are_refused() -> None:
    used = np.random.default_rng(0)
    used.integers(0, 65536, 1, np.uint16)  # half of the first output is left
    others = [np.random.Generator(np.random.PCG64DXSM(0)), np.random.Generator(np.random.Philox(0)), used, None]
    for other in others:
        with pytest.raises(ValueError, match="PCG64"):
            gpu_noise.states([np.random.default_rng(0), other])
