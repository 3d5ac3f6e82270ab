"""The kernels of elements on a core, for one scene and arrays of NumPy."""

from functools import cached_property
from typing import Any

import numpy as np
import warp as wp

from tacgen.physics import elements, laws, tangents
from tacgen.physics.runtime import Launches, array, launch

Array = np.ndarray


def around(conn: Array, nodes: int) -> tuple[Array, Array]:
    """The cells of each node of conn (e, a): rows first[n] to first[n + 1] of pairs of a cell and a corner."""
    flat = conn.ravel()
    order = np.argsort(flat, kind="stable")
    first = np.searchsorted(flat[order], np.arange(nodes + 1)).astype(np.int32)
    return first, np.stack([order // conn.shape[1], order % conn.shape[1]], -1).astype(np.int32)


class Cells:
    """Elements conn (e, a) with dN/dX (e, q, a, 3) [1/mm] and weights (e, q) [mm^3]."""

    def __init__(self, conn: Array, gradients: Array, weights: Array) -> None:
        self.launch, self._laws = Launches(), dict[tuple[float, ...], Any]()
        self.shape, self.nodes = weights.shape, int(conn.max(initial=-1)) + 1
        self.conn, self.B = array(np.ascontiguousarray(conn, np.int32), wp.int32), array(gradients[None], wp.vec3d)
        self.weights, self.rows = array(weights[None], wp.float64), array(np.zeros(1, np.int32), wp.int32)
        self._conn = conn

    @cached_property
    def around(self) -> tuple[Any, Any]:
        first, pairs = around(self._conn, self.nodes)
        return array(first, wp.int32), array(pairs, wp.int32)

    def laws(self, law: Array) -> Any:
        """One law (9,) for all cells, as `states` and `add_tangent` take it."""
        key = tuple(law)
        if key not in self._laws:
            self._laws[key] = array(np.tile(law, (1, self.shape[0], 1)), laws.Coefficients)
        return self._laws[key]

    def deformation(self, x: Array) -> Array:
        """F (e, q, 3, 3) at positions x (n, 3)."""
        F = np.empty((1, *self.shape, 3, 3))
        self.launch(elements.deformation, (1, self.shape[0], 1), x[None], self.conn, self.B, self.rows, 1, F)
        return np.asarray(F[0])

    def states(
        self, F: Array, made_of: Any, local: float, memory: Array | None, mixed: tuple[Array, Array] | None = None
    ) -> tuple[Array, Array, Array]:
        """Energies (e,) [N mm], J (e, q), and weights times P (e, q, 3, 3) [N mm] at F.

        mixed: the predicted J and the F of the tangent, as for elements.states.
        """
        e, q = self.shape
        energy, J, stress = np.empty((1, e)), np.empty((1, e, q)), np.empty((1, e, q, 3, 3))
        predicted, taken = (None, None) if mixed is None else (part[None] for part in mixed)
        memory = None if memory is None else memory[None]
        self.launch(
            elements.states, (1, e), F[None], self.weights, made_of, self.rows, local, memory, predicted, taken,
            energy, J, stress,
        )  # fmt: skip
        return energy[0], J[0], stress[0]

    def isochoric_stress(self, F: Array, made_of: Any) -> Array:
        """See elements.isochoric_stresses; (e, q, 3, 3)."""
        out = np.empty((1, *F.shape))
        self.launch(elements.isochoric_stresses, out.shape[:3], F[None], made_of, self.rows, out)
        return np.asarray(out[0])

    def forces(self, stress: Array, nodes: int) -> Array:
        """dE/dx (nodes, 3) [N] of weights times P."""
        out = np.zeros((1, nodes, 3))
        corners = np.empty((1, *self._conn.shape, 3))
        self.launch(elements.corner_forces, (1, len(self._conn), 1), stress[None], self.B, self.rows, 1, corners)
        self.launch(elements.at_nodes, (1, self.nodes), corners, *self.around, out)
        return np.asarray(out[0])

    def predicted(self, F: Array, to: Array, taken: Array) -> Array:
        """J (e, q) at F = `to`, to first order from J at F, linearised at `taken`."""
        J = np.empty((1, *self.shape))
        self.launch(elements.predictions, J.shape, F[None], to[None], taken[None], self.rows, J)
        return np.asarray(J[0])

    def add_tangent(
        self, F: Array, made_of: Any, local: float, memory: Array | None, predicted: Array | None, two: bool,
        projection: int, entries: Array, data: Array,
    ) -> None:  # fmt: skip
        """Add d2E/dx2 to `data` at `entries` (e, 3a*3a), see tangents.cell_blocks; two: the laws depend on I2."""
        (e, q), kernels = self.shape, tangents.double()
        points = wp.empty((e, q), dtype=kernels.Point, device="cpu")
        kept = None if memory is None else wp.empty((e, q), dtype=kernels.mat, device="cpu")
        modes = wp.empty((e, q, 9), dtype=kernels.mat, device="cpu") if projection else None
        dilatation = np.empty(e)
        launch(
            kernels.points, (e,), F[None], self.weights, made_of, self.rows, None, local,
            None if memory is None else memory[None], None if predicted is None else predicted[None], projection,
            points, kept, modes, dilatation,
        )  # fmt: skip
        add_blocks(self.B, self.rows, None, points, kept, modes, dilatation, two, entries, data)


class Folds:
    """The barrier against inversion on elements conn (e, a).

    dN (q, a, 3); rest (e, q): det(dX/dxi); stiffness (e,): that of the barrier times the volume of a point [N mm].
    """

    def __init__(self, conn: Array, dN: Array, rest: Array, stiffness: Array) -> None:
        self.launch, self.shape = Launches(), conn.shape
        self.conn, self.dN = array(np.ascontiguousarray(conn, np.int32), wp.int32), array(dN, wp.vec3d)
        self.rest, self.stiffness = array(rest[None], wp.float64), array(stiffness[None], wp.float64)
        self.most = array(rest.max(1)[None], wp.float64)
        self.rows = array(np.zeros(1, np.int32), wp.int32)

    def lowest(self, x: Array) -> Array:
        """The lowest J (e,) of each cell."""
        low = np.empty((1, self.shape[0]))
        self.launch(elements.lowest, low.shape, x[None], self.conn, self.dN, self.rest, self.most, self.rows, low)
        return np.asarray(low[0])

    def below(self, x: Array) -> Array:
        """The cells (k,) that have a point with J below J0."""
        return np.flatnonzero(self.lowest(x) < laws.INVERSION_BARRIER_J0)

    def energy(self, x: Array, cells: Array) -> float:
        """Energy [N mm] of some cells (k,), inf if one is inverted."""
        energies = np.empty(len(cells))
        self._launch(x, cells, energies, None)
        return float(energies.sum())

    def forces(self, x: Array, cells: Array) -> Array:
        """Forces (k, a, 3) [N] on the corners of some cells (k,)."""
        out = np.empty((len(cells), self.shape[1], 3))
        self._launch(x, cells, np.empty(len(cells)), out)
        return out

    def _launch(self, x: Array, cells: Array, energies: Array, corners: Array | None) -> None:
        launch(
            elements.folds, (len(cells),), x[None], self.conn, self.dN, self.rest, self.most, self.stiffness,
            self.rows, _items(cells), energies, corners,
        )  # fmt: skip

    def add_tangent(self, x: Array, cells: Array, projection: int, entries: Array, data: Array) -> None:
        """Add d2E/dx2 of some cells (k,) to `data` at `entries` (e, 3a*3a)."""
        kernels, q = tangents.double(), self.dN.shape[0]
        items = _items(cells)
        points = wp.empty((len(cells), q), dtype=kernels.Point, device="cpu")
        modes = wp.empty((len(cells), q, 9), dtype=kernels.mat, device="cpu") if projection else None
        launch(
            kernels.folding_points, (len(cells),), x[None], self.conn, self.dN, self.rest, self.stiffness, self.rows,
            items, projection, points, modes,
        )  # fmt: skip
        slopes = np.broadcast_to(self.dN.numpy(), (1, self.shape[0], *self.dN.shape, 3))
        add_blocks(slopes, self.rows, items, points, None, modes, np.zeros(len(cells)), False, entries, data)


def _items(cells: Array) -> Array:
    """Cells (k,) of the only scene, as the kernels need them (k, 2)."""
    return np.stack([np.zeros_like(cells), cells], -1).astype(np.int32)


def add_blocks(
    B: Any, rows: Any, items: Any, points: Any, kept: Any, modes: Any, dilatation: Array, two: bool, entries: Array,
    data: Array,
) -> None:  # fmt: skip
    kernels = tangents.double()
    corners = wp.empty(elements.MAX_CORNERS, dtype=kernels.Corner, device="cpu")
    volume = wp.empty(elements.MAX_CORNERS, dtype=kernels.vec, device="cpu")
    K = wp.empty((elements.MAX_CORNERS, elements.MAX_CORNERS), dtype=kernels.mat, device="cpu")
    launch(
        kernels.cell_blocks, (len(dilatation),), B, rows, items, points, kept, modes, dilatation, two, corners,
        volume, K, entries, data,
    )  # fmt: skip
