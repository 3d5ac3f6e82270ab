"""Numbers of a camera's noise as NumPy's PCG64 draws them, as a Warp kernel.

PCG64 is O'Neill's PCG XSL RR 128/64 (PCG: A Family of Simple Fast Space-Efficient Statistically Good Algorithms for
Random Number Generation, 2014): a linear congruential generator of 128 bits, which jumps any number of steps ahead at
once (F. Brown, Random Number Generation with Arbitrary Strides, 1994). So each step is computed by itself.
"""

import warp as wp

HALF_BITS = wp.constant(wp.uint64(32))
LOW_HALF = wp.constant(wp.uint64(0xFFFFFFFF))  # of 64 bits
TURN_BITS = wp.constant(wp.uint64(58))  # place of the output's turn in the high half of a state
WORD_BITS = wp.constant(wp.uint64(64))
MOST_TURN = wp.constant(wp.uint64(63))
Long = wp.types.vector(length=2, dtype=wp.uint64)  # low and high half of 128 bits


@wp.func
def high_product(a: wp.uint64, b: wp.uint64) -> wp.uint64:
    """The high half of a product of 128 bits."""
    low, high, other_low, other_high = a & LOW_HALF, a >> HALF_BITS, b & LOW_HALF, b >> HALF_BITS
    middle = high * other_low + ((low * other_low) >> HALF_BITS)
    beside = low * other_high + (middle & LOW_HALF)
    return high * other_high + (middle >> HALF_BITS) + (beside >> HALF_BITS)


@wp.func
def product(a: Long, b: Long) -> Long:
    """A product mod 2^128."""
    return Long(a[0] * b[0], high_product(a[0], b[0]) + a[0] * b[1] + a[1] * b[0])


@wp.kernel(enable_backward=False, module="tacgen.optics")
def outputs(states: wp.array2d(dtype=Long), jumps: wp.array2d(dtype=Long), out: wp.array2d(dtype=wp.uint64)):
    """Outputs (f, n), of four numbers of 16 bits each, that generators draw next.

    states (f, 2): their states and increments; jumps (n, 2): factors A and C, with which k + 1 steps lead to
    A state + C increment mod 2^128.
    """
    f, k = wp.tid()
    stepped, added = product(jumps[k, 0], states[f, 0]), product(jumps[k, 1], states[f, 1])
    low = stepped[0] + added[0]
    high = stepped[1] + added[1] + wp.where(low < added[0], wp.uint64(1), wp.uint64(0))  # with the carry
    mixed, turn = high ^ low, high >> TURN_BITS
    out[f, k] = (mixed >> turn) | (mixed << ((WORD_BITS - turn) & MOST_TURN))
