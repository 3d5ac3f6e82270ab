"""The batch engine gives the CPU engine's frames: forces, positions and all that is recorded of them."""

from dataclasses import fields, replace

import numpy as np
import pytest
from helpers.needs import needs

torch = needs("torch")

from helpers.presses import gel, poses, scene, thin_plate

from tacgen.fem.materials import EXAMPLE_LAWS
from tacgen.geometry.analytic_sdf import BoxSdf, CylinderSdf, SphereSdf
from tacgen.geometry.gel import GelBody, GelLayer
from tacgen.mechanics import DEFAULT_OPTIONS, SolverOptions, State, measures
from tacgen.mechanics import bulk_newton as newton
from tacgen.mechanics.numerics import Numerics
from tacgen.mechanics.phases import FINAL_PHASES, PHASE_TRANSITIONS, Outcome, Phase
from tacgen.mechanics.scene import Scene
from tacgen.mechanics.solver import PHASE_KERNELS
from tacgen.tensor_engine import bulk_newton as tensor_bulk
from tacgen.tensor_engine import engine, load_step, pool
from tacgen.tensor_engine.engine import Solved
from tacgen.tensor_engine.planning import Planned, lacks
from tensor_engine.batches import alone, batch, path, small, solve
from tensor_engine.test_contact import sharp_field

torch.set_num_threads(1)
BALL = SphereSdf(2.5)


def same(one: State, many: State, tolerance: float = 1e-9) -> None:
    """All of a frame's record but the history that goes with it."""
    force = max(float(one.normal_force.sum()), 1e-6)
    for name in (f.name for f in fields(State) if f.name not in ("after", "passed", "internal")):
        a, b = getattr(one, name), getattr(many, name)
        if a is None or b is None:
            assert a is b, name
        elif isinstance(a, str):
            assert a == b, name
        else:
            scale = force if name in ("normal_force", "friction") else 1.0
            assert np.asarray(b, float) == pytest.approx(np.asarray(a, float), abs=tolerance * scale), name
    assert (one.after is None) == (many.after is None)


def all_same(
    scenes: list[Scene], found: list[Solved], tolerance: float = 1e-9, options: SolverOptions = DEFAULT_OPTIONS
) -> None:
    for made, solved in zip(scenes, found, strict=True):
        assert solved.why is None
        one = alone(made, options)
        assert len(solved.states) == len(one) == len(made.poses)
        for a, b in zip(one, solved.states, strict=True):
            same(a, b, tolerance)


def test_presses_of_different_depth_radius_and_modulus_at_once() -> None:
    scenes = [
        small(SphereSdf(2.0 + 0.4 * k), path((0.1 * k, 0, -0.1 - 0.1 * k), (0, 0, -0.5)), E=0.1 + 0.05 * k)
        for k in range(3)
    ]
    all_same(scenes, solve(batch(scenes), scenes))


@pytest.mark.parametrize("fold_halvings", [0, 2])
def test_slide_twist_tilt_and_release_with_friction(fold_halvings: int) -> None:
    """Points stick and slide; frames have several load steps. Without halving some are damped, which amplifies
    rounding."""
    moves = path(
        (0, 0, -0.3), (0.8, 0.2, -0.35), (0.8, 0.2, -0.35), (0.8, 0.2, -0.35), (0.8, 0.2, 0.5),
        turns=[(0, 0, 0), (0, 0, 0), (0, 0, 0.25), (0.06, 0, 0), (0, 0, 0)],
    )  # fmt: skip
    shapes = (BALL, CylinderSdf(1.3, 0.2))
    scenes = [small(shape, moves, friction=0.4 + 0.3 * k) for k, shape in enumerate(shapes)]
    options = replace(DEFAULT_OPTIONS, fold_halvings=fold_halvings)
    found = solve(batch(scenes, options), scenes)
    all_same(scenes, found, 1e-6, options)
    states = [state for each in found for state in each.states]
    assert max(state.substeps for state in states) > 1
    assert any(state.damped for state in states) == (fold_halvings == 0)
    rubbed = [state for state in states if state.normal_force.any()]
    assert any(state.sliding[state.normal_force > 0].all() for state in rubbed)
    assert any(not state.sliding.any() for state in rubbed)
    assert not states[-1].normal_force.any()  # released


@pytest.mark.parametrize("frames", [2, 3])
def test_a_step_without_contact_leaves_no_error_of_a_prediction_to_learn_from(frames: int) -> None:
    made = small(BALL, path((0, 0, -0.3), (0, 0, 0.5), (0, 0, 0.6))[:frames])
    b = batch([made])
    all_same([made], solve(b, [made]))
    assert bool(b.t.h_motion.any()) == (frames == 2)


def test_a_scene_that_fails_leaves_the_others_alone() -> None:
    scenes = [small(BALL, path((0, 0, -0.3))), small(SphereSdf(1.2), path((0, 0, -0.2), (0, 0, -1.9)), friction=1.0)]
    options = replace(DEFAULT_OPTIONS, max_effort=4, halvings=1)
    found = solve(batch(scenes, options), scenes)
    assert found[0].why is None
    same(alone(scenes[0], options)[0], found[0].states[0])
    assert len(found[1].states) == 1
    assert "Newton did not converge in 4 steps" in str(found[1].why)


def test_a_tangent_that_is_not_definite_is_projected_in_its_scene_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = [small(BALL, path((0, 0, -0.2))), small(SphereSdf(1.2), path((0, 0, -0.9)))]
    b = batch(scenes)
    solve(b, scenes)
    factor, calls = b.factors.factor, []

    def refusing(
        slots: torch.Tensor, K: torch.Tensor, nodes: torch.Tensor, fewest: int
    ) -> tuple[torch.Tensor, torch.Tensor]:
        calls.append((slots.tolist(), float(torch.linalg.eigvalsh(K).min())))
        good, S = factor(slots, K, nodes)
        return good & (slots == 0) if len(calls) < 3 else good, S

    monkeypatch.setattr(b.factors, "factor", refusing)
    b.t.x[1, :, 2] *= 0.8  # squeezed
    assert load_step.take(b, [0, 1], "x", False) == [True, True]
    assert [slots for slots, _ in calls] == [[0, 1], [1], [1]]
    least = [value for _, value in calls]
    assert least[0] < -1e-3
    assert least[2] > -1e-9
    assert all(scene.usable for scene in b.scenes)


def test_layers_and_laws_may_differ_from_scene_to_scene() -> None:
    laws = list(EXAMPLE_LAWS.values())

    def layered(k: int) -> Scene:
        layers = (GelLayer(1.2, laws[k], 0.15), GelLayer(0.8, laws[k - 1], 0.2))
        pad = GelBody(6.0, 6.0, layers=layers)
        return replace(small(BALL, path((0, 0, -0.4)), friction=0.3), gel=pad)

    scenes = [layered(k) for k in range(len(laws))]
    all_same(scenes, solve(batch(scenes), scenes))


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-9), (torch.float32, 1e-5)])
def test_meshes_embedded_in_one_pattern_with_multifrontal_factors(dtype: torch.dtype, tolerance: float) -> None:
    """A pad whose grid is smaller than the pattern; factors in single precision move forces by far less than 1e-3."""
    made = [
        scene(SphereSdf(2 + k), poses([(0.1, 0, -0.3), (0.5, 0, -0.3)]), pad=gel(8, 9 + k, 2.0), friction=0.5, edge=1.0)
        for k in range(2)
    ]
    assert len({Planned.of((0, one)).pattern for one in made}) == 1
    solved = dict(pool.solved(made, dtype=dtype, share=False))
    for one, each in zip(made, (solved[0], solved[1]), strict=True):
        assert each.why is None
        for state, expected in zip(each.states, whole(one), strict=True):
            force, right = state.traction_force.sum((0, 1)), expected.traction_force.sum((0, 1))
            assert np.linalg.norm(force - right) < tolerance * np.linalg.norm(right)
            assert state.x.shape == expected.x.shape
            assert state.x == pytest.approx(expected.x, abs=max(tolerance, 1e-8))


def test_a_plate_that_is_pressed_to_its_middle_has_the_cpu_engines_force() -> None:
    made = replace(scene(thin_plate(), poses([(0, 0, -0.2)]), pad=gel(6, 6, 2.0), edge=0.8), dhat=0.01)
    ((_, solved),) = pool.solved([made], dtype=torch.float64, share=False)
    assert solved.why is None
    force, right = (state.traction_force.sum((0, 1)) for state in (solved.states[0], whole(made)[0]))
    assert right[2] < -0.1
    assert np.linalg.norm(force - right) < 1e-6


def whole(made: Scene) -> list[State]:
    from tacgen.mechanics import Problem, mesh, states

    return list(states(made, Problem.of(made, mesh.of(made))))


def test_what_the_engine_lacks_is_said() -> None:
    made = small(BALL, path((0, 0, -0.2)))
    assert lacks(made) is None
    assert lacks(replace(made, duration=np.ones(1))) is None
    for changed, said in (
        (replace(made, element="tet"), "a mesh of tets"),
        (replace(made, shape=sharp_field()), "exact edges"),
    ):
        assert lacks(changed) == said


AT_ONCE = replace(DEFAULT_OPTIONS, sink=np.inf, slide=np.inf, slide_sharp=np.inf)
BOX = BoxSdf(1.6, 1.6, 0.1)
PRESS, RUB = path((0, 0, -0.3)), path((1.2, 0, -0.9))
RUNS = {  # shape, path and options; what is replaced, and by what
    "two load steps": (BALL, PRESS, replace(DEFAULT_OPTIONS, sink=0.2), None, "", None),
    "far away": (BALL, path((0, 0, 3.0)), DEFAULT_OPTIONS, None, "", None),
    "punch, pressed deep": (CylinderSdf(0.9, 0.1), path((0, 0, -1.2)), replace(DEFAULT_OPTIONS, sink=np.inf), None,
    "", None),
    "in circles": (BOX, RUB, replace(AT_ONCE, max_contact=1), None, "", None),
    "folds end it": (BOX, RUB, replace(AT_ONCE, through_folds=False), None, "", None),
    "out of steps": (BALL, PRESS, replace(DEFAULT_OPTIONS, max_newton=1, halvings=1), None, "", None),
    "out of effort": (BALL, PRESS, replace(DEFAULT_OPTIONS, max_effort=1), None, "", None),
    "out of balance": (BALL, PRESS, replace(DEFAULT_OPTIONS, residual_max=1e-300, halvings=0), None, "", None),
    "no damping": (BOX, RUB, replace(AT_ONCE, halvings=0), newton, "MAX_DAMPING", -1.0),
    "no step lowers the energy": (BALL, PRESS, replace(DEFAULT_OPTIONS, halvings=0), measures, "MIN_ENERGY_GAIN",
    1e9),
    "too far": (BALL, PRESS, DEFAULT_OPTIONS, load_step, "blocked", lambda b, s, x: torch.ones(len(s),
    dtype=torch.bool)),
    "no tangent": (BALL, PRESS, replace(DEFAULT_OPTIONS, halvings=0), load_step, "take", lambda b, s,
    *_: [False] * len(s)),
}  # fmt: skip


def edges(name: str, patch: pytest.MonkeyPatch) -> set[tuple[Phase, Outcome]]:
    """The outcomes of the kernels in a run, which never leave the table."""
    shape, moves, options, module, patched, by = RUNS[name]
    if module is not None:
        patch.setattr(module, patched, by)
        if patched == "take":
            patch.setattr(tensor_bulk, patched, by)
    seen, advance = set(), engine.advance

    def watched(b: object, phase: Phase, rows: list[int]) -> None:
        kernel = PHASE_KERNELS[phase]

        def noted(b: Numerics, rows: list[int]) -> list[Outcome]:
            outcomes = kernel(b, rows)
            seen.update((phase, outcome) for outcome in outcomes)
            return outcomes

        with pytest.MonkeyPatch.context() as inner:
            inner.setitem(PHASE_KERNELS, phase, noted)
            advance(b, phase, rows)

    patch.setattr(engine, "advance", watched)
    made = small(shape, moves, friction=0.6)
    solved = solve(batch([made], options), [made])
    assert (solved[0].why is None) == (len(solved[0].states) == 1)
    return seen


def test_kernels_return_all_that_the_table_has_for_a_condensed_contact_and_no_more() -> None:
    table = {(phase, outcome) for phase, row in PHASE_TRANSITIONS.items() for outcome in row}
    elsewhere = {(Phase.begin, Outcome.not_condensed), (Phase.start, Outcome.not_condensed)}
    elsewhere |= {(Phase.whole, outcome) for outcome in PHASE_TRANSITIONS[Phase.whole]}
    seen = set()
    for name in RUNS:
        with pytest.MonkeyPatch.context() as patch:
            seen |= edges(name, patch)
    assert seen == table - elsewhere
    assert FINAL_PHASES.isdisjoint({phase for phase, _ in seen})
