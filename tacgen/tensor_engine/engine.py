"""The batch engine: the numerics of many scenes, for the driver that every engine has, and a scene's way through it."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from tacgen.mechanics import solver
from tacgen.mechanics.failures import NotConverged
from tacgen.mechanics.frames import path
from tacgen.mechanics.phases import Phase
from tacgen.mechanics.scene import Scene
from tacgen.mechanics.state import State
from tacgen.tensor_engine import admission, bulk_newton, load_step
from tacgen.tensor_engine.batch import Batch


class ManyScenes(Batch):
    """The numerics of a batch; see mechanics.numerics.Numerics."""

    condensed = True
    place = load_step.place
    renew = load_step.renew
    predict = load_step.predict
    choose = load_step.choose
    start = load_step.start
    follow = bulk_newton.follow
    factor = bulk_newton.factor
    load = bulk_newton.load
    untouch = bulk_newton.untouch
    contact = bulk_newton.contact
    lower = bulk_newton.lower
    measure = bulk_newton.measure
    least_J = bulk_newton.least_J
    check = admission.check
    stiffen = admission.stiffen
    record = admission.record
    forget = admission.forget

    def whole(self, row: int) -> NotConverged | None:
        raise AssertionError("contact is always condensed")


@dataclass(frozen=True)
class Solved:
    """The states of a scene's frames, up to the first that the batch engine could not solve; why: its failure, None if
    all are there; late: it was put off, since others would have waited for it."""

    states: list[State]
    why: NotConverged | str | None
    late: bool = False


def advance(b: ManyScenes, phase: Phase, rows: list[int]) -> None:
    """Call the kernel of a phase for the scenes in slots `rows`, which wait for it."""
    solver.advance(b, phase, rows)
    for row in rows:
        if b.scenes[row].left:
            b.courses[row].phase = Phase.failed


def frames(b: ManyScenes, row: int, scene: Scene) -> Iterator[int]:
    """Puts solve after solve of a scene's path before the first kernel, each time the one before is over; yields the
    numbers of their frames."""
    slot, kept, last = b.scenes[row], dict[str, Tensor](), None
    b.courses.pop(row, None)
    try:
        for each in path(scene, slot.problem):
            if isinstance(each, State):
                slot.states.append(each)
                continue
            course = each.now
            if each.problem is not slot.problem:
                slot.why = "forces need smaller tolerances than the batch has"
                return
            if last is None:
                admission.rest(b, row, course.history)
            if last is not None and last is not course.history:  # one more trial of a force, from where the first began
                b.t.put(b.slots([row]), **kept)
            elif scene.forced is not None:
                kept = {name: rows[[row]] for name, rows in vars(b.t).items() if name.startswith("h_")}
            b.courses[row] = course
            if course.near is not None:
                nodes, x = (torch.as_tensor(part, device=b.X.device) for part in (slot.place.nodes, course.near.x))
                b.t.begins[row, nodes] = x
            yield course.index
            if slot.left:
                slot.why = "the contact leaves the fine part of the mesh"
                return
            last = course.history
    except NotConverged as error:
        slot.why = error
