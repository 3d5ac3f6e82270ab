"""Hyperelastic laws as functions of invariants, so that one element kernel serves them all.

    W(F) = w(I1, I2, J) + U(J),    I1 = F:F,    I2 = (I1^2 - tr(C^2))/2,    J = det F

`iso` gives w with its first and second derivatives; `vol` gives U, U', U''. Elements with mean dilatation evaluate U
at the mean J of the element (Q1P0), all others pointwise. Shapes are whatever the invariants' shape is.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Derivatives:
    """w [MPa], first derivatives (..., 3) and second (..., 6: 11 22 33 12 13 23) in (I1, I2, J)."""

    value: Array
    first: Array
    second: Array


class Law(Protocol):
    """A hyperelastic law in invariants."""

    mu: float  # shear modulus at rest [MPa]

    def iso(self, I1: Array, I2: Array, J: Array) -> Derivatives: ...

    def vol(self, J: Array) -> tuple[Array, Array, Array]: ...


def _bulk(kappa: float, J: Array) -> tuple[Array, Array, Array]:
    """U = kappa/2 [(J^2 - 1)/2 - ln J], Simo & Taylor (1982)."""
    return kappa / 2 * ((J**2 - 1) / 2 - np.log(J)), kappa / 2 * (J - 1 / J), kappa / 2 * (1 + 1 / J**2)


@dataclass(frozen=True)
class NeoHooke:
    """Isochoric neo-Hookean, w = mu/2 (J^-2/3 I1 - 3), Bonet & Wood (2008), Eq. 6.55."""

    mu: float  # shear modulus [MPa]
    kappa: float  # bulk modulus [MPa]

    def iso(self, I1: Array, I2: Array, J: Array) -> Derivatives:
        a = J ** (-2 / 3)
        zero = np.zeros_like(J)
        first = [a, zero, -2 / 3 * a / J * I1]
        second = [zero, zero, 10 / 9 * a / J**2 * I1, zero, -2 / 3 * a / J, zero]
        half = self.mu / 2
        return Derivatives(half * (a * I1 - 3), half * np.stack(first, -1), half * np.stack(second, -1))

    def vol(self, J: Array) -> tuple[Array, Array, Array]:
        return _bulk(self.kappa, J)


LAWS = {"neo_hooke": NeoHooke}
