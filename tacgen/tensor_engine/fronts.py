"""Fronts of the batched multifrontal method and their factors, as records of arrays."""

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Fronts:
    """Where the numbers of fronts (t, w own nodes, m others) come from, of which the lower triangle is summed.

    places (b, t, arity, w + m): the row of nodes that each node is in each of the children's updates, -1 where it is in
    none; in the first, which is there without children too, -2 where the node is padding and gets the unit matrix; b is
    1 where all matrices have the same. first, length (t, arity): where a child's update begins in the updates of the
    level below, and how long its rows are [numbers].
    entries (t, w + m, w): the matrix's own blocks, numbers of (pairs + 1), the last of which is 0.
    """

    places: Tensor
    first: Tensor
    length: Tensor
    entries: Tensor | None
    w: int

    @property
    def sizes(self) -> tuple[int, int, int]:
        """t, and the rows 3w and 3m of unknowns."""
        _, t, _, rows = self.places.shape
        return t, 3 * self.w, 3 * (rows - self.w)


@dataclass(frozen=True)
class FrontGroup:
    """Fronts of a level that are one batch: nodes own (t, w) and bound (t, m), the number of all nodes where padded;
    rows (t, arity): where a child's vectors begin in those of the level below; at, row: where the fronts' own updates
    and vectors begin in those of their level."""

    fronts: Fronts
    own: Tensor
    bound: Tensor
    rows: Tensor
    at: int
    row: int


@dataclass(frozen=True)
class Panel:
    """The factors of a group: inverses of the diagonal blocks (B, t, 3w, 3w), and the blocks below (B, t, 3m, 3w)."""

    inverse: Tensor
    below: Tensor
