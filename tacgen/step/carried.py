"""The gel gone along with the indenter: what a pose is begun from, and what tells where new points will touch.

A point that sticks goes where the indenter goes, whatever the frames before did; what it drags along follows, and
comes to the indenter where that meets it. Where new points touch decides what friction does in long frames: taken from
the way of the frames before, which a turn makes wrong, a capsule pressed in and slid by 1 mm at once was 46 % of its
force off the same path in sixteen frames. It is .6 % so, in fewer iterations.
"""

from dataclasses import dataclass

import numpy as np

from tacgen.fem.contact import Pose
from tacgen.fem.linear import NotPositiveDefinite
from tacgen.fem.potentials import Total
from tacgen.step.problem import Memory, Problem

Array = np.ndarray
TIED = 16.0  # springs that tie a point to the indenter, times its normal force over dhat: stiff, as friction at rest is
SAME = 0.9  # cosine between two ways from which on the indenter goes on as it went


@dataclass(frozen=True)
class Carried:
    """Nodes x (n, 3) where the points in contact went `way` (f, q, 3) along with the indenter, all else following; by
    the stiffness alone, to first order, they are `straight`."""

    x: Array
    straight: Array
    way: Array

    def missed(self, answer: Array) -> tuple[Array, Array]:
        """What the first order missed of an answer (n, 3), and the way on which it did."""
        return answer - self.straight, self.way


def carried(problem: Problem, memory: Memory, pose: Pose) -> Carried | None:
    """The gel where points in contact go along to `pose` and the rest follows to first order, or to second where the
    indenter goes on as it went; None where nothing touches."""
    touching = memory.normal_force > 0
    at = problem.contact.faces.at(memory.x)
    way = np.where(touching[..., None], pose.world(memory.pose.local(at)) - at, 0.0)
    if (straight := _tied(problem, memory, way, np.asarray(touching.any(1)))) is None:
        return None
    if memory.missed is None:
        return Carried(straight, straight, way)
    missed, before = memory.missed
    both = touching & before.any(-1)
    along, now, then = (float((a * b)[both].sum()) for a, b in ((way, before), (way, way), (before, before)))
    part = min(along / then, 1.0) if along > SAME * np.sqrt(now * then) else 0.0
    return Carried(straight + part**2 * missed, straight, way)


def _tied(problem: Problem, memory: Memory, way: Array, touching: Array) -> Array | None:
    """By the stiffness that is there already, if one is; else by one factorised for it."""
    faces, x = problem.contact.faces, memory.x
    condensed = problem.condensed if problem.condensed is not None and problem.condensed.usable else None
    if condensed is not None:
        touching = touching & condensed.nodes[faces.conn].all(1)
    if not (which := np.flatnonzero(touching)).size:
        return None
    ties = TIED * memory.normal_force[which, :, None] / problem.contact.dhat
    pattern = problem.pattern if condensed is None else condensed.pattern
    part = faces.only(which, pattern)
    data, pull = np.zeros(len(pattern.indices)), part.scatter(ties * way[which], len(x)).ravel()[pattern.free]
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
