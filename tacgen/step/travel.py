"""From pose to pose: in one step or, where that fails, goes too far or takes edges too fast, in halves of it."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from tacgen.fem.contact import Contact, Pose
from tacgen.step.advance import NotConverged, State, TooFar, advance
from tacgen.step.problem import Memory, Problem

Array = np.ndarray
HALVINGS = 5  # of a step that does not converge
SPLITS = 12  # and of one in which the indenter might pass through the gel
FINER = 2  # and of one that takes edges too fast
SHARP = 1.5  # edges of the mesh: an indenter of no smaller radius has none round which the gel might come otherwise
ROUND = 0.3  # [rad] by which the indenter's normal at a point changes in a step that brings it round an edge
ROUNDED = 0.05  # of the contact force: friction at such points from which on the step is too long


def between(a: Array, b: Array, part: float) -> Array:
    """The pose (4, 4) a part of the way from a to b: straight in position, steady in rotation."""
    pose, out = Pose.of(a).toward(Pose.of(b), part), np.eye(4)
    out[:3, :3], out[:3, 3] = pose.rotation, pose.position
    return out


def along(a: Array, b: Array, n: int) -> list[Array]:
    """The ends (4, 4) of n equal steps from a to b, the last of them b itself."""
    return [*(between(a, b, k / n) for k in range(1, n)), b]


def rounded(problem: Problem, before: Memory, after: Memory) -> float:
    """Friction at points that one step brought round an edge sharper than the mesh, as a part of the contact force.

    On their way, round the edge or through it, hangs whether they are pushed along or slip below, and so which way
    friction pulls. Frames in which that is a twentieth and more were up to 21 % of the force off the same path in a
    quarter of the step (7 % at .07), all others up to 4 %; on round indenters, whose points come round them as the mesh
    resolves, 3 %.
    """
    if not problem.friction or problem.contact.shape.smallest_radius >= SHARP * problem.edge:
        return 0.0
    turned = np.linalg.norm(after.normal - before.normal, axis=-1) > ROUND
    force = np.maximum(after.normal_force, before.normal_force)[turned].sum()
    return problem.friction * float(force) / max(float(after.normal_force.sum()), after.scale)


@dataclass(frozen=True)
class Halved:
    """How often a step is a half already, and why."""

    failed: int = 0
    far: int = 0
    finer: int = 0


def reach(
    problem: Problem, memory: Memory, a: Array, b: Array, index: int, duration: float, halved: Halved = Halved()
) -> tuple[Memory, State]:
    """From pose a to pose b in one step, or in two halves where that fails, goes too far or takes edges too fast.

    A step that took edges too fast is kept where its halves fail: it ended at an equilibrium, and State.rounded says
    how little sure that is. Where the last step had to be so short for edges, this one is not tried whole.
    """
    whole, more = None, replace(halved, finer=halved.finer + 1)
    if halved.finer >= memory.finer:
        try:
            whole = _judged(problem, memory, advance(problem, memory, b, index, duration), halved.finer)
            if whole[1].rounded < ROUNDED or halved.finer == FINER:
                return whole
        except TooFar:
            if halved.far == SPLITS:
                raise
            more = replace(halved, far=halved.far + 1)
        except NotConverged:
            if halved.failed == HALVINGS:
                raise
            more = replace(halved, failed=halved.failed + 1)
    middle = between(a, b, 0.5)
    try:
        there, first = reach(problem, memory, a, middle, index, duration / 2, more)
        there, second = reach(problem, there, middle, b, index, duration / 2, more)
    except NotConverged:
        if whole is None:
            raise
        return whole
    return there, _after(first, second)


def _judged(problem: Problem, before: Memory, found: tuple[Memory, State], finer: int) -> tuple[Memory, State]:
    """What was found in a step halved `finer` times for edges: how much it took round them, and how the next begins."""
    memory, state = found
    if not isinstance(problem.contact, Contact):  # between meshes, where collisions say the way
        return found
    part = rounded(problem, before, memory)
    begin = max(finer - 1, 0) if part < ROUNDED / 4 else finer
    return replace(memory, finer=begin), replace(state, rounded=part)


def travel(problem: Problem, memory: Memory, a: Array, b: Array, index: int, duration: float) -> tuple[Memory, State]:
    """From pose a to pose b, at an even pace, in as many steps as its duration takes."""
    n, total = problem.steps(duration), None
    for start, end in pairwise([a, *along(a, b, n)]):
        memory, state = reach(problem, memory, start, end, index, duration / n)
        total = state if total is None else _after(total, state)
    assert total is not None
    return memory, total


def _after(first: State, second: State) -> State:
    """The second state, its work that of both."""
    iterations, substeps = first.iterations + second.iterations, first.substeps + second.substeps
    return replace(second, iterations=iterations, substeps=substeps, rounded=max(first.rounded, second.rounded))
