"""Depths of frames with a prescribed force, by a solve on a coarse mesh: the final mesh is made fine there."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tacgen import mechanics
from tacgen.mechanics import mesh
from tacgen.mechanics.failures import Failure, NotConverged
from tacgen.mechanics.scene import MAX_FORCE_SEARCH_DEPTH, Scene

HOPELESS_FORCE_RATIO = 2  # force over the largest on the coarse mesh, above which the scene is refused at once [-]
PRESOLVE_EDGES_PER_THICKNESS = 5  # edges of the coarse mesh through the gel's thickness


def presolved(scene: Scene) -> Scene:
    """The scene with guessed heights at frames with a force; a scene without such frames is returned unchanged.

    The mesh must be fine where the indenter will be, which is not known for a force. Formulas for the stiffness would
    be needed for every shape, law and layer; a coarse solve takes a few seconds. Its depth has an error of some
    percent: `below` allows for a quarter of the depth plus a quarter of the edge. If the coarse solve fails, the mesh
    is fine for all depths, and the true solve reports the reason; a force far above what the gel can bear is refused.
    """
    forced = scene.forced
    if forced is None:
        return scene
    coarse = rough(scene)
    try:
        found = mechanics.states(coarse, mechanics.Problem.of(coarse, mesh.of(coarse)))
        heights = [state.pose[2, 3] for state in found]
    except NotConverged as error:
        if error.failure != Failure.too_much or error.data["asked"] < HOPELESS_FORCE_RATIO * error.data["most"]:
            return scene
        hopeless = error.data["index"], NotConverged(Failure.hopeless, why=error)
        return replace(scene, forced=replace(forced, below=np.zeros_like(forced.below), hopeless=hopeless))
    return refined(scene, heights)


def rough(scene: Scene) -> Scene:
    """A scene with forces on a coarse mesh, up to the last force, to some percent of it."""
    forced = scene.forced
    assert forced is not None
    forced = replace(forced, tol=0.05, end=int(np.flatnonzero(np.isfinite(forced.asked))[-1]) + 1)
    return replace(coarsened(scene), forced=forced, differentiable=False)


def coarsened(scene: Scene) -> Scene:
    """A scene on a coarse mesh."""
    edge = max(scene.edge, scene.gel.thickness / PRESOLVE_EDGES_PER_THICKNESS)
    return replace(scene, edge=edge, dhat=max(scene.dhat, 0.05))


def refined(scene: Scene, heights: Sequence[float]) -> Scene:
    """A scene with the heights [mm] at which its rough one has the forces, as guesses."""
    forced = scene.forced
    assert forced is not None
    poses, below, shift = scene.poses.copy(), forced.below.copy(), 0.0
    for i in range(len(poses)):
        if np.isfinite(forced.asked[i]):
            shift = heights[i] - poses[i, 2, 3]
            depth = forced.floor[i] + MAX_FORCE_SEARCH_DEPTH * scene.gel.thickness - heights[i]
            below[i] = min(0.25 * depth + coarsened(scene).edge / 4, heights[i] - forced.floor[i])
        poses[i, 2, 3] += forced.carry[i] * shift
    return replace(scene, poses=poses, forced=replace(forced, below=below))
