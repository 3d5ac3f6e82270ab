"""Names of the types of kernels' arrays, `Reals2` of two axes of numbers, `Vectors` of one of vectors; and numbers."""

import itertools
from typing import Any

import warp as wp

real = wp.float64
ZERO, HALF, ONE, TWO = (wp.constant(real(value)) for value in (0.0, 0.5, 1.0, 2.0))
Reals = wp.array(dtype=real)
Reals2 = wp.array2d(dtype=real)
Reals3 = wp.array3d(dtype=real)
Reals4 = wp.array4d(dtype=real)
Singles, Singles3, Singles4 = wp.array(dtype=wp.float32), wp.array3d(dtype=wp.float32), wp.array4d(dtype=wp.float32)
Ints, Ints2, Ints3 = wp.array(dtype=wp.int32), wp.array2d(dtype=wp.int32), wp.array3d(dtype=wp.int32)
Ints4 = wp.array4d(dtype=wp.int32)
Longs, Longs2, Longs3 = wp.array(dtype=wp.int64), wp.array2d(dtype=wp.int64), wp.array3d(dtype=wp.int64)
Vectors = wp.array(dtype=wp.vec3d)
Vectors2 = wp.array2d(dtype=wp.vec3d)
Vectors3 = wp.array3d(dtype=wp.vec3d)
Vectors4 = wp.array4d(dtype=wp.vec3d)
Matrices, Matrices2, Matrices3 = wp.array(dtype=wp.mat33d), wp.array2d(dtype=wp.mat33d), wp.array3d(dtype=wp.mat33d)
Flags, Flags2, Flags3 = wp.array(dtype=wp.bool), wp.array2d(dtype=wp.bool), wp.array3d(dtype=wp.bool)
Bytes = wp.array(dtype=wp.uint8)
SingleVectors2 = wp.array2d(dtype=wp.vec3)
Pairs, Pairs2 = wp.array(dtype=wp.vec2d), wp.array2d(dtype=wp.vec2d)
Triples = wp.array(dtype=wp.vec3i)


def in_precisions(kernel: wp.Kernel, *groups: tuple[str, ...]) -> dict[Any, wp.Kernel]:
    """A kernel by the bytes of a number of its arguments of a group; of several groups, by one number for each."""
    axes = {argument.label: argument.type.ndim for argument in kernel.adj.args if hasattr(argument.type, "ndim")}
    numbers, found = {4: wp.float32, 8: wp.float64}, {}
    for sizes in itertools.product(numbers, repeat=len(groups)):
        types = {
            name: wp.array(dtype=numbers[size], ndim=axes[name])
            for size, names in zip(sizes, groups, strict=True)
            for name in names
        }
        found[sizes[0] if len(sizes) == 1 else sizes] = wp.overload(kernel, types)
    return found
