"""Many scenes in few slots: each has the CPU engine's frames, whichever was in its slot before."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.needs import needs

torch = needs("torch")

from helpers.presses import gel, scene

from tacgen.geometry.analytic_sdf import BoxSdf, SphereSdf
from tacgen.mechanics import Problem, mesh, states
from tacgen.mechanics.phases import Phase
from tacgen.tensor_engine import grids, planning, pool, refill, scheduler
from tacgen.tensor_engine.dissection import dissected
from tacgen.tensor_engine.grids import GridPattern
from tacgen.tensor_engine.planning import Planned, divided, pools
from tensor_engine.batches import path
from tensor_engine.test_contact import field

torch.set_num_threads(1)
PAD = gel(9, 7, 2.0)


def pressed(shape, *positions, friction=0.0):
    return scene(shape, path(*positions), pad=PAD, friction=friction, edge=1.0)


SCENES = [
    pressed(SphereSdf(1.6), (0, 0, -0.3)),  # the smallest mesh first: later ones have nodes that it lacks
    pressed(BoxSdf(1.4, 1.0, 0.3), (-2.0, 0, -0.2), (-1.5, 0.3, -0.2), friction=0.5),  # narrower than an element
    pressed(SphereSdf(2.5), (2.0, -0.5, -0.3), (2.0, 0.5, 0.4)),
    replace(pressed(SphereSdf(2.0), (0, 0, -0.2)), element="tet"),
]


@pytest.mark.parametrize("slots", [1, 2])
def test_scenes_in_refilled_slots_have_the_cpu_engines_frames(slots):
    use = scheduler.Use()
    found = dict(pool.solved(SCENES, slots=slots, dtype=torch.float64, use=use))
    assert sorted(found) == [0, 1, 2, 3]
    assert found.pop(3) == pool.Solved([], "a mesh of tets")
    assert (use.mean == 1.0) == (slots == 1)
    for number, solved in found.items():
        made = SCENES[number]
        one = list(states(made, Problem.of(made, mesh.of(made))))
        assert solved.why is None
        assert len(solved.states) == len(one) == len(made.poses)
        for a, b in zip(one, solved.states, strict=True):
            force = max(float(a.normal_force.sum()), 1e-6)
            assert b.normal_force == pytest.approx(a.normal_force, abs=1e-9 * force)
            assert b.x == pytest.approx(a.x, abs=1e-9)


def test_indenters_on_grids_follow_each_other_in_a_slot():
    ball, small = SphereSdf(2.5), field(1.5, 0.4)
    shapes = [ball, small, field(2.0, 0.5), ball, small]
    plans = [Planned.of((k, pressed(shape, (0, 0, -0.3)))) for k, shape in enumerate(shapes)]
    first, *others = (pool.PreparedScene.of(plan) for plan in plans)
    slots = pool.ScenePool([first], dissected(plans[0].pattern), "cpu", torch.float64)
    at = torch.tensor([[[0.1, 0.2, -0.2], [0.4, 0.0, 0.3]]], dtype=torch.float64)
    for each in [first, *others]:
        slots.enter(0, each)
        found = slots.batch.shapes.values_at(at)[0]
        assert found.numpy() == pytest.approx(each.scene.shape.distance(at[0].numpy())[0], abs=1e-12)
        assert float(slots.batch.reach[0]) == each.scene.shape.reach
    assert len(slots.batch.shapes.values) <= 2 * small.coefficients.size  # room that is used again


def test_meshes_of_unlike_sizes_share_one_batch():
    plans = [Planned.of(each) for each in enumerate(SCENES[:3])]
    assert len({len(pool.PreparedScene.of(plan).grid.cells) for plan in plans}) == 3
    assert len(set(grids.merged(dict.fromkeys([plan.pattern for plan in plans], 1)).values())) == 1


def test_a_scene_with_other_contact_points_is_refused():
    thin = pressed(SphereSdf(0.4), (0, 0, -0.1))
    plans = [Planned.of(each) for each in enumerate([SCENES[0], thin])]
    assert [plan.kind.points for plan in plans] == [2, 4]
    first, other = (pool.PreparedScene.of(plan) for plan in plans)
    slots = pool.ScenePool([first], dissected(plans[0].pattern), "cpu", torch.float64)
    with pytest.raises(ValueError, match="contact points"):
        refill.fill(slots.batch, 0, other.problem, other.grid)


def test_a_scene_that_goes_on_for_long_is_put_off(monkeypatch):
    monkeypatch.setattr(pool, "MAX_FIRST_CALLS", 9)
    found = dict(pool.solved([SCENES[0], SCENES[1]], slots=1, patient=False))
    assert (len(found[0].states), found[0].why, found[0].late) == (1, None, False)
    assert len(found[1].states) < 2
    assert (found[1].why, found[1].late) == (f"put off after {len(found[1].states)} frames", True)


def test_the_last_scenes_of_a_pool_are_put_off(monkeypatch):
    monkeypatch.setattr(pool, "PUT_OFF_SHARE", 0.5)
    monkeypatch.setattr(scheduler, "MAX_GRACE_CALLS", 0)
    assert sorted(each.late for _, each in pool.solved(SCENES[:3:2], patient=False)) == [False, True]


def test_no_scene_is_put_off_by_a_patient_solver(monkeypatch):
    monkeypatch.setattr(pool, "PUT_OFF_SHARE", 0.5)
    monkeypatch.setattr(pool, "MAX_FIRST_CALLS", 0)
    monkeypatch.setattr(scheduler, "MAX_GRACE_CALLS", 0)
    assert [(each.why, each.late) for _, each in pool.solved(SCENES[:2])] == [(None, False)] * 2


@pytest.mark.parametrize("most", [1, 0])
def test_a_pool_for_which_there_is_no_memory_has_half_as_many_slots(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    made, of = [], pool.ManyScenes.of

    def limited(problems: list, *args: object) -> pool.ManyScenes:
        made.append(len(problems))
        if len(problems) > most:
            raise torch.OutOfMemoryError("full")
        return of(problems, *args)

    monkeypatch.setattr(pool.ManyScenes, "of", limited)
    if most:
        assert {number: each.why for number, each in pool.solved(SCENES[:3])} == {0: None, 1: None, 2: None}
        assert made == [2, 1, 1, 1]  # one of them is refilled; the box has a pool of its own
    else:
        with pytest.raises(torch.OutOfMemoryError):
            list(pool.solved(SCENES[:3]))
        assert made == [2, 1]


def test_less_memory_has_room_for_fewer_scenes():
    tree = dissected(grids.GridPattern((18, 18, 5)))
    large, small = pool.Room.of(tree, 6e9), pool.Room.of(tree, 1e6)
    assert small.slots == 1
    middle, wide = pool.Kind(nodes=72), pool.Kind(nodes=300)
    assert small.fitting(Phase.factor, pool.Kind(), 99) == small.fitting(Phase.contact, middle, 99) == 2
    assert large.slots > 30
    most = [large.fitting(phase, pool.Kind(), 999) for phase in (Phase.factor, Phase.load, Phase.begin)]
    assert 16 <= most[0] < most[1] < most[2]
    assert 16 <= large.fitting(Phase.contact, wide, 999) < large.fitting(Phase.contact, middle, 999)
    assert pool.Room.of(tree, 1.2e10).slots == pytest.approx(2 * large.slots, abs=1)


def test_factorisations_at_once_are_bounded_by_memory(monkeypatch):
    calls, advance = [], pool.engine.advance

    def watched(batch, phase, rows):
        calls.append((phase, len(rows)))
        advance(batch, phase, rows)

    monkeypatch.setattr(pool.Room, "fitting", lambda room, phase, *_: 1 if phase is Phase.factor else 9)
    monkeypatch.setattr(pool.engine, "advance", watched)
    assert len(list(pool.solved(SCENES[:3]))) == 3
    assert {count for phase, count in calls if phase is Phase.factor} == {1}
    assert max(count for _, count in calls) > 1


def test_work_and_kept_numbers_count_padded_fronts():
    tree = dissected(grids.GridPattern((14, 14, 2)))
    panels = sum(np.prod(g.own.shape) * (g.own.shape[1] + g.bound.shape[1]) for g in tree.groups)
    assert tree.kept == 9 * panels
    assert tree.work >= max(group.entries for group in tree.groups)


def test_parts_for_processes_have_scenes_of_one_pool(monkeypatch: pytest.MonkeyPatch) -> None:
    small, large = GridPattern((14, 14, 5)), GridPattern((18, 18, 5))

    def parts(patterns: list[GridPattern | None], count: int) -> list[list[int]]:
        return divided([Planned(k, pattern=pattern) for k, pattern in enumerate(patterns)], count)

    patterns = [small, None, large, small, large, small, small, large]
    assert parts(patterns, 2) == [[0, 2, 3, 4, 5, 6, 7, 1]]  # all in the larger one, and too few for two processes
    monkeypatch.setattr(planning, "MIN_PART_SCENES", 1)
    assert parts(patterns, 2) == [[0, 3, 5, 7], [2, 4, 6, 1]]
    monkeypatch.setattr(grids, "REFERENCE_CELLS", 100)  # where a scene takes as the square of its cells
    assert parts(patterns, 4) == [[2], [4], [7], [0], [3], [5], [6, 1]]  # a process has two small ones, not four
    monkeypatch.setattr(planning, "MIN_PART_SCENES", 2)
    assert parts(patterns, 4) == [[2, 7], [4], [0, 3, 5, 6, 1]]
    assert parts([small], 4) == [[0]]
    assert parts([None, None], 4) == [[0, 1]]
    assert parts([], 4) == []


def test_no_process_begins_a_second_part_when_others_have_ended() -> None:
    """A thousand balls on the Mini: parts no longer than an eighth of the time would be ten."""
    sizes = {GridPattern((22, 18, 5)): 396, GridPattern((22, 22, 5)): 221, GridPattern((18, 18, 5)): 383}
    patterns = [pattern for pattern, count in sizes.items() for _ in range(count)]
    parts = divided([Planned(k, pattern=pattern) for k, pattern in enumerate(patterns)], 8)
    assert sorted(map(len, parts)) == [73, 74, 74, 132, 132, 132, 191, 192]
    assert sorted(k for part in parts for k in part) == [*range(1000)]


def test_scenes_with_other_contact_points_share_pools_of_their_own() -> None:
    small, large = GridPattern((14, 14, 5)), GridPattern((18, 18, 5))
    wide, thin = (
        SimpleNamespace(shape=SimpleNamespace(reach=r, smallest_radius=1), edge=0.5, prony_terms=0, dynamics=None)
        for r in (1, 0.1)
    )
    plans = [Planned(k, s, pattern=p) for k, (s, p) in enumerate([(wide, small), (thin, small), (thin, large)])]  # type: ignore[arg-type]
    assert pools(plans) == {(small, (2, 0, False)): [0], (large, (3, 0, False)): [1, 2]}
    assert pools(plans, share=False) == {
        (small, (2, 0, False)): [0],
        (small, (3, 0, False)): [1],
        (large, (3, 0, False)): [2],
    }
