"""The batch engine: the method's table run for all scenes of a batch, kernel by kernel."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from tacgen.geometry.pose import shortest_turn
from tacgen.mechanics.failures import NotConverged
from tacgen.mechanics.load_stepping import divided
from tacgen.mechanics.phases import TRANSITIONS, Outcome, Phase
from tacgen.mechanics.scene import Scene
from tacgen.mechanics.state import State
from tacgen.tensor_engine import admission, bulk_newton, load_step
from tacgen.tensor_engine.batch import Batch, Course
from tacgen.tensor_engine.laws import numbers
from tacgen.tensor_engine.shapes import known

Array = np.ndarray
KERNELS: dict[Phase, Callable[[Batch, Tensor], list[Outcome]]] = {
    Phase.begin: load_step.begin,
    Phase.renew: load_step.renew,
    Phase.predict: load_step.foresee,
    Phase.start: load_step.start,
    Phase.step: bulk_newton.begin_step,
    Phase.factor: bulk_newton.factor,
    Phase.load: bulk_newton.load,
    Phase.contact: bulk_newton.contact,
    Phase.damp: bulk_newton.damp,
    Phase.search: bulk_newton.search,
    Phase.measure: bulk_newton.measure,
    Phase.admit: admission.admit,
    Phase.halve: admission.halve,
}


def lacks(scene: Scene) -> str | None:
    """The first thing in a scene that the batch engine does not do, in words; None: it solves the scene."""
    wanted = {
        "a mesh of tets": scene.element != "hex",
        "contact between meshes": scene.surface is not None,
        "a prescribed force": scene.forced is not None,
        "inertia": scene.dynamics is not None,
        "a viscous gel": scene.duration is not None and any(layer.prony for layer in scene.gel.layers),
        "this material law": any(numbers(layer.law) is None for layer in scene.gel.layers),
        "this indenter": not known(scene.shape),
    }
    return next((what for what, is_so in wanted.items() if is_so), None)


@dataclass(frozen=True)
class Solved:
    """The states of a scene's frames, up to the first that the batch engine could not solve; why: its failure, None if
    all are there."""

    states: list[State]
    why: NotConverged | str | None


def advance(b: Batch, phase: Phase, rows: list[int]) -> None:
    """Call the kernel of a phase for the scenes in slots `rows`, which wait for it."""
    for row, outcome in zip(rows, KERNELS[phase](b, b.slots(rows)), strict=True):
        course = b.courses[row]
        course.phase = Phase.failed if course.left else TRANSITIONS[phase][outcome]


def frames(b: Batch, row: int, scene: Scene) -> Iterator[int]:
    """Puts frame after frame before the first kernel, each time the one before is solved; yields their numbers."""
    course, last = b.courses[row], scene.start
    previous: State | None = None
    for index, pose in enumerate(scene.poses):
        turn = shortest_turn(last, pose) if scene.turns is None else scene.turns[index]
        duration = math.inf if scene.duration is None else float(scene.duration[index])
        assert course.history is not None
        course.legs = divided(course.problem, course.history, last, pose, turn, duration)
        course.phase, course.index, course.effort, course.state = Phase.begin, index, 0, None
        yield index
        previous = _reached(course, previous)
        if previous is None:
            return
        last = previous.pose


def _reached(course: Course, previous: State | None) -> State | None:
    """The state of the frame that is over, after that of the one before; None: it has no solution, and why is noted."""
    if course.phase is Phase.failed or course.state is None:
        course.why = "the contact leaves the fine part of the mesh" if course.left else course.failure
        return None
    course.states.append(course.state.following(previous))
    return course.states[-1]
