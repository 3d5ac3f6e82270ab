"""Elements of scenes that share their numbering, and the barrier against inversion on them, as the kernels take them.

Arrays have the scene first, as in physics.elements, and are NumPy's of one scene or PyTorch's of many.
"""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import warp as wp

from tacgen.physics import elements
from tacgen.physics.runtime import empty, lanes, launch, room, run
from tacgen.physics.tangents import Tangents, double

Array = np.ndarray
ONLY_SCENE = np.zeros(1, np.int32)  # the slots of a call for one scene


def around(conn: Array, nodes: int) -> tuple[Array, Array]:
    """The cells of each node of conn (e, a): rows first[n] to first[n + 1] of pairs of a cell and a corner."""
    flat = conn.ravel()
    order = np.argsort(flat, kind="stable")
    first = np.searchsorted(flat[order], np.arange(nodes + 1)).astype(np.int32)
    return first, np.stack([order // conn.shape[1], order % conn.shape[1]], -1).astype(np.int32)


@dataclass(frozen=True)
class Numbering:
    """Cells (e, a) int32 of nodes 0 to `nodes` - 1, and the cells of each node as in `around`: first (nodes + 1,) and
    around (k, 2)."""

    cells: Any
    first: Any
    around: Any
    nodes: int

    @classmethod
    def of(cls, conn: Array) -> "Numbering":
        """The elements conn (e, a) of one scene."""
        nodes = int(conn.max(initial=-1)) + 1
        return Numbering(np.ascontiguousarray(conn, np.int32), *around(conn, nodes), nodes)

    def at_nodes(self, parts: Any) -> Any:
        """Sums (s, n, 3) of what each cell's corners have, (s, e, a, 3), in a fixed order, so that results repeat."""
        out = empty(parts, len(parts), self.nodes, 3)
        run(elements.at_nodes, out.shape[:2], parts, self.first, self.around, out)
        return out


@dataclass(frozen=True)
class Points:
    """Points of cells, of whose tangents they are: M in viscoelastic gels, eigenmatrices where they are projected, and
    U''(mean J)/volume of each cell; see physics.tangents."""

    points: Any
    memory: Any
    modes: Any
    dilatation: Any

    @classmethod
    def room(cls, like: Any, kernels: Tangents, shape: tuple[int, int], memory: Any, projection: int, d: Any) -> Self:
        """Not computed yet, of `shape` (k, q)."""
        kept = None if memory is None else room(kernels.mat, shape, like)
        return cls(
            room(kernels.Point, shape, like), kept, room(kernels.mat, (*shape, 9), like) if projection else None, d
        )

    def add(self, B: Any, slots: Any, items: Any, two: bool, entries: Array, data: Array) -> None:
        """Add d2E/dx2 to `data` at `entries` (e, 3a*3a) on a core, see tangents.cell_blocks; two: the laws depend on
        I2."""
        kernels, most = double(), elements.MAX_CORNERS
        corners, volume = (wp.empty(most, dtype=kind, device="cpu") for kind in (kernels.Corner, kernels.vec))
        K = wp.empty((most, most), dtype=kernels.mat, device="cpu")
        launch(
            kernels.cell_blocks, (len(self.dilatation),), B, slots, items, self.points, self.memory, self.modes,
            self.dilatation, two, corners, volume, K, entries, data,
        )  # fmt: skip


@dataclass(frozen=True)
class Cells:
    """Elements of each scene: B (capacity, e, q, a, 3) dN/dX [1/mm], weights (capacity, e, q) [mm^3], 0 for void cells,
    and laws (capacity, e, 9), see physics.laws.Coefficients, of which one depends on `two_invariants`; slots (s,)
    int32: the scenes of a call; memory (capacity, e, q, 3, 3) and local: as in fem.elasticity.Elastic."""

    numbering: Any
    B: Any
    weights: Any
    laws: Any
    two_invariants: bool
    slots: Any
    memory: Any = None
    local: float = 0.0

    def rows(self, slots: Any) -> Self:
        """Only some scenes (r,)."""
        return replace(self, slots=slots.int())

    def deformation(self, x: Any) -> Any:
        """F (s, e, q, 3, 3) at positions x (s, n, 3)."""
        e, q = self.weights.shape[1:]
        F, threads = empty(x, len(x), e, q, 3, 3), lanes(x, q)
        run(elements.deformation, (len(x), e, threads), x, self.numbering.cells, self.B, self.slots, threads, F)
        return F

    def states(self, F: Any, want: bool, J: Any = None, taken: Any = None) -> tuple[Any, Any, Any]:
        """Energies (s, e) and, if wanted, J (s, e, q) and weights times P at F (s, e, q, 3, 3), as elements.states has
        them; with a predicted J and the F of the tangent (capacity, ...) those of the mixed pressure."""
        shape, energy = F.shape[:3], empty(F, *F.shape[:2])
        found, stress = (empty(F, *shape), empty(F, *F.shape)) if want else (empty(F, 0, 0, 0), None)
        run(
            elements.states, shape[:2], F, self.weights, self.laws, self.slots, self.local, self.memory, J, taken,
            energy, found, stress,
        )  # fmt: skip
        return energy, found, stress

    def isochoric_stress(self, x: Any) -> Any:
        """s (s, e, q, 3, 3) [MPa] at positions x (s, n, 3), see fem.viscoelasticity."""
        F = self.deformation(x)
        out = empty(F, *F.shape)
        run(elements.isochoric_stresses, F.shape[:3], F, self.laws, self.slots, out)
        return out

    def forces(self, stress: Any) -> Any:
        """Nodal forces (s, n, 3) [N] of weights times P (s, e, q, 3, 3)."""
        (s, e), a = stress.shape[:2], self.B.shape[3]
        corners, threads = empty(stress, s, e, a, 3), lanes(stress, a)
        run(elements.corner_forces, (s, e, threads), stress, self.B, self.slots, threads, corners)
        return self.numbering.at_nodes(corners)

    def linearised(self, F: Any, to: Any, taken: Any) -> Any:
        """J (s, e, q) at F = `to`, to first order from J at F, linearised at `taken` (capacity, e, q, 3, 3)."""
        J = empty(F, *F.shape[:3])
        run(elements.predictions, J.shape, F, to, taken, self.slots, J)
        return J

    def points(self, F: Any, kernels: Tangents, dilatation: Any, J: Any, projection: int) -> Points:
        """The points of tangents at F (s, e, q, 3, 3), with the pressure at the predicted J (capacity, e, q) if given;
        dilatation: room for that of all cells."""
        s, e, q = F.shape[:3]
        out = Points.room(F, kernels, (s * e, q), self.memory, projection, dilatation)
        launch(
            kernels.points, (s * e,), F, self.weights, self.laws, self.slots, None, self.local, self.memory, J,
            projection, out.points, out.memory, out.modes, dilatation,
        )  # fmt: skip
        return out


@dataclass(frozen=True)
class Folds:
    """The barrier against inversion: dN (q, a, 3) where it looks; det(dX/dxi) there at rest (capacity, e, q), the
    largest of a cell, and the stiffness times a point's volume (capacity, e) [N mm], 0 for void cells; slots (s,)
    int32: the scenes of a call."""

    numbering: Any
    dN: Any
    rest: Any
    most: Any
    stiffness: Any
    slots: Any

    def rows(self, slots: Any) -> Self:
        """Only some scenes (r,)."""
        return replace(self, slots=slots.int())

    def found(self, x: Any, want: bool, items: Any = None) -> tuple[Any, Any]:
        """Energies (k,) of all cells of scenes at x (s, n, 3), or of some, see elements.item; and, if wanted, forces
        (k, a, 3) on their corners."""
        count = len(x) * self.rest.shape[1] if items is None else len(items)
        energy, forces = empty(x, count), empty(x, count, self.dN.shape[1], 3) if want else None
        run(elements.folds, (count,), x, *self._arrays, self.most, self.stiffness, self.slots, items, energy, forces)
        return energy, forces

    def lowest(self, x: Any) -> Any:
        """The lowest J of each cell (s, e) at the dense points, or a bound of at least J0."""
        low = empty(x, len(x), self.rest.shape[1])
        run(elements.lowest, low.shape, x, *self._arrays, self.most, self.slots, low)
        return low

    def points(self, x: Any, kernels: Tangents, items: Any, dilatation: Any, projection: int) -> Points:
        """The points of the tangents of some cells, items (k, 2); dilatation: zeros (k,), or None."""
        out = Points.room(x, kernels, (len(items), len(self.dN)), None, projection, dilatation)
        launch(
            kernels.folding_points, (len(items),), x, *self._arrays, self.stiffness, self.slots, items, projection,
            out.points, out.modes,
        )  # fmt: skip
        return out

    @property
    def _arrays(self) -> tuple[Any, ...]:
        return self.numbering.cells, self.dN, self.rest
