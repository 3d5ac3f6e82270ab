"""Where a mesh is convex, and how sharply."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tacgen.geometry.mesh_file import SolidMesh

Array = np.ndarray
EDGE_SAMPLE_MM = 0.2  # between the points at which an edge is looked at [mm]
MAX_EDGE_SAMPLES = 50_000  # points that are looked at
MIN_SHARP_ANGLE = np.radians(30)  # angle of triangles at a sharp edge; smaller angles approximate a fillet [rad]
# angle that the triangles at a tip lack of a full turn [rad]; those of a ball of 80 triangles lack .3
MIN_TIP_ANGLE = 0.5
MIN_RADIUS_QUANTILE = 0.01  # quantile of the radii that is taken for the smallest: one sliver is no edge [-]


@dataclass(frozen=True, eq=False)
class Convex:
    """Points (n, 3) along the convex edges and the radius (n,) there; sharp tips (k, 3) and their radius [mm]."""

    points: Array
    radii: Array
    tips: Array
    tip_radius: float

    @classmethod
    def of(cls, solid: SolidMesh, radius: float) -> "Convex":
        """Convex edges of a solid whose sharp edges and tips have this radius [mm].

        Radii are exact for the strips of triangles of CAD fillets, up to 1.5 times too large for equilateral triangles.
        """
        import trimesh

        mesh = trimesh.Trimesh(solid.vertices, solid.triangles, process=False)
        angle = mesh.face_adjacency_angles
        convex = mesh.face_adjacency_convex & (angle > 1e-3)
        angle, ends = angle[convex], mesh.vertices[mesh.face_adjacency_edges[convex]]
        across = mesh.face_adjacency_span[convex] / 2  # about the distance between the centres of two triangles
        radii = np.where(angle > MIN_SHARP_ANGLE, radius, np.maximum(np.round(across / angle, 4), radius))
        pieces = np.ceil(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / EDGE_SAMPLE_MM).astype(int)
        which = np.repeat(np.arange(len(pieces)), pieces)
        part = (np.arange(len(which)) - (np.cumsum(pieces) - pieces)[which] + 0.5) / pieces[which]
        some = slice(None, None, 1 + len(which) // MAX_EDGE_SAMPLES)
        points = ends[which, 0] + part[:, None] * (ends[which, 1] - ends[which, 0])
        lacking = trimesh.curvature.vertex_defects(mesh)  # type: ignore[no-untyped-call]
        tips = solid.vertices[lacking > MIN_TIP_ANGLE]
        return cls(points[some], radii[which][some], tips, radius)

    def smallest(self, touches: Callable[[Array], Array]) -> float:
        """Smallest radius [mm] where points (n, 3) of a part, told by `touches`, are (n,); inf if none is."""
        if len(self.tips) and touches(self.tips).any():
            return self.tip_radius
        there = self.radii[touches(self.points)]
        return float(np.quantile(there, MIN_RADIUS_QUANTILE)) if len(there) else np.inf
