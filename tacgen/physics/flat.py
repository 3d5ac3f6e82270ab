"""Access to flat arrays without Warp's test for negative indices, which costs a core up to half the time of a loop.

Loops that have no effect on time may index arrays as usual. `while` loops are vectorised, those over ranges are not.
"""

import warp as wp

from tacgen.physics.types import real

READ_TYPES = real, wp.float32, wp.int32, wp.int64, wp.vec2d, wp.vec3d, wp.vec3i, wp.uint8, wp.uint16, wp.vec3
WRITTEN_TYPES = real, wp.float32, wp.int32, wp.vec2d, wp.uint8, wp.vec3d


@wp.func
def is_nan(x: real) -> bool:
    """`wp.isnan`, which a core calls as a function of C."""
    return x != x


for kind in READ_TYPES:  # a function of one name for each, of which Warp chooses by types

    @wp.func_native("return data.data[i];")
    def get(data: wp.array(dtype=kind), i: int) -> kind: ...


for kind in WRITTEN_TYPES:

    @wp.func_native("data.data[i] = value;")
    def put(data: wp.array(dtype=kind), i: int, value: kind): ...
