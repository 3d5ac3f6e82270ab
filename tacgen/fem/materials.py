"""Hyperelastic laws by name: their coefficients in the formula of physics.laws, and their moduli at rest."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

Array = np.ndarray


class Law(Protocol):
    """A hyperelastic law."""

    @property
    def mu(self) -> float:
        """Shear modulus at rest [MPa]."""

    @property
    def kappa(self) -> float:
        """Bulk modulus at rest [MPa]."""

    @property
    def coefficients(self) -> Array:
        """physics.laws.Coefficients (9,)."""


def polynomial(
    *, c10: float = 0.0, c01: float = 0.0, c20: float = 0.0, c30: float = 0.0, raw: float = 0.0, kappa: float = 0.0,
    lam: float = 0.0, slope: float = 0.0,
) -> Array:  # fmt: skip
    """Coefficients (9,) [MPa] of the formula of the shipped laws, see physics.laws."""
    return np.array([c10, c01, c20, c30, raw, kappa, lam, slope, 0.0])


def stiffened(laws: Any, times: Any) -> Any:
    """Coefficients (..., 9), of NumPy or PyTorch, with w multiplied by `times` (...) and the same U."""
    out = laws * 1.0
    out[..., :5] *= times[..., None]
    return out


@dataclass(frozen=True)
class NeoHooke:
    """Isochoric neo-Hookean, w = mu/2 (J^-2/3 I1 - 3), Bonet & Wood (2008), Eq. 6.55; U of Simo & Taylor (1982)."""

    mu: float  # shear modulus [MPa]
    kappa: float  # bulk modulus [MPa]

    @property
    def coefficients(self) -> Array:
        return polynomial(c10=self.mu / 2, kappa=self.kappa)


@dataclass(frozen=True)
class MooneyRivlin:
    """w = c10 (J^-2/3 I1 - 3) + c01 (J^-4/3 I2 - 3): Mooney (1940) and Rivlin (1948), made isochoric."""

    c10: float  # [MPa]
    c01: float  # [MPa]
    kappa: float  # bulk modulus [MPa]

    @property
    def mu(self) -> float:
        return 2 * (self.c10 + self.c01)

    @property
    def coefficients(self) -> Array:
        return polynomial(c10=self.c10, c01=self.c01, kappa=self.kappa)


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

    @property
    def coefficients(self) -> Array:
        return polynomial(c10=self.c10, c20=self.c20, c30=self.c30, kappa=self.kappa)


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

    @property
    def coefficients(self) -> Array:
        return polynomial(raw=self.mu / 2, lam=self.lam, slope=self.mu)


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

    @property
    def coefficients(self) -> Array:
        return np.asarray(stiffened(self.law.coefficients, np.array(self.times)))


# An example of each law, all with mu = 0.05 MPa and kappa = 0.4 MPa at rest, for tests.
EXAMPLE_LAWS: dict[str, Law] = {
    "neo_hooke": NeoHooke(0.05, 0.4),
    "mooney_rivlin": MooneyRivlin(0.015, 0.01, 0.4),
    "yeoh": Yeoh(0.025, -0.002, 0.0005, 0.4),
    "stable_neo_hooke": StableNeoHooke(0.05, 0.4 + 0.05 / 3),
}
