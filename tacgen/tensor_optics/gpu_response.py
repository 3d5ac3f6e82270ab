"""Blur and response of a camera for many pictures in one launch, by Triton; imported only where there is a GPU.

The formulas are those of optics.gaussian and optics.camera_response.
"""

import torch
import triton
import triton.language as tl
from torch import Tensor

from tacgen.optics.camera_response import RESPONSE_CELLS

RESPONSE_LANES = 256  # of a program


@triton.jit
def _averaged(PICTURES, WEIGHTS, OUT, numbers, length, step, reach, LANES: tl.constexpr):
    """Pictures averaged along one axis of so many entries, which lie `step` numbers apart; its ends go on beyond it."""
    k = tl.program_id(0).to(tl.int64) * LANES + tl.arange(0, LANES)
    there, place = k < numbers, (k // step) % length
    start = k - place * step
    total = tl.load(WEIGHTS) * tl.load(PICTURES + k, mask=there, other=0.0)
    for away in range(1, reach + 1):
        before, after = tl.maximum(place - away, 0), tl.minimum(place + away, length - 1)
        pair = tl.load(PICTURES + start + before * step, mask=there, other=0.0)
        pair += tl.load(PICTURES + start + after * step, mask=there, other=0.0)
        total += tl.load(WEIGHTS + away) * pair
    tl.store(OUT + k, total, mask=there)


def blurred(pictures: Tensor, weights: Tensor) -> Tensor:
    """Pictures (F, H, W, 3) averaged down and across by weights (n,) of the distances 0 to n - 1 [px]."""
    _, height, width, colours = pictures.shape
    for length, step in ((height, width * colours), (width, colours)):
        out, count = torch.empty_like(pictures), pictures.numel()
        _averaged[triton.cdiv(count, RESPONSE_LANES),](
            pictures, weights, out, count, length, step, len(weights) - 1, RESPONSE_LANES
        )
        pictures = out
    return pictures


@triton.jit
def _counted(
    RADIANCE, MIX, FALL, GRAIN, DRAWN, QUANTILES, STEPS, COUNTS, OUT, pixels, numbers, NOISY: tl.constexpr,
    CELLS: tl.constexpr, LANES: tl.constexpr,
):  # fmt: skip
    """camera_response.develop of pictures (F, pixels, 3). FALL: exposure times the fall-off; GRAIN: shot and read noise
    of each colour, and their strength; DRAWN (F, numbers)."""
    k, frame = tl.program_id(0) * LANES + tl.arange(0, LANES), tl.program_id(1).to(tl.int64)
    there, at = k < pixels, 3 * (frame * pixels + k)
    red = tl.load(RADIANCE + at, mask=there, other=0.0).to(tl.float64)
    green = tl.load(RADIANCE + at + 1, mask=there, other=0.0).to(tl.float64)
    blue = tl.load(RADIANCE + at + 2, mask=there, other=0.0).to(tl.float64)
    for c in tl.static_range(3):
        M = MIX + 9 * frame + 3 * c
        signal = red * tl.load(M) + green * tl.load(M + 1) + blue * tl.load(M + 2)
        signal *= tl.load(FALL + 3 * k + c, mask=there, other=0.0)
        if NOISY:
            shot, read = tl.load(GRAIN + c), tl.load(GRAIN + 3 + c)
            spread = tl.sqrt(shot * tl.minimum(tl.maximum(signal, 0.0), 1.0) + read * read) * tl.load(GRAIN + 6)
            drawn = tl.load(DRAWN + frame * numbers + 3 * k + c, mask=there, other=0).to(tl.int32) & 0xFFFF
            signal += spread * tl.load(QUANTILES + drawn)
        signal = tl.where(signal > 0.0, tl.minimum(signal, 1.0), 0.0)
        cell = (signal * CELLS).to(tl.int32)
        count = tl.load(COUNTS + cell).to(tl.int32) + (signal >= tl.load(STEPS + cell)).to(tl.int32)
        tl.store(OUT + at + c, count.to(tl.uint8), mask=there)


def counted(
    radiance: Tensor, mix: Tensor, fall: Tensor, grain: Tensor, drawn: Tensor, quantiles: Tensor, steps: Tensor,
    counts: Tensor,
) -> Tensor:  # fmt: skip
    """8-bit pictures (F, H, W, 3) of radiance (F, H, W, 3) by a mix (F, 3, 3) of its colours.

    fall (H, W, 3): exposure times fall-off; grain (7,): shot and read noise of each colour, and their strength; drawn
    (F, 3 H W or more): numbers of quantiles, or (F, 0) without noise; steps, counts: see optics.camera_response.
    """
    (frames, height, width, _), numbers = radiance.shape, drawn.shape[1]
    out = torch.empty(radiance.shape, dtype=torch.uint8, device=radiance.device)
    grid = triton.cdiv(height * width, RESPONSE_LANES), frames
    _counted[grid](
        radiance, mix, fall, grain, drawn, quantiles, steps, counts, out, height * width, numbers, numbers > 0,
        RESPONSE_CELLS,
        RESPONSE_LANES,
    )  # fmt: skip
    return out
