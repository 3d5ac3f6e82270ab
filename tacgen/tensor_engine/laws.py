"""The laws of the cells of many scenes."""

from dataclasses import dataclass, replace

from torch import Tensor


@dataclass(frozen=True)
class Laws:
    """A law for each cell of each scene; `values` (s, e, 9): physics.laws.Coefficients; two_invariants: whether one
    depends on I2."""

    values: Tensor
    two_invariants: bool

    @classmethod
    def of(cls, values: Tensor) -> "Laws":
        return cls(values.contiguous(), bool((values[..., [1, 8]] != 0).any()))

    def replaced(self, slot: int, one: "Laws") -> "Laws":
        """With the laws of a single scene in a slot."""
        self.values[slot] = one.values[0]
        return replace(self, two_invariants=self.two_invariants or one.two_invariants)
