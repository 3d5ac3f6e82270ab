"""The gel gone along with the indenter: what a pose is begun from, and what tells where new points will touch.

A point that sticks goes where the indenter goes, whatever the frames before did; what it drags along follows, and
comes to the indenter where that meets it. Where new points touch decides what friction does in long frames: taken from
the way of the frames before, which a turn makes wrong, a capsule pressed in and slid by 1 mm at once was 46 % of its
force off the same path in sixteen frames. It is .6 % so, in fewer iterations.
"""

from dataclasses import replace

import numpy as np

from tacgen.fem.contact import Pose
from tacgen.fem.linear import NotPositiveDefinite
from tacgen.fem.potentials import Total
from tacgen.step.problem import Memory, Problem

Array = np.ndarray
TIED = 16.0  # springs that tie a point to the indenter, times its normal force over dhat: stiff, as friction at rest is


def carried(problem: Problem, memory: Memory, pose: Pose) -> Array | None:
    """Nodes (n, 3) where the points in contact go along to `pose`, the rest following to first order; None if none do.

    By the stiffness that is there already, if one is; else by one factorised for it.
    """
    faces, x, touching = problem.contact.faces, memory.x, (memory.normal_force > 0).any(1)
    condensed = problem.condensed if problem.condensed is not None and problem.condensed.usable else None
    if condensed is not None:
        touching &= condensed.nodes[faces.conn].all(1)
    if not (which := np.flatnonzero(touching)).size:
        return None
    at = faces.at(x)
    way = (pose.world(memory.pose.local(at)) - at)[which]
    ties = TIED * memory.normal_force[which, :, None] / problem.contact.dhat
    pattern = problem.pattern if condensed is None else condensed.pattern
    part = replace(faces, conn=faces.conn[which], areas=faces.areas[which], slots=pattern.slots(faces.conn[which]))
    data, pull = np.zeros(len(pattern.indices)), part.scatter(ties * way, len(x)).ravel()[pattern.free]
    part.add_blocks(np.arange(len(which)), ties[..., None] * np.eye(3), data)
    try:
        if condensed is not None:
            return np.asarray(x + condensed.pulled(data, pull))
        Total(problem.elastic).add_hessian(x, data, 2)
        step = np.zeros(x.size)
        step[pattern.free] = problem.linear.exactly(data, pull)
    except NotPositiveDefinite:
        return None
    return x + step.reshape(x.shape)
