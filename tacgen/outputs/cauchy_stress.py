"""Cauchy stress per element and per node, and its error measures.

Nodal values come from superconvergent patch recovery (fem/stress_recovery), layer by layer. On the coated face they are
corrected to agree with the traction of the recovered nominal stress P, which preserves the force:

    sigma n da = P N dA     (Nanson)
"""

from dataclasses import dataclass, replace

import numpy as np

from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import facet_areas, facet_points
from tacgen.fem.stress_recovery import VOIGT_INDEX, Recovery
from tacgen.mechanics import Problem, State
from tacgen.mechanics.barrier import Faces

Array = np.ndarray
VOIGT_PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))  # xx yy zz yz xz xy


@dataclass(frozen=True)
class Stress:
    """Cauchy stress [MPa] in the order xx yy zz yz xz xy.

    element (e, 6): volume mean; rows (k, 6): at the recovery's rows, one for each node and layer; node (n, 6): in the
    outermost layer of each node; area (s, 3): vectors of the face's nodes [mm^2], out of the gel.
    """

    element: Array
    rows: Array
    node: Array
    area: Array


class Stresses:
    """Recovery matrices of a mesh, computed once, and the stress of its states."""

    def __init__(self, problem: Problem) -> None:
        mesh = problem.mesh
        self.problem = problem
        self.recovery = Recovery.on(mesh.points, mesh.cells, mesh.layer)
        self.face = _Face(problem.contact.faces, mesh.points)
        self._volume = np.zeros(len(mesh.cells))
        for number, elastic in enumerate(problem.elastic):
            self._volume[mesh.layer == number] = elastic.elements.weights.sum(1)

    def at(self, x: Array, elastic: tuple[Elastic, ...] = ()) -> Stress:
        """Stress at nodal positions x (n, 3); `elastic` replaces the layers' laws in a viscoelastic gel."""
        count = len(self.problem.mesh.cells)
        element, nominal = np.zeros((count, 6)), np.zeros((count, 9))
        for number, part in enumerate(elastic or self.problem.elastic):
            here, (mean, P) = self.problem.mesh.layer == number, part.mean_stress(part.evaluate(x))
            element[here], nominal[here] = voigt(mean), P.reshape(-1, 9)
        recovered = self.recovery.matrix @ np.concatenate([element, nominal], 1)
        rows, on_nodes = recovered[:, :6], self.recovery.outermost(recovered, len(x))
        node, P = on_nodes[:, :6].copy(), on_nodes[:, 6:].reshape(-1, 3, 3)
        nodes, area = self.face.nodes, self.face.vectors(x)
        size = np.linalg.norm(area, axis=1, keepdims=True)
        traction = np.einsum("nij,nj->ni", P[nodes], self.face.rest) / size
        node[nodes] = agreeing(node[nodes], area / size, traction)
        return Stress(element, rows, node, area)

    def quality(self, stress: Stress, state: State) -> dict[str, float]:
        """Difference of sigma n from the contact forces, in total and over the face, and oscillation of the pressure.

        force_error: |sum of sigma n da - force| / |force|, with n da the area vectors of the nodes;
        traction_error: the same as an L2 norm over the face; pressure_oscillation: rms of the elements' pressure minus
        the recovered one, over the rms of the latter. The first two are 0 without contact.
        """
        area = stress.area
        pull = np.einsum("nij,nj->ni", stress.node[self.face.nodes][:, VOIGT_INDEX], area)
        push = self.problem.contact.faces.shared(state.traction_force, len(state.x))[self.face.nodes]
        size = np.linalg.norm(area, axis=1, keepdims=True)
        measures = {"force_error": 0.0, "traction_error": 0.0}
        if np.any(push):
            measures["force_error"] = float(np.linalg.norm((pull - push).sum(0)) / np.linalg.norm(push.sum(0)))
            measures["traction_error"] = float(
                np.linalg.norm((pull - push) / np.sqrt(size)) / np.linalg.norm(push / np.sqrt(size))
            )
        pressure = -stress.element[:, :3].mean(1)
        smooth, weight = self.recovery.mean @ -stress.rows[:, :3].mean(1), self._volume
        rms = float(np.sqrt(weight @ smooth**2))
        measures["pressure_oscillation"] = float(np.sqrt(weight @ (pressure - smooth) ** 2)) / rms if rms > 0 else 0.0
        return measures


def voigt(tensors: Array) -> Array:
    """Symmetric tensors (n, 3, 3) as xx yy zz yz xz xy (n, 6)."""
    return np.stack([tensors[:, i, j] for i, j in VOIGT_PAIRS], -1)


def agreeing(stress: Array, normal: Array, traction: Array) -> Array:
    """Stress (n, 6) changed as little as possible so that it has the traction (n, 3) on unit normals (n, 3).

    s + d o n + n o d - (d.n) n o n  with d the difference of the traction: symmetric, in-plane part unchanged.
    """
    missing = traction - np.einsum("nij,nj->ni", stress[:, VOIGT_INDEX], normal)
    outer = missing[:, :, None] * normal[:, None]
    along = (missing * normal).sum(1)[:, None, None]
    change = outer + outer.swapaxes(1, 2) - along * normal[:, :, None] * normal[:, None]
    return np.asarray(stress + voigt(change))


class _Face:
    """The nodes of the coated face and their area vectors at rest."""

    def __init__(self, faces: Faces, points: Array) -> None:
        own = {"N": facet_points(faces.conn.shape[1])[0], "areas": facet_areas(points, faces.conn)[0]}
        self.faces = replace(faces, **own)  # contact may use other points
        self.nodes = np.unique(faces.conn)
        self.rest = self.vectors(points)

    def vectors(self, x: Array) -> Array:
        """Area vectors (s, 3) [mm^2] of the nodes, pointing out of the gel."""
        area, normal = facet_areas(x, self.faces.conn)
        return np.asarray(self.faces.shared(area[..., None] * normal, len(x))[self.nodes])
