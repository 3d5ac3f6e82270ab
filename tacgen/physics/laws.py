"""Hyperelastic laws as functions of invariants, so that the kernels of elements serve all of them.

    W(F) = w(I1, I2, J) + U(J),    I1 = F:F,    I2 = (I1^2 - tr(C^2))/2,    J = det F

The shipped laws are one formula of eight coefficients [MPa], so that cells of a batch may have different laws:

    w = c10 y + c20 y^2 + c30 y^3 + c01 (J^-4/3 I2 - 3) + raw (I1 - 3),    y = J^-2/3 I1 - 3
    U = kappa/2 [(J^2 - 1)/2 - ln J] + lam/2 (J - 1)^2 - slope (J - 1)

See fem.materials for their names and sources. W is 0 at rest. A law of another formula has a number of its own, the
last of its coefficients, by which `isochoric` and `volumetric` branch.
"""

from typing import Any

import warp as wp

from tacgen.physics.types import real

Coefficients = wp.types.vector(length=9, dtype=real)  # c10, c01, c20, c30, raw, kappa, lam, slope [MPa], formula [-]
TWO_THIRDS = wp.constant(real(2 / 3))
TEN_NINTHS = wp.constant(real(10 / 9))
TWENTY_EIGHT_NINTHS = wp.constant(real(28 / 9))
# J below which the barrier against inversion acts; without inversion J stays near 1 in a nearly incompressible gel [-]
INVERSION_BARRIER_J0 = 0.6
J0 = wp.constant(real(INVERSION_BARRIER_J0))


def two_invariants(laws: Any) -> bool:
    """Whether one of the laws (..., 9) of an array of NumPy or PyTorch depends on I2."""
    return bool((laws[..., [1, 8]] != 0).any())


@wp.struct
class Derivatives:
    """w [MPa] and its derivatives in (I1, I2, J): `w1` is dw/dI1, `w13` is d2w/dI1 dJ."""

    value: real
    w1: real
    w2: real
    w3: real
    w11: real
    w22: real
    w33: real
    w12: real
    w13: real
    w23: real


@wp.func
def polynomial(law: Coefficients, I1: real, I2: real, J: real) -> Derivatives:
    """The isochoric part of the shipped laws."""
    c10, c01, c20, c30, raw = law[0], law[1], law[2], law[3], law[4]
    a = wp.exp(-TWO_THIRDS * wp.log(J))
    b = a * a
    y = a * I1 - real(3.0)
    y3, y13 = -TWO_THIRDS * a / J * I1, -TWO_THIRDS * a / J
    dw = (real(3.0) * c30 * y + real(2.0) * c20) * y + c10
    ddw = real(6.0) * c30 * y + real(2.0) * c20
    d = Derivatives()
    d.value = ((c30 * y + c20) * y + c10) * y + c01 * (b * I2 - real(3.0)) + raw * (I1 - real(3.0))
    d.w1 = dw * a + raw
    d.w2 = c01 * b
    d.w3 = dw * y3 - real(2.0) * TWO_THIRDS * c01 * b * I2 / J
    d.w11 = ddw * a * a
    d.w13 = ddw * a * y3 + dw * y13
    d.w23 = -real(2.0) * TWO_THIRDS * c01 * b / J
    d.w33 = ddw * y3 * y3 + (TEN_NINTHS * dw * a * I1 + TWENTY_EIGHT_NINTHS * c01 * b * I2) / (J * J)
    return d


@wp.func
def isochoric(law: Coefficients, I1: real, I2: real, J: real) -> Derivatives:
    return polynomial(law, I1, I2, J)


@wp.func
def log1p(e: real) -> real:
    """log(1 + e) exact to rounding, by the rounded sum (Kahan)."""
    u = real(1.0) + e
    return wp.where(u == real(1.0), e, wp.log(u) * e / wp.where(u == real(1.0), real(1.0), u - real(1.0)))


@wp.func
def volumetric(law: Coefficients, J: real) -> wp.vec3d:
    """U [MPa], U' and U'': Simo & Taylor (1982), and the terms of Smith, de Goes & Kim (2018)."""
    kappa, lam, slope = law[5], law[6], law[7]
    e = J - real(1.0)
    U = real(0.5) * kappa * (e + real(0.5) * e * e - log1p(e)) + real(0.5) * lam * e * e - slope * e
    dU = real(0.5) * kappa * (J - real(1.0) / J) + lam * e - slope
    return wp.vec3d(U, dU, real(0.5) * kappa * (real(1.0) + real(1.0) / (J * J)) + lam)


@wp.func
def clamped_log(J: real) -> wp.vec3d:
    """The barrier against inversion over its stiffness: U = -(1 - J/J0)^2 ln(J/J0) below J0, 0 above; U' and U''.

    It is the clamped logarithm of IPC (Li et al. 2020) as a function of J, and C2 at J0.
    """
    s = wp.min(J / J0, real(1.0))
    log, r = wp.log(s), real(1.0) - s
    first = real(2.0) * r * log - r * r / s
    second = -real(2.0) * log + real(4.0) * r / s + (r / s) * (r / s)
    return wp.vec3d(-r * r * log, first / J0, second / (J0 * J0))
