"""The response of a camera, as Warp functions and kernels."""

import warp as wp

from tacgen.physics.flat import get, put
from tacgen.physics.types import Bytes, Matrices, Reals, Singles, Vectors, real

RESPONSE_CELLS = 4096  # of the light from 0 to 1: fine enough for no more than one step between counts in each
CELLS = wp.constant(real(RESPONSE_CELLS))
PIXELS_PER_THREAD = 32  # that a core counts together


@wp.func
def deviation(light: real, shot: real, read: real) -> real:
    """Standard deviation of a linear signal over full scale by white noise of variance shot x signal + read^2.

    A normal distribution approximates Poisson's well, since a full pixel has thousands of electrons.
    """
    return wp.sqrt(shot * wp.clamp(light, real(0.0), real(1.0)) + read * read)


def _counted(lanes: int) -> wp.Kernel:
    """The kernel with so many pixels by each thread: on a core the loops over them are vectors."""
    Lanes = wp.types.vector(length=lanes, dtype=real)

    @wp.kernel(enable_backward=False, module="tacgen.optics")
    def counted(
        radiance: Singles, mix: Matrices, fall: Reals, grain: Vectors, strength: real, drawn: wp.array(dtype=wp.uint16),
        numbers: int, quantiles: Singles, steps: Reals, counts: Bytes, out: Bytes,
    ):  # fmt: skip
        """optics.camera_response.develop of pictures (f pixels 3,): counts of light clipped to [0, 1] by `steps` and
        `counts` of a response's cells.

        mix (f,): from the radiance's colours to the camera's; fall (pixels 3,): exposure times fall-off; grain (2,):
        shot and read noise of the colours, times `strength`; drawn (f numbers,): its quantiles; no row: none.
        """
        f, start = wp.tid()
        noisy, pixels, mixed = drawn.shape[0] > 0, fall.shape[0] / 3, mix[f]
        first = start * lanes
        count = wp.min(lanes, pixels - first)
        light, spread = Lanes(), Lanes()
        for c in range(3):
            red, green, blue = mixed[c, 0], mixed[c, 1], mixed[c, 2]
            i, at = int(0), 3 * (f * pixels + first)
            while i < count:
                seen = red * real(get(radiance, at)) + green * real(get(radiance, at + 1))
                seen += blue * real(get(radiance, at + 2))
                light[i] = seen * get(fall, 3 * (first + i) + c)
                at += 3
                i += 1
            if noisy:
                shot, read = grain[0][c], grain[1][c]
                i = int(0)
                while i < lanes:
                    spread[i] = strength * deviation(light[i], shot, read)
                    i += 1
                i, at = int(0), f * numbers + 3 * first + c
                while i < count:
                    light[i] = light[i] + spread[i] * real(get(quantiles, int(get(drawn, at))))
                    at += 3
                    i += 1
            i, at = int(0), 3 * (f * pixels + first) + c
            while i < count:
                one = wp.where(light[i] > real(0.0), wp.min(light[i], real(1.0)), real(0.0))  # 0 of nan, too
                cell = int(one * CELLS)
                put(out, at, get(counts, cell) + wp.where(one >= get(steps, cell), wp.uint8(1), wp.uint8(0)))
                at += 3
                i += 1

    return counted


counted, counted_singly = _counted(PIXELS_PER_THREAD), _counted(1)  # for a core and for a GPU


@wp.kernel(enable_backward=False, module="tacgen.optics")
def averaged(pictures: Singles, weights: Singles, length: int, step: int, out: Singles):
    """Pictures (n,) averaged along one axis of so many entries, `step` numbers apart, by weights of the distances 0 to
    m - 1 as filters.blurred; a thread for each number."""
    k = wp.tid()
    place = (k / step) % length
    start = k - place * step
    total = weights[0] * pictures[k]
    for away in range(1, weights.shape[0]):
        before, after = wp.max(place - away, 0), wp.min(place + away, length - 1)
        total += weights[away] * (pictures[start + before * step] + pictures[start + after * step])
    out[k] = total
