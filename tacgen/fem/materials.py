"""Hyperelastic laws as functions of invariants, so that one element kernel serves all laws.

    W(F) = w(I1, I2, J) + U(J),    I1 = F:F,    I2 = (I1^2 - tr(C^2))/2,    J = det F

`iso` gives w with its first and second derivatives; `vol` gives U, U', U''. Elements with mean dilatation evaluate U
at the mean J of the element (Q1P0), others at each point. Arrays have the shape of the invariants. W is 0 at rest.
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

    @property
    def mu(self) -> float:
        """Shear modulus at rest [MPa]."""

    @property
    def kappa(self) -> float:
        """Bulk modulus at rest [MPa]."""

    def iso(self, I1: Array, I2: Array, J: Array) -> Derivatives: ...

    def vol(self, J: Array) -> tuple[Array, Array, Array]: ...


def _bulk(kappa: float, J: Array) -> tuple[Array, Array, Array]:
    """U = kappa/2 [(J^2 - 1)/2 - ln J], Simo & Taylor (1982); written in J - 1 to avoid cancellation."""
    e = J - 1
    return kappa / 2 * (e + e**2 / 2 - np.log1p(e)), kappa / 2 * (J - 1 / J), kappa / 2 * (1 + 1 / J**2)


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


@dataclass(frozen=True)
class MooneyRivlin:
    """w = c10 (J^-2/3 I1 - 3) + c01 (J^-4/3 I2 - 3): Mooney (1940) and Rivlin (1948), made isochoric."""

    c10: float  # [MPa]
    c01: float  # [MPa]
    kappa: float  # bulk modulus [MPa]

    @property
    def mu(self) -> float:
        return 2 * (self.c10 + self.c01)

    def iso(self, I1: Array, I2: Array, J: Array) -> Derivatives:
        a, b = self.c10 * J ** (-2 / 3), self.c01 * J ** (-4 / 3)
        zero = np.zeros_like(J)
        value = a * I1 + b * I2 - 3 * (self.c10 + self.c01)
        first = [a, b, (-2 / 3 * a * I1 - 4 / 3 * b * I2) / J]
        second = [zero, zero, (10 / 9 * a * I1 + 28 / 9 * b * I2) / J**2, zero, -2 / 3 * a / J, -4 / 3 * b / J]
        return Derivatives(value, np.stack(first, -1), np.stack(second, -1))

    def vol(self, J: Array) -> tuple[Array, Array, Array]:
        return _bulk(self.kappa, J)


@dataclass(frozen=True)
class Yeoh:
    """w = c10 y + c20 y^2 + c30 y^3 with y = J^-2/3 I1 - 3, Yeoh (1993), "Some forms of the strain energy function for
    rubber"."""

    c10: float  # [MPa]
    c20: float  # [MPa]
    c30: float  # [MPa]
    kappa: float  # bulk modulus [MPa]

    @property
    def mu(self) -> float:
        return 2 * self.c10

    def iso(self, I1: Array, I2: Array, J: Array) -> Derivatives:
        a = J ** (-2 / 3)
        y = a * I1 - 3
        w = ((self.c30 * y + self.c20) * y + self.c10) * y
        dw = (3 * self.c30 * y + 2 * self.c20) * y + self.c10
        ddw = 6 * self.c30 * y + 2 * self.c20
        zero = np.zeros_like(J)
        y1, y3 = a, -2 / 3 * a / J * I1  # dy/dI1, dy/dJ
        y13, y33 = -2 / 3 * a / J, 10 / 9 * a / J**2 * I1
        first = [dw * y1, zero, dw * y3]
        second = [ddw * y1**2, zero, ddw * y3**2 + dw * y33, zero, ddw * y1 * y3 + dw * y13, zero]
        return Derivatives(w, np.stack(first, -1), np.stack(second, -1))

    def vol(self, J: Array) -> tuple[Array, Array, Array]:
        return _bulk(self.kappa, J)


@dataclass(frozen=True)
class StableNeoHooke:
    """W = mu/2 (I1 - 3) + lam/2 (J - 1 - mu/lam)^2 - mu^2/(2 lam), Smith, de Goes & Kim (2018), "Stable neo-Hookean
    flesh simulation", without their logarithm, as in UIPC; the constant makes W 0 at rest. It is finite at J <= 0; the
    elements make the energy infinite there.

    `lam` is Lamé's first parameter plus mu, so that the small-strain moduli are right.
    """

    mu: float  # shear modulus [MPa]
    lam: float  # [MPa]

    @property
    def kappa(self) -> float:
        return self.lam - self.mu / 3

    def iso(self, I1: Array, I2: Array, J: Array) -> Derivatives:
        zero = np.zeros_like(J)
        half = zero + self.mu / 2
        return Derivatives(half * (I1 - 3), np.stack([half, zero, zero], -1), np.stack([zero] * 6, -1))

    def vol(self, J: Array) -> tuple[Array, Array, Array]:
        return (
            self.lam / 2 * (J - 1) ** 2 - self.mu * (J - 1),
            self.lam * (J - 1) - self.mu,
            self.lam + np.zeros_like(J),
        )


@dataclass(frozen=True)
class Stiffened:
    """Another law with w multiplied by `times` and the same U; mu and kappa are that law's own."""

    law: Law
    times: float

    @property
    def mu(self) -> float:
        return self.law.mu

    @property
    def kappa(self) -> float:
        return self.law.kappa

    def iso(self, I1: Array, I2: Array, J: Array) -> Derivatives:
        w = self.law.iso(I1, I2, J)
        return Derivatives(self.times * w.value, self.times * w.first, self.times * w.second)

    def vol(self, J: Array) -> tuple[Array, Array, Array]:
        return self.law.vol(J)


# An example of each law, all with mu = 0.05 MPa and kappa = 0.4 MPa at rest, for tests.
EXAMPLES: dict[str, Law] = {
    "neo_hooke": NeoHooke(0.05, 0.4),
    "mooney_rivlin": MooneyRivlin(0.015, 0.01, 0.4),
    "yeoh": Yeoh(0.025, -0.002, 0.0005, 0.4),
    "stable_neo_hooke": StableNeoHooke(0.05, 0.4 + 0.05 / 3),
}
