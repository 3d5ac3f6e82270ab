"""The interface of all energies, and their sum. A Potential has no state."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol, runtime_checkable

import numpy as np

Array = np.ndarray


class Projection(IntEnum):
    """Whether tangents are projected to be positive semi-definite, per element or per contact point."""

    NONE = 0  # the exact second derivative
    STRAINED = 1  # only where the material is strained: near rest the exact tangent is positive definite
    FULL = 2  # everywhere


@runtime_checkable
class Potential(Protocol):
    """An energy of the nodal positions x (n, 3) [mm]."""

    def value(self, x: Array) -> float:
        """Energy [N mm]; +inf if x is not admissible."""

    def gradient(self, x: Array) -> Array:
        """dE/dx (n, 3) [N]."""

    def add_hessian(self, x: Array, data: Array, projection: Projection) -> None:
        """Add d2E/dx2 to `data`, the entries of the Pattern [N/mm]."""


@dataclass(frozen=True)
class Total:
    """The sum of several potentials."""

    parts: tuple[Potential, ...]

    def value(self, x: Array) -> float:
        return sum(part.value(x) for part in self.parts)

    def gradient(self, x: Array) -> Array:
        total = np.zeros_like(x)
        for part in self.parts:
            total += part.gradient(x)
        return total

    def add_hessian(self, x: Array, data: Array, projection: Projection) -> None:
        for part in self.parts:
            part.add_hessian(x, data, projection)
