"""Scenes in slots, queued by the kernel that each asks for next, and refilled.

In lockstep most scenes of a batch would wait: they need different numbers of steps of each kind. Here every scene waits
in the queue of its next phase, and a kernel with many scenes waiting is called for all of them. A scene that has ended
makes room for the next at once, so that slots stay full until no scene is left.

A call takes nearly as long for few scenes as for many. If kernel k is asked for v_k times a scene, and called when n_k
wait, there are sum(v_k / n_k) calls a scene; with sum(n_k) given, since slots are, they are fewest for n_k ~ sqrt(v_k):
Harris' square-root formula (1913) for lots. So the kernel with the largest n_k / sqrt(v_k) is called. If the longest
queue came first, scenes would wait for as many others at kernels that few ask for.
"""

from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

from tacgen.mechanics.phases import Phase

MAX_GRACE_CALLS = 100  # calls in which the last scenes may still end: as many as two ordinary frames take
Scene = TypeVar("Scene")
Result = TypeVar("Result")
S = TypeVar("S", contravariant=True)
R = TypeVar("R", covariant=True)


class Slots(Protocol[S, R]):
    """A solver of scenes in numbered slots, of which there are `count`."""

    count: int

    def enter(self, slot: int, scene: S) -> None:
        """Put a scene into an empty slot."""

    def phase(self, slot: int) -> Phase | None:
        """The kernel for which the scene in a slot waits; None: it has ended."""

    def kind(self, slot: int) -> Hashable:
        """The kind of that kernel's work, and sizes of it: calls have scenes of one, as arrays are padded to the
        largest."""

    def advance(self, phase: Phase, slots: list[int]) -> None:
        """Call a kernel for scenes that wait for it."""

    def leave(self, slot: int) -> R:
        """The result of the ended scene in a slot, which is empty afterwards."""


@dataclass
class Use:
    """How well slots are used: calls of each kernel, and scenes in these calls."""

    calls: Counter[Phase] = field(default_factory=Counter)
    scenes: Counter[Phase] = field(default_factory=Counter)

    def add(self, phase: Phase, scenes: int) -> None:
        """Count a call."""
        self.calls[phase] += 1
        self.scenes[phase] += scenes

    @property
    def mean(self) -> float:
        """Scenes in a call, over all calls; 0 without any."""
        return self.scenes.total() / max(self.calls.total(), 1)


def run(
    slots: Slots[Scene, Result],
    scenes: Iterable[Scene],
    fitting: Callable[[Phase, Any, int], int] | None = None,
    use: Use | None = None,
    last: int = 0,
) -> Iterator[tuple[Scene, Result]]:
    """Scenes with their results, in the order in which they end. `scenes` is read only as slots become free.

    fitting: how many of so many that wait for a kernel and a kind of its work are called. use: where calls are counted.
    last: where no others are left, so many are put off, after some more calls.
    """
    waiting, free, late = iter(scenes), list(range(slots.count))[::-1], 0
    inside, moved = dict[int, Scene](), list[int]()  # slots whose scenes have gone on, and do not wait yet
    queues, asked = dict[tuple[Phase, Hashable], list[int]](), Counter[tuple[Phase, Hashable]]()
    while True:
        while free and (scene := next(waiting, None)) is not None:
            moved.append(free.pop())
            inside[moved[-1]] = scene
            slots.enter(moved[-1], scene)
        if not inside:
            return
        ended = []
        for slot in moved:
            if (phase := slots.phase(slot)) is None:
                ended.append(slot)
            else:
                queues.setdefault((phase, slots.kind(slot)), []).append(slot)
        moved = []
        for slot in ended:
            yield inside.pop(slot), slots.leave(slot)
            free.append(slot)
        if ended:
            continue
        late += len(inside) <= last and bool(free)  # no others wait
        if late > MAX_GRACE_CALLS:
            yield from ((inside[slot], slots.leave(slot)) for slot in inside)
            return
        key = max(queues, key=lambda each: len(queues[each]) / (1 + asked[each]) ** 0.5)
        queue, (phase, kind) = queues.pop(key), key
        most = len(queue) if fitting is None else fitting(phase, kind, len(queue))
        moved = queue[:most]
        if most < len(queue):
            queues[key] = queue[most:]
        if use is not None:
            use.add(phase, len(moved))
        asked[key] += len(moved)
        slots.advance(phase, moved)
