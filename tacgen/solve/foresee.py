"""Scene -> Scene: depths that only a force says, guessed on a coarse mesh, for the true one to be fine there."""

from dataclasses import replace

import numpy as np

from tacgen import solve
from tacgen.recipe.trajectory_poses import FORCE_DEPTH
from tacgen.scene import mesh
from tacgen.scene.scene import Scene

HOPELESS = 2  # times the most that the coarse mesh gives
COARSE = 5  # edges through the thickness, of the mesh on which depths are foreseen


def foreseen(scene: Scene) -> Scene:
    """A scene with the heights of its forced frames guessed by solving it on a coarse mesh first; others unchanged.

    The mesh has to be fine where the indenter will come, which a force does not say. A stiffness by formula would
    need one for every shape and law, thin layers and sharp edges; a coarse solve is the same physics in a few
    seconds. Its depth is some percent off: `below` allows for a quarter more and a quarter of its edge. Where it
    fails, the mesh is fine for all depths that may be tried, and the true solve says what is wrong; but for a force
    so far beyond the gel that no mesh would help, which is refused at once.
    """
    forced = scene.forced
    if forced is None:
        return scene
    end = int(np.flatnonzero(np.isfinite(forced.asked))[-1]) + 1
    edge = max(scene.edge, scene.gel.thickness / COARSE)
    rough = replace(scene, edge=edge, dhat=max(scene.dhat, 0.05), surface=None)
    problem = solve.Problem.of(rough, mesh.of(rough))
    poses, below, shift = scene.poses.copy(), forced.below.copy(), 0.0
    try:
        found = [state.pose[2, 3] for _, state in zip(range(end), solve.states(rough, problem, tol=0.05), strict=False)]
    except solve.TooMuch as error:
        if error.asked < HOPELESS * error.most:
            return scene
        hopeless = error.index, f"{error}, as a coarse mesh has it"
        return replace(scene, forced=replace(forced, below=np.zeros_like(below), hopeless=hopeless))
    except solve.NotConverged:
        return scene
    for i in range(len(poses)):
        if np.isfinite(forced.asked[i]):
            shift = found[i] - poses[i, 2, 3]
            depth = forced.floor[i] + FORCE_DEPTH * scene.gel.thickness - found[i]
            below[i] = min(0.25 * depth + edge / 4, found[i] - forced.floor[i])
        poses[i, 2, 3] += forced.carry[i] * shift
    return replace(scene, poses=poses, forced=replace(forced, below=below))
