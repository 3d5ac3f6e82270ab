"""The response of a camera, and the numbers of its noise as NumPy's PCG64 draws them, as Warp kernels.

PCG64 is O'Neill's PCG XSL RR 128/64 (PCG: A Family of Simple Fast Space-Efficient Statistically Good Algorithms for
Random Number Generation, 2014): a linear congruential generator of 128 bits, which jumps any number of steps ahead at
once (F. Brown, Random Number Generation with Arbitrary Strides, 1994). So each step is computed by itself.
"""

import warp as wp

from tacgen.physics.flat import get, put
from tacgen.physics.laws import real

RESPONSE_CELLS = 4096  # of the light from 0 to 1: fine enough for no more than one step between counts in each
CELLS = wp.constant(real(RESPONSE_CELLS))
LOW_HALF = wp.constant(wp.uint64(0xFFFFFFFF))  # of 64 bits
PIXELS_PER_THREAD = 32  # that a core counts together
Long = wp.types.vector(length=2, dtype=wp.uint64)  # low and high half of 128 bits


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
        radiance: wp.array(dtype=wp.float32),
        mix: wp.array(dtype=wp.mat33d),
        fall: wp.array(dtype=real),
        grain: wp.array(dtype=wp.vec3d),
        strength: real,
        drawn: wp.array(dtype=wp.uint16),
        numbers: int,
        quantiles: wp.array(dtype=wp.float32),
        steps: wp.array(dtype=real),
        counts: wp.array(dtype=wp.uint8),
        out: wp.array(dtype=wp.uint8),
    ):
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


@wp.func
def high_product(a: wp.uint64, b: wp.uint64) -> wp.uint64:
    """The high half of a product of 128 bits."""
    half = wp.uint64(32)
    low, high, other_low, other_high = a & LOW_HALF, a >> half, b & LOW_HALF, b >> half
    middle = high * other_low + ((low * other_low) >> half)
    beside = low * other_high + (middle & LOW_HALF)
    return high * other_high + (middle >> half) + (beside >> half)


@wp.func
def product(a: Long, b: Long) -> Long:
    """A product mod 2^128."""
    return Long(a[0] * b[0], high_product(a[0], b[0]) + a[0] * b[1] + a[1] * b[0])


@wp.kernel(enable_backward=False, module="tacgen.optics")
def noise(states: wp.array2d(dtype=Long), jumps: wp.array2d(dtype=Long), out: wp.array2d(dtype=wp.uint64)):
    """Outputs (f, n), of four numbers of 16 bits each, that generators draw next.

    states (f, 2): their states and increments; jumps (n, 2): factors A and C, after k + 1 steps the state is
    A state + C increment mod 2^128.
    """
    f, k = wp.tid()
    stepped, added = product(jumps[k, 0], states[f, 0]), product(jumps[k, 1], states[f, 1])
    low = stepped[0] + added[0]
    high = stepped[1] + added[1] + wp.where(low < added[0], wp.uint64(1), wp.uint64(0))  # with the carry
    mixed, turn = high ^ low, high >> wp.uint64(58)
    out[f, k] = (mixed >> turn) | (mixed << ((wp.uint64(64) - turn) & wp.uint64(63)))
