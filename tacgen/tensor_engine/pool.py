"""Scenes of one pattern in the slots of one batch, refilled; and many scenes, pattern after pattern."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from typing import NamedTuple

import torch

from tacgen.mechanics import mesh
from tacgen.mechanics.phases import FINAL_PHASES, Phase
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.scene import Scene
from tacgen.tensor_engine import device as devices
from tacgen.tensor_engine import engine, grids, refill, replay, scheduler
from tacgen.tensor_engine.batch import INITIAL_KEPT_DOFS, room_for, width_class
from tacgen.tensor_engine.condensed import Condensed
from tacgen.tensor_engine.dissection import Dissection, dissected
from tacgen.tensor_engine.elements import Topology
from tacgen.tensor_engine.engine import ManyScenes, Solved
from tacgen.tensor_engine.grids import Place
from tacgen.tensor_engine.multifrontal import Multifrontal
from tacgen.tensor_engine.planning import Planned, PoolKind, pools
from tacgen.tensor_engine.slot import PartOfStep
from tacgen.tensor_engine.timed import BYTES_PER_DAMPER, BYTES_PER_TERM

MAX_SLOTS = 1024  # more scenes at once are hardly faster
# A few scenes that go on for long would keep a batch from ending, in calls that are as good as empty. So put off are
# those that took more kernel calls for their frames and trials of a force so far, and for some more, than ordinary
# ones, which take 50 each; and of each pool, where no more wait, this part. They are solved again together, to their
# end: multilevel feedback (Corbato, Merwin-Daggett, Daley 1962).
MAX_FIRST_CALLS, EXTRA_CALL_FRAMES, PUT_OFF_SHARE = 120, 3, 0.06
BYTES_PER_CELL, BYTES_PER_UNKNOWN = 2500, 100  # bytes of tables, of a cell and of an unknown
# bytes of a cell for the work of a kernel, and of one that makes tangents
WORK_BYTES_PER_CELL, TANGENT_BYTES_PER_CELL = 3_000, 6_000
WORK_BYTES_PER_ENTRY = 48  # bytes for the work of a kernel, of an entry of a matrix of a contact's unknowns
DENSE_PHASES = (Phase.contact, Phase.predict)
ELASTIC = PoolKind()
ALL_CELL_PHASES = (Phase.start, Phase.load, Phase.search, Phase.measure, Phase.admit)  # kernels that evaluate all cells


class Kind(NamedTuple):
    """A kind of work of a kernel: what of a contact's step is next, and the class of its nodes."""

    part: PartOfStep = PartOfStep.COUPLED
    nodes: int = 1


@dataclass(frozen=True)
class PreparedScene:
    """A scene, its number, its discretised problem, and its mesh within the pattern of its batch."""

    number: int
    scene: Scene
    problem: Problem
    grid: Place

    @classmethod
    def of(cls, plan: Planned) -> "PreparedScene":
        """Raises ValueError: the pattern does not hold the scene's mesh."""
        assert plan.scene is not None
        assert plan.axes is not None
        assert plan.pattern is not None
        problem = Problem.of_known_frames(plan.scene, mesh.on(plan.axes, plan.scene.gel))
        return cls(plan.number, plan.scene, problem, grids.placed(plan.axes, plan.scene, plan.pattern))


class ScenePool:
    """Slots of scenes of one pattern, whose facets have equally many contact points; see scheduler.Slots."""

    def __init__(
        self, first: Sequence[PreparedScene], tree: Dissection, device: str, dtype: torch.dtype, calls: float = math.inf
    ) -> None:
        """As many slots as there are scenes, which come first into them, in this order. calls: a frame may have so many
        before its scene is put off."""
        pattern, self.count, self._first = tree.pattern, len(first), dict(enumerate(first))
        topology = Topology.shared(pattern.hexes, pattern.facets, pattern.size, device)
        factors = Condensed(Multifrontal(tree, device, dtype), self.count)
        problems, places = zip(*((scene.problem, scene.grid) for scene in first), strict=True)
        self.batch = ManyScenes.of(problems, places, topology, factors, pattern.patch, device)
        self._frames: dict[int, Iterator[int]] = {}
        self._most, self._calls = calls, dict[int, float]()  # calls that a scene may still have

    def enter(self, slot: int, scene: PreparedScene) -> None:
        """Put a scene into an empty slot, before its first frame."""
        if self._first.pop(slot, None) is not scene:
            refill.fill(self.batch, slot, scene.problem, scene.grid)
            self.batch.replays.entered(slot)
        self._frames[slot] = engine.frames(self.batch, slot, scene.scene)
        self._calls[slot] = self._most * (EXTRA_CALL_FRAMES + 1)
        next(self._frames[slot], None)

    def phase(self, slot: int) -> Phase | None:
        """The kernel for which the scene in a slot waits; None: all its frames are solved, or one could not be."""
        if (course := self.batch.courses.get(slot)) is None:  # refused before its first solve
            return None
        if self._calls[slot] <= 0 and course.phase not in FINAL_PHASES:
            return None
        if course.phase in FINAL_PHASES:
            if next(self._frames[slot], None) is None:
                return None
            self._calls[slot] += self._most
        return self.batch.courses[slot].phase

    def kind(self, slot: int) -> Kind:
        """For kernels of dense matrices of a contact's nodes, their class; and what of a contact's step is next."""
        scene, dense = self.batch.scenes[slot], self.batch.courses[slot].phase in DENSE_PHASES
        return Kind(scene.part_of_step, width_class(scene.nodes)) if dense else Kind()

    def advance(self, phase: Phase, slots: list[int]) -> None:
        """Call a kernel for scenes that wait for it."""
        engine.advance(self.batch, phase, slots)
        for slot in slots:
            self._calls[slot] -= 1

    def leave(self, slot: int) -> Solved:
        """The states of the scene in a slot, which has ended or is put off."""
        del self._frames[slot]
        scene = self.batch.scenes[slot]
        late = scene.why is None and self.batch.courses[slot].phase not in FINAL_PHASES
        return Solved(scene.states, f"put off after {len(scene.states)} frames" if late else scene.why, late)


def solved(
    scenes: Iterable[Scene | Planned],
    device: str = "cpu",
    *,
    dtype: torch.dtype = torch.float32,
    slots: int = MAX_SLOTS,
    share: bool = True,
    memory: float = devices.CPU_MEMORY_BYTES,
    use: scheduler.Use | None = None,
    patient: bool = True,
) -> Iterator[tuple[int, Solved]]:
    """Numbers of scenes, in their order or as they were planned, and their solutions, in the order in which they end;
    those that the batch engine lacks something for, which have no state, come first.

    dtype: of the factors. slots: most scenes at once. share: whether scenes of some patterns are put into a larger one.
    memory: [bytes] to use. use: where calls are counted. patient: whether scenes are solved to their end that take far
    more calls than others; else they are put off.
    """
    plans = [each if isinstance(each, Planned) else Planned.of((k, each)) for k, each in enumerate(scenes)]
    yield from ((plan.number, Solved([], plan.why)) for plan in plans if plan.pattern is None)
    for (pattern, kind), group in pools(plans, share).items():  # each pool is gone before the next one is made
        some = [replace(plans[k], pattern=pattern) for k in group]
        tree, ready = dissected(pattern), map(PreparedScene.of, some)
        devices.cleared(device)
        room = Room.of(tree, memory, kind)
        yield from _solved(tree, ready, min(room.slots, slots), room, device, dtype, use, patient)


def _solved(
    tree: Dissection,
    ready: Iterator[PreparedScene],
    count: int,
    room: "Room",
    device: str,
    dtype: torch.dtype,
    use: scheduler.Use | None,
    patient: bool,
) -> Iterator[tuple[int, Solved]]:
    """Numbers of scenes of one pattern and their solutions."""
    first, pool = list(islice(ready, count)), None
    count, calls = len(first), math.inf if patient else MAX_FIRST_CALLS
    while pool is None:
        try:
            pool = ScenePool(first[:count], tree, device, dtype, calls)
        except torch.OutOfMemoryError:  # `room` is an estimate
            if count == 1:
                raise
            count //= 2
        if pool is None:  # what the error has held is free by now
            devices.cleared(device)
    last = 0 if patient else int(PUT_OFF_SHARE * pool.count)
    for scene, found in scheduler.run(pool, chain(first, ready), room.fitting, use, last):
        yield scene.number, found


@dataclass(frozen=True)
class Room:
    """How many scenes of a pattern have room (`slots`), and what a call of some kernels needs for each [bytes].

    work: bytes for a call; its work needs them twice, in a recording and without.
    """

    slots: int
    each: dict[Phase, float]
    work: float

    @classmethod
    def of(cls, tree: Dissection, memory: float, kind: PoolKind = ELASTIC) -> "Room":
        """Room in so many bytes."""
        cells, k = len(tree.pattern.hexes), 3 * len(tree.patch)
        c, a, e = room_for(len(tree.patch)).values()
        # Schur complements now and at rest, and reduced; an inverse of the rest of the patch, and what couples both
        dense = 2 * c**2 + e**2 + e * a + a**2 + k**2 + k * c
        own = 4.0 * (tree.kept + dense) + BYTES_PER_CELL * cells + BYTES_PER_UNKNOWN * 3 * tree.pattern.size
        timed = kind.inert * BYTES_PER_DAMPER * cells
        if kind.prony_terms:
            timed += (kind.prony_terms + 2) * BYTES_PER_TERM * cells  # with s and M
        own += timed
        each = dict.fromkeys(ALL_CELL_PHASES, float(WORK_BYTES_PER_CELL * cells))
        each |= dict.fromkeys((Phase.factor, Phase.renew), 5.0 * tree.work + TANGENT_BYTES_PER_CELL * cells)
        for phase, copies in ((Phase.begin, 4), (Phase.factor, 1), (Phase.renew, 1), (Phase.admit, 2)):
            each[phase] = each.get(phase, 0.0) + copies * timed
        return cls(max(1, int(0.45 * memory / own)), each, 0.15 * memory)

    def fitting(self, phase: Phase, kind: Kind, waiting: int) -> int:
        """How many of so many scenes that wait go into one call."""
        stepping = phase is Phase.contact and kind.part is not PartOfStep.REDUCE  # works on the kept unknowns
        rows = min(3 * kind.nodes, INITIAL_KEPT_DOFS) if stepping else 3 * kind.nodes
        each = WORK_BYTES_PER_ENTRY * rows**2 if phase in DENSE_PHASES else self.each.get(phase, 0.0)
        return replay.fitting(waiting, int(self.work / max(each, 1.0)))
