"""The shipped hyperelastic laws as one formula with eight numbers, so that a batch may mix them.

    w = c10 y + c20 y^2 + c30 y^3 + c01 (J^-4/3 I2 - 3) + raw (I1 - 3),    y = J^-2/3 I1 - 3
    U = kappa/2 [(J^2 - 1)/2 - ln J] + lam/2 (J - 1)^2 - slope (J - 1)

See fem.materials for the laws and their sources.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from tacgen.fem.folding_barrier import J0

NUMBERS = 8  # c10, c01, c20, c30, raw, kappa, lam, slope [MPa]


@dataclass(frozen=True)
class Laws:
    """A law for each cell of each scene; `values` (8, s, e, 1) [MPa]; two_invariants: whether one depends on I2."""

    values: Tensor
    two_invariants: bool

    @classmethod
    def of(cls, values: Tensor) -> "Laws":
        return cls(values.contiguous(), bool((values[1] != 0).any()))

    def rows(self, slots: Tensor) -> "Laws":
        """Only some scenes (r,)."""
        return replace(self, values=self.values[:, slots])

    def replaced(self, slot: int, one: "Laws") -> "Laws":
        """With the laws of a single scene in a slot."""
        self.values[:, slot] = one.values[:, 0]
        return replace(self, two_invariants=self.two_invariants or one.two_invariants)


def isochoric(values: Tensor, I1: Tensor, I2: Tensor, J: Tensor) -> tuple[Tensor, list[Tensor], list[Tensor]]:
    """w and its derivatives in (I1, I2, J), 3 first and 6 second (11 22 33 12 13 23), each (s, e, q); values
    (8, s, e, 1)."""
    c10, c01, c20, c30, raw = values[:5]
    a = J ** (-2 / 3)
    b, y, zero = a * a, a * I1 - 3, torch.zeros_like(J)
    y3, y13, y33 = -2 / 3 * a / J * I1, -2 / 3 * a / J, 10 / 9 * a / J**2 * I1
    dw, ddw = (3 * c30 * y + 2 * c20) * y + c10, 6 * c30 * y + 2 * c20
    value = ((c30 * y + c20) * y + c10) * y + c01 * (b * I2 - 3) + raw * (I1 - 3)
    first = [dw * a + raw, c01 * b, dw * y3 - 4 / 3 * c01 * b * I2 / J]
    bend = ddw * y3**2 + dw * y33 + 28 / 9 * c01 * b * I2 / J**2
    return value, first, [ddw * a**2, zero, bend, zero, ddw * a * y3 + dw * y13, -4 / 3 * c01 * b / J]


def volumetric(values: Tensor, J: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """U, U' and U'' at the mean J (s, e) of the cells; values (8, s, e, 1)."""
    kappa, lam, slope = (v.squeeze(-1) for v in values[5:])
    e = J - 1
    U = kappa / 2 * (e + e**2 / 2 - torch.log1p(e)) + lam / 2 * e**2 - slope * e
    return U, kappa / 2 * (J - 1 / J) + lam * e - slope, kappa / 2 * (1 + 1 / J**2) + lam


def clamped_log(mu: Tensor, J: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The barrier against inversion U(J) of stiffness mu, with U' and U''; see fem.folding_barrier.ClampedLog."""
    s = (J / J0).clamp(max=1.0)
    ln, r = torch.log(s), 1 - s
    first, second = 2 * r * ln - r**2 / s, -2 * ln + 4 * r / s + (r / s) ** 2
    return -mu * r**2 * ln, mu / J0 * first, mu / J0**2 * second
