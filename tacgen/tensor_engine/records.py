"""The contact of a batch of scenes as kernels take it."""

from dataclasses import dataclass

from torch import Tensor

from tacgen.tensor_engine.shapes import Shapes


@dataclass(frozen=True)
class Forces:
    """Contact at given positions: gap (s, f, q) [mm], `at` and normal (s, f, q, 3), normal force N (s, f, q) [N], force
    on the gel (s, f, q, 3) [N], its negative derivative `tangent` (s, f, q, 3, 3), and `definite`; see
    mechanics.coupled.ContactForces."""

    gap: Tensor
    at: Tensor
    normal: Tensor
    N: Tensor
    force: Tensor
    tangent: Tensor
    definite: Tensor

    @property
    def total(self) -> Tensor:
        """Sum of the normal forces (s,) [N]."""
        return self.N.sum((1, 2))

    @property
    def mean_gap(self) -> Tensor:
        """Force-weighted mean gap (s,) [mm]; 0 without contact."""
        return (self.N * self.gap).sum((1, 2)) / self.total.clamp(min=1e-300)


@dataclass(frozen=True)
class ContactArrays:
    """Facets and the indenter of each scene.

    conn (s, f, 4) node numbers; N (q, 4); areas (s, f, q), 0 where a facet does not exist; rotation
    (s, 3, 3) and position (s, 3) of the indenter; (s,): dhat and offset [mm], kappa [MPa], friction, slip length eps
    [mm]; anchor (s, f, q, 3) in the sensor's frame; on a GPU, of each node `ends` (s, n, 4): the facet of which it is a
    certain corner, -1 if none, if the facets are not those of the whole face.
    """

    shapes: Shapes
    conn: Tensor
    N: Tensor
    areas: Tensor
    rotation: Tensor
    position: Tensor
    dhat: Tensor
    kappa: Tensor
    offset: Tensor
    friction: Tensor
    eps: Tensor
    anchor: Tensor
    ends: Tensor | None = None
