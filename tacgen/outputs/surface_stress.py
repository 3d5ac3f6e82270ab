"""Displacement and Cauchy stress of the coated face alone."""

from tacgen.outputs.base import MAX_COORDINATE_MM, Datasets, Entry, FrameData, Output, SceneData


def _frame(frame: FrameData) -> Datasets:
    nodes = frame.scene.stresses.face.nodes
    return {
        "/fields/surface_displacement": (frame.state.x - frame.scene.problem.mesh.points)[nodes],
        "/fields/surface_stress": frame.stress.node[nodes],
    }


def _face(scene: SceneData) -> Datasets:
    import numpy as np

    nodes = scene.stresses.face.nodes
    facets = np.searchsorted(nodes, scene.problem.contact.faces.conn)
    return {"/mesh/surface/points": scene.problem.mesh.points[nodes], "/mesh/surface/facets": facets}


OUTPUT = Output(
    "displacement and Cauchy stress of the coated face alone",
    {
        "/fields/surface_displacement": Entry("<f4", "N k 3", "mm", "displacement of the coated face"),
        "/fields/surface_stress": Entry("<f4", "N k 6", "MPa", "stress of the coated face, xx yy zz yz xz xy"),
        "/mesh/surface/points": Entry("<f8", "k 3", "mm", "nodes of the coated face at rest", most=MAX_COORDINATE_MM),
        "/mesh/surface/facets": Entry(
            "<i4", "* 3|4|6", "1", "nodes of each facet, numbered as in points", axes="facet corner", below="k"
        ),
    },
    _frame,
    _face,
)
