"""Displacement and Cauchy stress of the whole gel, with its mesh."""

from tacgen.outputs.base import MAX_COORDINATE_MM, Datasets, Entry, FrameData, Output, SceneData, number


def _frame(frame: FrameData) -> Datasets:
    state, stress = frame.state, frame.stress
    return {
        "/fields/displacement": state.x - frame.scene.problem.mesh.points,
        "/fields/cauchy_stress": stress.element,
        "/fields/nodal_stress": stress.node,
        **{f"/frames/quality/{name}": value for name, value in frame.scene.stresses.quality(stress, state).items()},
    }


def _mesh(scene: SceneData) -> Datasets:
    mesh = scene.problem.mesh
    patches = {f"/mesh/facets/{name}": facets for name, facets in mesh.facets.items()}
    return {"/mesh/points": mesh.points, "/mesh/cells": mesh.cells, "/mesh/layer": mesh.layer, **patches}


OUTPUT = Output(
    "mesh, displacement, Cauchy stress of cells and nodes",
    {
        "/fields/displacement": Entry("<f4", "N n 3", "mm", "nodal displacement", most=MAX_COORDINATE_MM),
        "/fields/cauchy_stress": Entry("<f4", "N m 6", "MPa", "stress, xx yy zz yz xz xy"),
        "/fields/nodal_stress": Entry("<f4", "N n 6", "MPa", "stress, xx yy zz yz xz xy"),
        "/mesh/points": Entry("<f8", "n 3", "mm", "nodes of the rest mesh", most=MAX_COORDINATE_MM),
        "/mesh/cells": Entry("<i4", "m 4|8|10", "1", "nodes of each cell", axes="cell corner", below="n"),
        "/mesh/layer": Entry("<i4", "m", "1", "gel layer of each cell, 0 at the base", below="m"),
        "/mesh/facets/*": Entry(
            "<i4", "* 3|4|6", "1", "nodes of each facet of a named patch", axes="facet corner", below="n"
        ),
        "/frames/quality/force_error": number("sum of recovered sigma n da less force, over force"),
        "/frames/quality/traction_error": number("L2 norm of sigma n less traction, over that"),
        "/frames/quality/pressure_oscillation": number("rms of element less smooth pressure"),
    },
    _frame,
    _mesh,
)
