"""Access to flat arrays without Warp's test for negative indices, which costs a core up to half the time of a loop.

Loops that have no effect on time may index arrays as usual. `while` loops are vectorised, those over ranges are not.
"""

import warp as wp

from tacgen.physics.types import real


@wp.func
def is_nan(x: real) -> bool:
    """`wp.isnan`, which a core calls as a function of C."""
    return x != x


READ, WRITE = "return data.data[i];", "data.data[i] = value;"


@wp.func_native(READ)
def get(data: wp.array(dtype=real), i: int) -> real: ...


@wp.func_native(READ)
def get(data: wp.array(dtype=wp.float32), i: int) -> wp.float32: ...  # noqa: F811


@wp.func_native(READ)
def get(data: wp.array(dtype=wp.int32), i: int) -> wp.int32: ...  # noqa: F811


@wp.func_native(READ)
def get(data: wp.array(dtype=wp.int64), i: int) -> wp.int64: ...  # noqa: F811


@wp.func_native(READ)
def get(data: wp.array(dtype=wp.vec2d), i: int) -> wp.vec2d: ...  # noqa: F811


@wp.func_native(READ)
def get(data: wp.array(dtype=wp.vec3d), i: int) -> wp.vec3d: ...  # noqa: F811


@wp.func_native(READ)
def get(data: wp.array(dtype=wp.vec3i), i: int) -> wp.vec3i: ...  # noqa: F811


@wp.func_native(WRITE)
def put(data: wp.array(dtype=real), i: int, value: real): ...


@wp.func_native(WRITE)
def put(data: wp.array(dtype=wp.float32), i: int, value: wp.float32): ...  # noqa: F811


@wp.func_native(WRITE)
def put(data: wp.array(dtype=wp.int32), i: int, value: wp.int32): ...  # noqa: F811


@wp.func_native(WRITE)
def put(data: wp.array(dtype=wp.vec2d), i: int, value: wp.vec2d): ...  # noqa: F811


@wp.func_native(READ)
def get(data: wp.array(dtype=wp.uint8), i: int) -> wp.uint8: ...  # noqa: F811


@wp.func_native(READ)
def get(data: wp.array(dtype=wp.uint16), i: int) -> wp.uint16: ...  # noqa: F811


@wp.func_native(READ)
def get(data: wp.array(dtype=wp.vec3), i: int) -> wp.vec3: ...  # noqa: F811


@wp.func_native(WRITE)
def put(data: wp.array(dtype=wp.uint8), i: int, value: wp.uint8): ...  # noqa: F811


@wp.func_native(WRITE)
def put(data: wp.array(dtype=wp.vec3d), i: int, value: wp.vec3d): ...  # noqa: F811
