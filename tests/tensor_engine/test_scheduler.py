"""The scheduler, with scenes that compute nothing: each is the list of kernels it will ask for."""

import random

import pytest

from tacgen.mechanics.phases import FINAL_PHASES, PHASE_TRANSITIONS, Phase
from tacgen.tensor_engine import scheduler
from tacgen.tensor_engine.scheduler import Use, run

P = Phase


class Toy:
    """Slots of scenes that are lists of phases; records calls, and how many slots were full at each."""

    def __init__(self, count):
        self.count, self.left, self.had, self.calls, self.full, self.kinds = count, {}, {}, [], [], {}

    def enter(self, slot, scene):
        assert slot not in self.left
        self.left[slot], self.had[slot] = list(scene), []

    def phase(self, slot):
        return self.left[slot][0] if self.left[slot] else None

    def kind(self, slot):
        return self.kinds.get(slot, 0)

    def advance(self, phase, slots):
        self.calls.append((phase, len(slots)))
        self.full.append(len(self.left))
        for slot in slots:
            assert self.left[slot][0] is phase
            self.had[slot].append(self.left[slot].pop(0))

    def leave(self, slot):
        del self.left[slot]
        return self.had.pop(slot)


def paths(count, seed=0):
    """Random walks through the table of the method."""
    r, out = random.Random(seed), []
    for _ in range(count):
        phase, path = P.begin, []
        while phase not in FINAL_PHASES:
            path.append(phase)
            phase = r.choice(list(PHASE_TRANSITIONS[phase].values()))
        out.append(tuple(path))
    return out


def test_each_scene_has_its_kernels_in_order():
    scenes = paths(40)
    found = list(run(Toy(7), scenes))
    assert sorted(scene for scene, _ in found) == sorted(scenes)
    assert all(tuple(result) == scene for scene, result in found)


def test_slots_stay_full_while_scenes_wait():
    toy, scenes = Toy(5), paths(30, seed=1)
    left = len(scenes)
    for _ in run(toy, scenes):
        left -= 1
        if left > 5:
            assert toy.full[-1] == 5
    assert max(toy.full) == 5


def test_the_kernel_with_most_scenes_waiting_is_called():
    toy = Toy(3)
    assert len(list(run(toy, [[P.load], [P.factor, P.load], [P.factor, P.load]]))) == 3
    assert toy.calls == [(P.factor, 2), (P.load, 3)]


def frame(r: random.Random) -> list[Phase]:
    """The kernels of a frame, about as ordinary scenes ask for them."""
    out = [P.begin, *[P.renew] * (r.random() < 0.25), P.predict, P.start]
    for _ in range(r.randint(1, 5)):
        out += [P.step, *[P.factor] * (r.random() < 0.35), P.load]
        for _ in range(1 + int(r.lognormvariate(1.0, 0.9))):
            out += [P.contact, *[P.damp] * (r.random() < 0.04), *[P.halve] * (r.random() < 0.04)]
        out += [P.search, P.measure]
    return [*out, P.admit]


def test_scenes_do_not_wait_for_kernels_that_few_ask_for() -> None:
    r, use = random.Random(0), Use()
    scenes = [[phase for _ in range(r.randint(4, 10)) for phase in frame(r)] for _ in range(400)]
    assert len(list(run(Toy(40), scenes, use=use))) == 400
    assert use.mean > 12.4  # 11.8 if the longest queue came first
    sizes = {phase: use.scenes[phase] / use.calls[phase] for phase in use.calls}
    assert sizes[P.damp] < sizes[P.load] < sizes[P.contact]


def test_a_call_has_scenes_of_one_kind() -> None:
    toy = Toy(3)
    toy.kinds = {0: 1, 1: 2, 2: 1}
    assert len(list(run(toy, [[P.contact]] * 3))) == 3
    assert toy.calls == [(P.contact, 2), (P.contact, 1)]


def test_calls_are_no_larger_than_their_memory_allows():
    toy, use = Toy(4), Use()
    assert len(list(run(toy, [[P.factor, P.load]] * 4, lambda phase, *_: 3 if phase is P.factor else 9, use))) == 4
    assert toy.calls == [(P.factor, 3), (P.load, 3), (P.factor, 1), (P.load, 1)]
    assert dict(use.scenes) == {P.factor: 4, P.load: 4}
    assert use.mean == 2.0


def test_the_last_scenes_are_given_up_where_no_others_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = [[P.load] * (k + 1) for k in range(6)]
    monkeypatch.setattr(scheduler, "MAX_GRACE_CALLS", 0)
    found = [len(had) for _, had in run(Toy(4), scenes, last=2)]
    assert found == [1, 2, 3, 4, 3, 2]  # the last two came when the first and the second had ended
    assert [len(had) for _, had in run(Toy(2), scenes, last=2)] == [1, 2, 3, 4, 5, 3]  # none while others wait
    monkeypatch.setattr(scheduler, "MAX_GRACE_CALLS", 2)
    assert [len(had) for _, had in run(Toy(4), scenes, last=2)] == [1, 2, 3, 4, 5, 4]
    assert [len(had) for _, had in run(Toy(4), scenes[:2], last=2)] == [1, 2]


def test_scenes_are_read_as_slots_become_free():
    read = []

    def scenes():
        for k in range(6):
            read.append(k)
            yield [P.begin] * (k + 1)

    ends = run(Toy(2), scenes())
    assert next(ends)[1] == [P.begin]
    assert read == [0, 1]
    assert [len(result) for _, result in ends] == [2, 3, 4, 5, 6]


def test_more_scenes_share_a_call_than_in_lockstep():
    scenes, use = paths(400, seed=2), Use()
    for _ in run(Toy(32), scenes, use=use):
        pass
    lockstep = sum(map(len, scenes)) / sum(max(map(len, scenes[k : k + 32])) * len(P) for k in range(0, 400, 32))
    assert use.scenes.total() == sum(map(len, scenes))
    assert use.mean > 2 * lockstep


@pytest.mark.parametrize("scenes", [[], [[]], [[], [P.begin], []]])
def test_scenes_that_ask_for_nothing_end(scenes):
    assert [result for _, result in run(Toy(2), scenes)].count([]) == scenes.count([])
