"""The batch engine: the method's table run for all scenes of a batch, kernel by kernel."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from tacgen.mechanics.failures import NotConverged
from tacgen.mechanics.frames import path
from tacgen.mechanics.phases import PHASE_TRANSITIONS, Outcome, Phase
from tacgen.mechanics.scene import Scene
from tacgen.mechanics.solve_state import SolveState
from tacgen.mechanics.state import State
from tacgen.tensor_engine import admission, bulk_newton, load_step
from tacgen.tensor_engine.batch import Batch

# by Course and SolveState
SHARED_FIELDS = ("index", "history", "legs", "may_halve", "effort", "phase", "state", "failure")
BATCH_KERNELS: dict[Phase, Callable[[Batch, list[int]], list[Outcome]]] = {
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


@dataclass(frozen=True)
class Solved:
    """The states of a scene's frames, up to the first that the batch engine could not solve; why: its failure, None if
    all are there; late: it was put off, since others would have waited for it."""

    states: list[State]
    why: NotConverged | str | None
    late: bool = False


def advance(b: Batch, phase: Phase, rows: list[int]) -> None:
    """Call the kernel of a phase for the scenes in slots `rows`, which wait for it."""
    for row, outcome in zip(rows, BATCH_KERNELS[phase](b, rows), strict=True):
        course = b.courses[row]
        course.phase = Phase.failed if course.left else PHASE_TRANSITIONS[phase][outcome]


def frames(b: Batch, row: int, scene: Scene) -> Iterator[int]:
    """Puts solve after solve of a scene's path before the first kernel, each time the one before is over; yields the
    numbers of their frames."""
    course, kept = b.courses[row], dict[str, Tensor]()
    try:
        for each in path(scene, course.problem):
            if isinstance(each, State):
                course.states.append(each)
                continue
            now = each.now
            if each.problem is not course.problem:
                course.why = "a force that is small beside the tolerances"
                return
            if course.history is None:
                admission.rest(b, row, now.history)
            if course.history is not now.history:  # one more trial of a force, from where the first began
                b.t.put(b.slots([row]), **kept)
            elif scene.forced is not None:
                kept = {name: rows[[row]] for name, rows in vars(b.t).items() if name.startswith("h_")}
            for name in SHARED_FIELDS:
                setattr(course, name, getattr(now, name))
            if now.near is not None:
                nodes, x = (torch.as_tensor(part, device=b.X.device) for part in (course.place.nodes, now.near.x))
                b.t.begins[row, nodes] = x
            course.near = now.near is not None
            yield course.index
            if course.left:
                course.why = "the contact leaves the fine part of the mesh"
                return
            each.now = SolveState(**{name: getattr(course, name) for name in SHARED_FIELDS})
    except NotConverged as error:
        course.why, course.phase = error, Phase.failed
