"""Recorded work does what work does, for calls of any size, and never waits for the device while it is recorded."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from typing import Any

import numpy as np
import pytest
from helpers.needs import needs

torch = needs("torch")

from torch.utils._python_dispatch import TorchDispatchMode, _disable_current_modes

import tacgen.tensor_engine.batch
from tacgen.fem.projection import Projection
from tacgen.geometry.analytic_sdf import SphereSdf
from tacgen.tensor_engine import device as devices
from tacgen.tensor_engine import inversion, pool, replay
from tacgen.tensor_engine.indices import put
from tacgen.tensor_engine.replay import Replays, fitting, padded, rare
from tensor_engine.batches import batch, path, small, solve
from tensor_engine.dense import Dense
from tensor_engine.test_forces import forced
from tensor_engine.test_pool import SCENES

CPU = torch.device("cpu")
# operations whose result is needed on the host before the next one can be launched
WAITING = {"_local_scalar_dense", "nonzero", "masked_select", "is_nonzero", "unique_consecutive", "_unique2", "equal"}


class NeverWaiting(TorchDispatchMode):
    """Fails where work would wait for the device."""

    def __torch_dispatch__(self, func: Any, types: Any, args: tuple = (), kwargs: dict | None = None) -> Any:
        name = func.overloadpacket.__name__
        indices = args[1] if name in ("index", "index_put", "index_put_", "_index_put_impl_") else ()
        masks = any(part is not None and part.dtype == torch.bool for part in indices)
        assert name not in WAITING, f"{name} while work is recorded"
        assert not masks, f"{name} with a mask while work is recorded"
        return func(*args, **(kwargs or {}))


def excused(function: Callable) -> Callable:
    """A function that may wait: on a GPU it is a kernel, or another class."""

    def alone(*args: Any, **kwargs: Any) -> Any:
        with _disable_current_modes():
            return function(*args, **kwargs)

    return alone


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("factor", "schur", "forward", "expand"):
        monkeypatch.setattr(Dense, name, excused(getattr(Dense, name)))
    noting = replay._noting

    @contextmanager
    def noting_without_waiting(roomy: bool) -> Iterator[Any]:
        with noting(roomy) as notes, NeverWaiting():
            yield notes

    monkeypatch.setattr(replay, "_noting", noting_without_waiting)


def test_calls_of_any_size_have_the_outputs_of_the_work() -> None:
    rows, replays = torch.arange(40.0), Replays(CPU, on=True)
    for slots in ([3], [5, 1], [7, 2, 9], [4, 0, 8], list(range(30)), [1] * 17):
        times = [float(k) for k in slots]
        told = replays("twice", lambda s, k: (torch.stack([rows[s], k * rows[s]], 1), None), slots, times)
        assert told == [[k, k**2] for k in times]
    assert replays.count == 3  # of 2 rows, 4 and 32, each after the first time


def test_recordings_write_what_the_work_writes() -> None:
    """After it has read, all rows but those that are done again; a row twice in a call, where it has too few, once."""
    kept, replays = torch.tensor([1.0, 2.0, -3.0, 4.0]), Replays(CPU, on=True)

    def doubled(s: torch.Tensor) -> tuple[None, replay.Write]:
        now = kept[s]
        sign = -1.0 if rare(now < 0) else 1.0

        def write(which: torch.Tensor | None) -> None:
            put(s, (kept,), (2 * sign * now,), which)

        return None, write

    for slots, wanted in (([0], [2, 2, -3, 4]), ([0], [4, 2, -3, 4]), ([3, 2], [4, 2, 6, 8]), ([1], [4, 4, 6, 8])):
        assert replays("doubled", doubled, slots) == [0.0] * len(slots)
        assert kept.tolist() == wanted
    assert (replays.count, replays.again) == (3, 1)


def test_a_larger_recording_serves_a_call_that_fills_half_of_it() -> None:
    replays, sizes = Replays(CPU, on=True), list[int]()

    def work(s: torch.Tensor) -> tuple[torch.Tensor, None]:
        sizes.append(len(s))
        return s, None

    for rows in (7, 8, 3, 1, 2, 3):
        assert replays("same", work, list(range(rows))) == list(range(rows))
    assert sizes == [7, 8, 8, 1, 2, 8]  # 2 rows would be a quarter of it


def test_sizes_of_recordings_are_few_and_large_enough() -> None:
    sizes = [padded(k) for k in range(1, 500)]
    assert sorted(set(sizes)) == [2, 4, 8, 16, 32, 64, 128, 256, 512]
    assert all(size >= k for k, size in enumerate(sizes, 1))


def test_calls_fill_their_recordings_unless_they_are_small() -> None:
    assert [fitting(k, 500) for k in (1, 5, 16, 17, 23, 24, 40, 48, 90, 96, 999)] == [
        1,
        5,
        16,
        16,
        16,
        24,
        32,
        48,
        64,
        96,
        256,
    ]
    assert [fitting(99, most) for most in (0, 5, 31, 32, 100)] == [2, 4, 16, 32, 64]


def test_scenes_that_meet_something_rare_are_done_again() -> None:
    rows, replays, done = torch.tensor([1.0, 4.0, -9.0]), Replays(CPU, on=True), []

    def roots(s: torch.Tensor) -> tuple[torch.Tensor, None]:
        done.append(replay.recording())
        return rows[s].abs().sqrt() if rare(rows[s] < 0) else rows[s].sqrt(), None

    found = [replays("roots", roots, slots) for slots in ([0], [1], [1, 2], [2, 0])]
    assert found == [[1.0], [2.0], [2.0, 3.0], [3.0, 1.0]]
    assert done == [False, True, True, False, True, False]
    assert (replays.count, replays.again) == (3, 2)
    replays.forget()
    replays("roots", roots, [0])
    assert done[-1] is False


@pytest.mark.usefixtures("watched")
def test_scenes_solved_by_recorded_work_end_where_others_do() -> None:
    slide = path((0, 0, -0.3), (0.25, 0.1, -0.35))
    scenes = [small(SphereSdf(1.5), slide, friction=0.5), small(SphereSdf(1.2), path((0, 0, -0.2)), friction=0.3)]
    scenes.append(forced(small(SphereSdf(1.5), slide, friction=0.5), [0.1, 0.15]))  # trials begin near each other
    wanted, recorded = solve(batch(scenes), scenes), batch(scenes)
    recorded.replays = Replays(CPU, on=True)
    for one, other in zip(solve(recorded, scenes), wanted, strict=True):
        assert one.why is None
        for state, same in zip(one.states, other.states, strict=True):
            assert np.abs(state.normal_force - same.normal_force).max() < 1e-9 * same.normal_force.max()
            assert np.abs(state.x - same.x).max() < 1e-9
            assert state.least_J == pytest.approx(same.least_J, abs=0.01)
    assert recorded.replays.count > 50


@pytest.mark.usefixtures("watched")
def test_scenes_end_the_same_where_recordings_are_done_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A third of the rows of each call, as if they had met something rare: what was found for them is not written."""
    slide = path((0, 0, -0.3), (0.25, 0.1, -0.35))
    scenes = [small(SphereSdf(radius), slide, friction=0.5) for radius in (1.5, 1.2, 1.0)]
    wanted, doubtful, record, calls = solve(batch(scenes), scenes), batch(scenes), Replays._record, count()

    def doubted(self: Replays, work: replay.Work, *more: Any) -> Any:
        def doubting(s: torch.Tensor, *numbers: torch.Tensor) -> Any:
            done = work(s, *numbers)
            rare((s + next(calls)) % 3 == 0)
            return done

        return record(self, doubting, *more)

    monkeypatch.setattr(Replays, "_record", doubted)
    doubtful.replays = Replays(CPU, on=True)
    for one, other in zip(solve(doubtful, scenes), wanted, strict=True):
        assert one.why is None
        for state, same in zip(one.states, other.states, strict=True):
            assert state.iterations == same.iterations
            assert np.abs(state.x - same.x).max() < 1e-9
    assert doubtful.replays.again > 20


@pytest.mark.usefixtures("watched")
@pytest.mark.parametrize("room", [0.75, 0.05])  # contacts have room from the start; rows grow
def test_scenes_in_refilled_slots_end_the_same_by_recorded_work(monkeypatch: pytest.MonkeyPatch, room: float) -> None:
    scenes, made = SCENES[:3], []
    monkeypatch.setattr(tacgen.tensor_engine.batch, "INITIAL_NODE_SHARE", room)
    wanted = dict(pool.solved(scenes, slots=2, dtype=torch.float64))

    def replays(device: torch.device) -> Replays:
        made.append(Replays(device, on=True))
        return made[-1]

    monkeypatch.setattr(tacgen.tensor_engine.batch, "Replays", replays)
    for number, found in pool.solved(scenes, slots=2, dtype=torch.float64):
        assert found.why is None
        assert len(found.states) == len(wanted[number].states)
        for state, same in zip(found.states, wanted[number].states, strict=True):
            force = max(float(same.normal_force.sum()), 1e-6)
            assert np.abs(state.normal_force - same.normal_force).max() < 1e-9 * force
    assert sum(each.count for each in made) > 50


@pytest.mark.usefixtures("watched")
def test_folded_cells_are_in_recordings_up_to_their_number(monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = [small(SphereSdf(1.5), path((0, 0, -0.3)))] * 2
    b, rows = batch(scenes), [0, 1]
    b.t.x[:] = b.X
    b.t.x[1, :, 2] *= 0.55  # all cells squeezed below J0
    b.t.x[0, int(b.topology.conn[4, 6])] -= 0.4

    def tangents(s: torch.Tensor) -> torch.Tensor:
        K = torch.zeros(len(s), len(b.topology.conn), 24, 24, dtype=torch.float64)
        b.barriers(s).evaluate(b.t.x[s]).add_tangents(K, Projection.NONE)
        return K

    b.t.folds[:] = 1.0
    eager = tangents(b.slots(rows))
    b.replays = Replays(CPU, on=True)

    recorded = []

    def work(s: torch.Tensor) -> tuple[torch.Tensor, None]:
        recorded.append(replay.recording())
        return tangents(s).flatten(1), None

    cells = len(b.topology.conn)
    for most, again, last in (((4, 4), 2, False), ((4, cells), 1, True), ((cells, cells), 0, True)):
        monkeypatch.setattr(inversion, "RECORDED_BARRIER_CELLS", most)  # at first, and where more are folded
        b.replays.forget()
        b.replays.entered(1)
        b.replays.again = 0
        for _ in range(3):
            found = torch.tensor(b.replays("forces", work, rows), dtype=eager.dtype).view_as(eager)
            assert (found - eager).abs().max() < 1e-12 * eager.abs().max()
        assert (b.replays.again, recorded[-1]) == (again, last)


def test_factors_are_recorded_in_a_stream_that_is_not_urgent(monkeypatch: pytest.MonkeyPatch) -> None:
    """A GPU gives room to blocks of urgent streams first; a graph has the priority of the stream it was recorded in."""
    made, where, replays = list[bool](), list[Any](), Replays(CPU, on=True)
    monkeypatch.setattr(devices, "stream", lambda device, urgent: made.append(urgent) or f"urgent: {urgent}")
    recording = replay._Recording

    def recorded(*given: Any) -> Any:
        where.append(given[4][0])
        return recording(*given)

    monkeypatch.setattr(replay, "_Recording", recorded)
    for key in (("factor", 1), ("contact", 1), "plain"):
        for _ in range(3):  # first without a recording
            replays(key, lambda s: (s, None), [0])
    assert where == ["urgent: False", "urgent: True", "urgent: True"]
    assert made == [False, True]


@pytest.mark.parametrize("short", [[True, False], [True, True]])
def test_recordings_make_room_for_others(short: list[bool], monkeypatch: pytest.MonkeyPatch) -> None:
    """All are given up where memory is short; where that is of no use, work is done without."""
    rows, replays, done = torch.arange(10.0), Replays(CPU, on=True), []

    def double(s: torch.Tensor) -> tuple[torch.Tensor, None]:
        done.append(replay.recording())
        return 2 * rows[s], None

    def doubled() -> tuple[list[float], bool]:
        return replays("double", double, [3, 1]), done[-1]

    assert [doubled() for _ in range(3)] == [([6.0, 2.0], recorded) for recorded in (False, True, True)]
    answers = iter(short)
    monkeypatch.setattr(devices, "full", lambda device: next(answers, False))
    replays("other", double, [4])
    assert (replays("other", double, [4]), done[-1]) == ([8.0], not all(short))
    assert replays.on != all(short)  # no call looks for memory again
    assert doubled() == ([6.0, 2.0], False)  # anew


@pytest.mark.parametrize(("used", "full"), [(0.95, True), (0.5, False)])
def test_memory_that_is_only_kept_for_later_is_not_in_use(
    used: float, full: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = [0.95 - used]
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda device: (0, 8e9))
    monkeypatch.setattr(torch.cuda, "memory_reserved", lambda device: (used + kept[0]) * 8e9)
    monkeypatch.setattr(torch.cuda, "empty_cache", lambda: kept.insert(0, 0.0))
    assert devices.full(torch.device("cuda:0")) == full
    assert not devices.full(CPU)
