"""Tangents of elements, exact or projected to be positive semi-definite, as Warp kernels.

The 3 x 3 block of two corners with dN/dX = g and h is a sum over points. With the slopes of I1/2, I2/2 and J at a
corner, f = F g, t = (I1 F - F F^T F) g and c = cof(F) g, the exact one is

    4 w11 f f' + 4 w22 t t' + w33 c c' + 4 w12 (f t' + t f') + 2 w13 (f c' + c f') + 2 w23 (t c' + c t')
    + 2 (w1 + w2 I1) (g.h) 1 - w3 [F (g x h)]_x
    + 2 w2 [2 f f' - f' f - (g . F^T F h) 1 - (g.h) F F^T]

where ' marks the other corner, [v]_x w = v x w. The projected tangent adds squares of the eigenmatrices of an isotropic
energy that have negative eigenvalues (Smith, de Goes & Kim 2019, "Analytic eigensystems for isotropic distortion
energies"). In a viscoelastic gel it adds bounds of what M : F^T F / 2 can lack: with m = F M g and n = |F M|, the mixed
derivatives with J, b (m c' + c m'), are at least -b n ((g.h) 1 + c c'), and M is at least -|M| 1.

Points are computed in double precision; the sums over pairs of corners in that of `Tangents`, which is single precision
in batches.
"""

from functools import cache, partial
from typing import Any

import warp as wp

from tacgen.physics.elements import LEAST, cofactor, corners_of, item, mapped, means, near, positive_J
from tacgen.physics.laws import TWO_THIRDS, Coefficients, Derivatives, clamped_log, isochoric, volumetric
from tacgen.physics.projection import Stretches, eigenmatrix, eigenvalue, strained, stretches
from tacgen.physics.types import Ints, Ints2, Matrices3, Reals2, Reals3, Vectors2, Vectors4, real

FIVE_NINTHS = wp.constant(real(5 / 9))


class Tangents:
    """The kernels whose sums are in one precision: wp.float64 or wp.float32.

    `items`: the cells, see elements.item.
    """

    def __init__(self, r: Any, module: str) -> None:
        vec, mat = wp.types.vector(length=3, dtype=r), wp.types.matrix(shape=(3, 3), dtype=r)
        kernel = partial(wp.kernel, enable_backward=False, module=module)
        struct, func = partial(wp.struct, module=module), partial(wp.func, module=module)

        @struct
        class Point:
            """F, its cofactor, and weights times the coefficients of the module's formula."""

            F: mat
            C: mat
            ff: r
            tt: r
            cc: r
            ft: r
            fc: r
            tc: r
            mc: r
            same: r
            turn: r
            w2: r
            I1: r
            w: r
            bound: r
            negative: wp.int32

        @struct
        class Corner:
            """dN/dX of a corner, f, t and c, m: the slope of M : F^T F / 2, and their sums with coefficients."""

            g: vec
            f: vec
            t: vec
            c: vec
            m: vec
            u: vec
            z: vec
            v: vec

        @func
        def lower(A: wp.mat33d) -> mat:
            B = mat()
            for i in range(3):
                for j in range(3):
                    B[i, j] = r(A[i, j])
            return B

        @func
        def point(F: wp.mat33d, C: wp.mat33d, w: real, d: Derivatives, I1: real) -> Point:
            p = Point()
            p.F = lower(F)
            p.C = lower(C)
            p.ff = r(real(4.0) * w * (d.w11 + d.w2))
            p.tt = r(real(4.0) * w * d.w22)
            p.cc = r(w * d.w33)
            p.ft = r(real(4.0) * w * d.w12)
            p.fc = r(real(2.0) * w * d.w13)
            p.tc = r(real(2.0) * w * d.w23)
            p.same = r(real(2.0) * w * (d.w1 + d.w2 * I1))
            p.turn = r(w * d.w3)
            p.w2 = r(real(2.0) * w * d.w2)
            p.I1 = r(I1)
            p.w = r(w)
            return p

        @func
        def written(modes: wp.array3d(dtype=mat), i: int, q: int, s: Stretches, d: Derivatives, w: real) -> wp.int32:
            """Writes the eigenmatrices of negative eigenvalues, times the roots of w and of these, and counts them."""
            count = wp.int32(0)
            for n in range(9):
                value = w * eigenvalue(s, d, n)
                if value < real(0.0):
                    modes[i, q, count] = lower(wp.sqrt(-value) * eigenmatrix(s, n))
                    count += 1
            return count

        @func
        def corner(p: Point, M: mat, g: vec, two: bool, remembers: bool) -> Corner:
            o = Corner()
            o.g = g
            o.f = p.F * g
            o.c = p.C * g
            o.u = p.ff * o.f + p.fc * o.c
            o.v = p.fc * o.f + p.cc * o.c
            if two:
                o.t = p.I1 * o.f - p.F * (wp.transpose(p.F) * o.f)
                o.u += p.ft * o.t
                o.v += p.tc * o.t
                o.z = p.ft * o.f + p.tt * o.t + p.tc * o.c
            if remembers:
                o.m = p.F * (M * g)
                o.v += p.mc * o.m
            return o

        @func
        def block(p: Point, M: mat, a: Corner, b: Corner, two: bool, remembers: bool) -> mat:
            """The exact block of two corners at a point."""
            one = wp.identity(n=3, dtype=r)
            same = wp.dot(a.g, b.g)
            k = wp.outer(a.f, b.u) + wp.outer(a.c, b.v) + (p.same * same) * one
            k -= wp.skew(p.F * (p.turn * wp.cross(a.g, b.g)))
            if two:
                k += wp.outer(a.t, b.z) - p.w2 * (wp.dot(a.f, b.f) * one + wp.outer(b.f, a.f))
                k -= (p.w2 * same) * (p.F * wp.transpose(p.F))
            if remembers:
                k += (p.w * wp.dot(a.g, M * b.g)) * one + wp.outer(a.m, p.mc * b.c)
            return k

        @func
        def added(p: Point, modes: wp.array3d(dtype=mat), i: int, q: int, a: Corner, b: Corner) -> mat:
            """Added to the exact block of two corners it is the projected one."""
            k = mat()
            for n in range(p.negative):
                k += wp.outer(modes[i, q, n] * a.g, modes[i, q, n] * b.g)
            if p.bound > r(0.0):
                k += p.bound * (wp.dot(a.g, b.g) * wp.identity(n=3, dtype=r) + wp.outer(a.c, b.c))
            return k

        @kernel
        def points(
            F: Matrices3, weights: Reals3, laws: wp.array2d(dtype=Coefficients), slots: Ints, items: Ints2, local: real,
            memory: Matrices3, predicted: Reals3, projection: int, out: wp.array2d(dtype=Point),
            kept: wp.array2d(dtype=mat), modes: wp.array3d(dtype=mat), dilatation: wp.array(dtype=r),
        ):  # fmt: skip
            """Points (k, q) of elements; `kept`: their M; `dilatation` (k,): U''(mean J)/volume of each cell. With rows
            in `predicted`, with the pressure at the predicted J."""
            i = wp.tid()
            pair = item(items, i, weights.shape[1])
            s, e = pair[0], pair[1]
            slot = slots[s]
            law = laws[slot, e]
            mixed = predicted.shape[0] > 0
            mean = means(F, weights, predicted, s, slot, e)
            share = real(1.0) - local
            dilatation[i] = r(wp.where(mean[0] > real(0.0), share * volumetric(law, mean[1])[2] / mean[0], real(0.0)))
            pressure = share * volumetric(law, mean[2])[1]
            for q in range(weights.shape[2]):
                w = weights[slot, e, q]
                Fq = F[s, e, q]
                C = cofactor(Fq)
                J = positive_J(Fq)
                I1 = wp.ddot(Fq, Fq)
                d = isochoric(law, I1, wp.ddot(C, C), J)
                d.w3 += pressure
                if local > real(0.0):
                    if mixed:
                        d.w3 += local * volumetric(law, near(predicted[slot, e, q], J))[1]
                    else:
                        d.w3 += local * volumetric(law, J)[1]
                    d.w33 += local * volumetric(law, J)[2]
                M = wp.mat33d()
                if memory.shape[0] > 0:
                    M = wp.exp(-TWO_THIRDS * wp.log(J)) * memory[slot, e, q]
                    stretch = wp.ddot(Fq * M, Fq)
                    d.w3 -= stretch / (real(3.0) * J)
                    d.w33 += FIVE_NINTHS * stretch / (J * J)
                p = point(Fq, C, w, d, I1)
                p.mc = r(-TWO_THIRDS * w / J)
                if projection > 1 or (projection == 1 and strained(Fq)):
                    p.negative = written(modes, i, q, stretches(Fq, d), d, w)
                    p.bound = r(TWO_THIRDS * w / J * wp.sqrt(wp.ddot(Fq * M, Fq * M)) + w * wp.sqrt(wp.ddot(M, M)))
                out[i, q] = p
                if memory.shape[0] > 0:
                    kept[i, q] = lower(M)

        @kernel
        def folding_points(
            x: Vectors2, conn: Ints2, dN: Vectors2, rest: Reals3, stiffness: Reals2, slots: Ints, items: Ints2,
            projection: int, out: wp.array2d(dtype=Point), modes: wp.array3d(dtype=mat),
        ):  # fmt: skip
            """Points (k, q) of the barrier against inversion, in the coordinates xi; arrays as in elements.folds."""
            i = wp.tid()
            pair = item(items, i, conn.shape[0])
            s, e = pair[0], pair[1]
            k = stiffness[slots[s], e]
            at = corners_of(x, conn, s, e)
            for q in range(dN.shape[0]):
                F = mapped(at, dN, q)
                C = cofactor(F)
                whole = rest[slots[s], e, q]
                U = clamped_log(wp.max(wp.dot(F[0], C[0]) / whole, LEAST))
                d = Derivatives()
                d.w3 = U[1] / whole
                d.w33 = U[2] / (whole * whole)
                p = point(F, C, k, d, real(0.0))
                if projection > 0:
                    p.negative = written(modes, i, q, stretches(F, d), d, k)
                out[i, q] = p

        def pairs(remembers: bool) -> wp.Kernel:
            """A kernel for elastic gels and one for others, which takes more registers."""

            @kernel
            def pair_blocks(
                B: Vectors4, slots: Ints, items: Ints2, at: wp.array2d(dtype=Point), memory: wp.array2d(dtype=mat),
                modes: wp.array3d(dtype=mat), dilatation: wp.array(dtype=r), two: wp.bool, add: wp.bool, cells: int,
                K: wp.array4d(dtype=r),
            ):  # fmt: skip
                """d2E/dx2 of cells (s, e, 3 corner + direction, ...), for a GPU: a thread for each pair of corners.
                `memory`: as in `cell_blocks`, if the gel `remembers`."""
                i, number = wp.tid()
                pair = item(items, i, cells)
                s, e = pair[0], pair[1]
                a, b = number / B.shape[3], number % B.shape[3]
                k, va, vb, M = mat(), vec(), vec(), mat()
                for q in range(at.shape[1]):
                    p = at[i, q]
                    if remembers:
                        M = memory[i, q]
                    g, h = single(B[slots[s], e, q, a]), single(B[slots[s], e, q, b])
                    ca, cb = corner(p, M, g, two, remembers), corner(p, M, h, two, remembers)
                    k += block(p, M, ca, cb, two, remembers) + added(p, modes, i, q, ca, cb)
                    va += p.w * (p.C * g)
                    vb += p.w * (p.C * h)
                if dilatation.shape[0] > 0:
                    k += dilatation[i] * wp.outer(va, vb)
                for j in range(3):
                    for m in range(3):
                        if add:
                            K[s, e, 3 * a + j, 3 * b + m] = K[s, e, 3 * a + j, 3 * b + m] + k[j, m]
                        else:
                            K[s, e, 3 * a + j, 3 * b + m] = k[j, m]

            return pair_blocks

        @kernel
        def cell_blocks(
            B: Vectors4, slots: Ints, items: Ints2, at: wp.array2d(dtype=Point), memory: wp.array2d(dtype=mat),
            modes: wp.array3d(dtype=mat), dilatation: wp.array(dtype=r), two: wp.bool, corners: wp.array(dtype=Corner),
            volume: wp.array(dtype=vec), K: wp.array2d(dtype=mat), entries: Ints2, data: wp.array(dtype=r),
        ):  # fmt: skip
            """Add d2E/dx2 to the entries of a sparse matrix, for a core: a thread for each cell, one after the other.

            `entries` (e, 3a*3a): where, -1 where an entry is not stored. Work space: corners (a), volume (a), K (a, a).
            """
            i = wp.tid()
            pair = item(items, i, entries.shape[0])
            s, e = pair[0], pair[1]
            count = B.shape[3]
            remembers = memory.shape[0] > 0
            M = mat()
            for a in range(count):
                volume[a] = vec()
                for b in range(a, count):
                    K[a, b] = mat()
            for q in range(at.shape[1]):
                p = at[i, q]
                if remembers:
                    M = memory[i, q]
                for a in range(count):
                    o = corner(p, M, single(B[slots[s], e, q, a]), two, remembers)
                    corners[a] = o
                    volume[a] = volume[a] + p.w * o.c
                project = p.negative > 0 or p.bound > r(0.0)
                for a in range(count):
                    o = corners[a]
                    for b in range(a, count):
                        k = K[a, b] + block(p, M, o, corners[b], two, remembers)
                        if project:
                            k += added(p, modes, i, q, o, corners[b])
                        K[a, b] = k
            for a in range(count):
                for b in range(a, count):
                    k = K[a, b] + dilatation[i] * wp.outer(volume[a], volume[b])
                    for j in range(3):
                        for m in range(3):
                            here = entries[e, (3 * a + j) * 3 * count + 3 * b + m]
                            if here >= 0:
                                data[here] = data[here] + k[j, m]
                            if a != b:
                                there = entries[e, (3 * b + m) * 3 * count + 3 * a + j]
                                if there >= 0:
                                    data[there] = data[there] + k[j, m]

        @func
        def single(g: wp.vec3d) -> vec:
            return vec(r(g[0]), r(g[1]), r(g[2]))

        self.module, self.Point, self.Corner, self.mat, self.vec = module, Point, Corner, mat, vec
        self.points, self.folding_points = points, folding_points
        self.pair_blocks, self.cell_blocks = (pairs(False), pairs(True)), cell_blocks


@cache
def double() -> Tangents:
    return Tangents(wp.float64, "tacgen.physics")


@cache
def single() -> Tangents:
    """For batches."""
    return Tangents(wp.float32, "tacgen.physics.single")
