"""Viscoelastic gels and gels with inertia in the batch engine: the CPU engine's frames, and forces that are met."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.needs import needs

torch = needs("torch")

from helpers.presses import gel, poses, scene

from tacgen.fem.elasticity import Elastic
from tacgen.fem.materials import EXAMPLE_LAWS, Law
from tacgen.fem.projection import Projection
from tacgen.fem.viscoelasticity import Step, Viscoelastic
from tacgen.geometry.analytic_sdf import BoxSdf, SphereSdf
from tacgen.geometry.gel import GelBody, GelLayer
from tacgen.mechanics import DEFAULT_OPTIONS
from tacgen.mechanics.scene import GelDynamics, Scene
from tacgen.tensor_engine import pool
from tacgen.tensor_engine.replay import Replays
from tensor_engine.batches import batch, path, small, solve
from tensor_engine.test_elements import Case, full
from tensor_engine.test_engine import all_same, whole
from tensor_engine.test_forces import forced

torch.set_num_threads(1)
ONE, TWO = ((0.3, 0.5),), ((0.2, 0.05), (0.2, 2.0))
YEOH, NEO = EXAMPLE_LAWS["yeoh"], EXAMPLE_LAWS["neo_hooke"]
ISOCHORIC = [name for name in EXAMPLE_LAWS if name != "stable_neo_hooke"]


def pad(*layers: tuple[float, Law, tuple[tuple[float, float], ...]]) -> GelBody:
    """Layers of a thickness [mm], a law and a Prony series."""
    return GelBody(6.0, 6.0, layers=tuple(GelLayer(high, law, 0.15, prony) for high, law, prony in layers))


def timed(made: Scene, seconds: list[float], made_of: GelBody) -> Scene:
    return replace(made, gel=made_of, duration=np.array(seconds))


MOVES = path((0, 0, -0.3), (0, 0, -0.3), (0.4, 0.1, -0.35), (0, 0, 0.2))
SCENES = [
    timed(small(SphereSdf(2.5), MOVES, friction=0.5), [0.1, 0.6, 0.2, 0.1], pad((1.2, YEOH, TWO), (0.8, YEOH, TWO))),
    timed(small(SphereSdf(2.0), MOVES), [1.0, 1.0, 1e-3, 2.0], pad((1.2, NEO, ()), (0.8, NEO, ONE))),
    timed(small(SphereSdf(2.0), MOVES, 0.8), [0.3] * 4, pad((1.2, YEOH, TWO), (0.8, NEO, ONE))),
]


def test_frames_are_those_of_the_cpu_engine() -> None:
    """Gels of one and of more layers, which relax at different rates or not at all, in steps of different length."""
    found = solve(batch(SCENES), SCENES)
    all_same(SCENES, found, 1e-8)
    press, held = (found[0].states[k].normal_force.sum() for k in range(2))
    assert held < 0.95 * press  # it has relaxed
    elastic = replace(SCENES[0], duration=None)
    assert solve(batch([elastic]), [elastic])[0].states[1].normal_force.sum() < 0.95 * held


def test_a_force_is_found_from_the_internal_variables_before_its_trials() -> None:
    made = timed(small(SphereSdf(2.5), MOVES[:3], 0.5), [0.1, 0.6, 0.2], pad((2.0, YEOH, ONE)))
    made = forced(made, [0.3, 0.3, np.nan])
    found = solve(batch([made]), [made])
    all_same([made], found, 1e-7)
    assert found[0].states[1].pose[2, 3] < found[0].states[0].pose[2, 3] - 0.01  # it creeps


def test_damping_is_over_the_long_term_stiffness_at_rest() -> None:
    moves = path((1.2, 0, -0.9))
    made = timed(small(BoxSdf(1.6, 1.6, 0.1), moves, friction=0.6), [0.3], pad((2.0, NEO, ((0.7, 0.5),))))
    options = replace(DEFAULT_OPTIONS, fold_halvings=0, sink=np.inf, slide=np.inf)
    found = solve(batch([made], options), [made])
    all_same([made], found, 1e-6, options)
    assert any(state.damped for state in found[0].states)


def test_scenes_follow_each_other_in_a_slot_and_elastic_ones_are_solved_apart() -> None:
    moves, series = poses([(0.1, 0, -0.2), (0.3, 0, -0.3)]), [(ONE, ONE), ((), ()), ((), ONE), (TWO, ONE)]
    gels = [replace(pad((1.2, YEOH, below), (0.8, NEO, above)), width=8.0) for below, above in series]
    made = [
        timed(scene(SphereSdf(2 + k), moves, friction=0.5, edge=1.0), [0.1, 0.3], each) for k, each in enumerate(gels)
    ]
    solved = dict(pool.solved(made, dtype=torch.float64, slots=1))
    for k, one in enumerate(made):
        assert solved[k].why is None
        for state, expected in zip(solved[k].states, whole(one), strict=True):
            force, right = state.traction_force.sum((0, 1)), expected.traction_force.sum((0, 1))
            assert np.linalg.norm(force - right) < 1e-8 * np.linalg.norm(right)


@pytest.mark.parametrize("projection", Projection)
def test_energy_forces_and_tangents_with_memory_are_those_of_one_scene(projection: Projection) -> None:
    case, r, h = Case(), np.random.default_rng(3), 0.2
    rows = [k for k, one in enumerate(case.one) if one.law in [EXAMPLE_LAWS[name] for name in ISOCHORIC]]
    assert len(rows) == len(ISOCHORIC)
    x, start, slots = case.tensor(case.x), case.tensor(case.taken), torch.tensor(rows)
    s, many = case.many.isochoric_stress(start), case.many
    ends = many.isochoric_stress(x)
    factors = Viscoelastic.of(case.one[0], TWO).factors(h)
    step = Step(*torch.tensor(factors[:, None, :, None, None, None, None]))
    H = torch.tensor(r.normal(scale=0.05, size=(len(case.one), 2, *many.weights.shape[1:], 3, 3)))
    H = H + H.mT
    laws = many.laws.clone()
    laws[..., :5] *= 1 + float(step.stiffening)
    moving = replace(many, laws=laws, memory=step.memory(H, s)).rows(slots)
    J, forces = moving.gradient(x[slots])
    K = moving.tangents(x[slots], projection=projection)[1]
    for k, row in enumerate(rows):
        gel = Viscoelastic.of(case.one[row], TWO)
        one: Elastic = gel.step(H[row].numpy(), case.taken[row], h)
        at, data = one.evaluate(case.x[row]), np.zeros(len(case.pattern.indices))
        g = one.forces(at, len(case.x[row]))
        assert float(moving.energy(x[slots])[k]) == pytest.approx(at.energy, rel=1e-11)
        assert J[k].numpy() == pytest.approx(at.J, abs=1e-13)
        assert forces[k].numpy() == pytest.approx(g, abs=1e-11 * np.abs(g).max())
        one.add_tangent(at, data, projection)
        wanted = full(case.pattern, data)
        assert case.assembled(K, k) == pytest.approx(wanted, abs=1e-9 * np.abs(wanted).max())
        after = gel.after(H[row].numpy(), case.taken[row], case.x[row], h)
        assert step.after(H, s, ends)[row].numpy() == pytest.approx(after, abs=1e-12)


TAPS = path((0, 0, -0.25), (0, 0, -0.25), (0.2, 0, -0.3), (0, 0, 0.3), (0, 0, 0.4))


def tapped(made: Scene, seconds: float, longest: float, prony: tuple[tuple[float, float], ...] = ()) -> Scene:
    """Gels of a ton per litre, so that a few milliseconds are short."""
    dynamics = GelDynamics(1e-6, 20.0, 2e-4, longest)
    return replace(timed(made, [seconds] * len(TAPS), pad((2.0, NEO, prony))), dynamics=dynamics)


@pytest.mark.parametrize("prony", [(), ONE])
def test_gels_with_inertia_move_as_by_the_cpu_engine(prony: tuple[tuple[float, float], ...]) -> None:
    """Also where nothing touches them, and in steps that divide a frame."""
    scenes = [
        tapped(small(SphereSdf(2.5), TAPS, friction=0.5), 5e-3, 5e-3, prony),
        tapped(small(SphereSdf(2.0), TAPS), 2e-2, 8e-3, prony),
    ]
    found = solve(batch(scenes), scenes)
    all_same(scenes, found, 1e-7)
    assert {state.substeps for state in found[1].states} >= {3}
    slow = replace(scenes[0], dynamics=None)
    (still,) = solve(batch([slow]), [slow])
    forces = [[each.states[k].normal_force.sum() for k in range(2)] for each in (found[0], still)]
    assert abs(forces[0][0] / forces[1][0] - 1) > 0.05
    ended = [np.abs(each.states[-1].x - found[0].states[-2].x).max() for each in (found[0], still)]
    assert ended[0] > 1e-3  # it swings, out of contact


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-9), (torch.float32, 1e-6)])
def test_scenes_with_inertia_follow_each_other_in_a_slot(dtype: torch.dtype, tolerance: float) -> None:
    moves = poses([(0.1, 0, -0.2), (0.1, 0, 0.3), (0.1, 0, 0.4)])
    made = [scene(SphereSdf(2 + k), moves, pad=gel(8, 8, 2.0), friction=0.5, edge=1.0) for k in range(2)]
    made = [replace(one, duration=np.full(3, 5e-3), dynamics=GelDynamics(1e-6, 20.0, 2e-4, 5e-3)) for one in made]
    solved = dict(pool.solved(made, dtype=dtype, slots=1))
    for k, one in enumerate(made):
        assert solved[k].why is None
        for state, expected in zip(solved[k].states, whole(one), strict=True):
            assert state.x == pytest.approx(expected.x, abs=tolerance)


def test_recorded_work_ends_where_other_work_does() -> None:
    """As on a GPU."""
    for scenes in (SCENES, [tapped(small(SphereSdf(2.5), TAPS, friction=0.5), 5e-3, 5e-3, ONE)] * 2):
        wanted, recorded = solve(batch(scenes), scenes), batch(scenes)
        recorded.replays = Replays(recorded.X.device, on=True)
        for one, other in zip(solve(recorded, scenes), wanted, strict=True):
            assert one.why is None
            for state, same in zip(one.states, other.states, strict=True):
                assert state.x == pytest.approx(same.x, abs=1e-8)
        assert recorded.replays.count > 20
