"""A viscoelastic gel under a ball: limits of the rate, relaxation, hysteresis, convergence in time, labels, recipes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import presses
from helpers.command import told
from helpers.presses import Run, gel, poses
from helpers.small_recipe import HEAD
from scipy.interpolate import PchipInterpolator

from tacgen import mechanics
from tacgen.base.errors import UserError
from tacgen.batch import pipeline
from tacgen.bundle import bundle
from tacgen.bundle.check import check
from tacgen.fem.materials import NeoHooke
from tacgen.geometry.analytic_sdf import SphereSdf
from tacgen.geometry.gel import GelBody
from tacgen.mechanics import mesh
from tacgen.mechanics.scene import GelDynamics
from tacgen.outputs.cauchy_stress import Stresses
from tacgen.recipe import plan, scene_of_row

Array = np.ndarray
ROOT = Path(__file__).parents[2]
PRONY = ((0.1, 0.1), (0.1, 1.0))
BETA, TAU = np.array([0.125, 0.125]), np.array([0.1, 1.0])
DOWN = [-0.1, -0.2, -0.3, -0.4]


def pad(prony: tuple[tuple[float, float], ...] = PRONY, stiffer: float = 1.0, nu: float = 0.49) -> GelBody:
    made = gel(8, 8, 2.0, nu=nu)
    law = made.layers[0].law
    return replace(made, layers=(replace(made.layers[0], law=NeoHooke(stiffer * law.mu, law.kappa), prony=prony),))


def pressed(
    z: list[float],
    seconds: list[float] | None,
    made: GelBody | None = None,
    friction: float = 0.0,
    options: mechanics.SolverOptions = mechanics.DEFAULT_OPTIONS,
    **more: object,
) -> Run:
    """To these heights [mm], on a coarse mesh; `seconds` of each frame."""
    path = presses.scene(SphereSdf(2.5), poses([(0, 0, h) for h in z]), pad=made or pad(), edge=0.7, friction=friction)
    path = replace(path, duration=None if seconds is None else np.array(seconds), **more)
    problem = mechanics.Problem.of(path, mesh.build(path.gel, (-1.6, 1.6, -1.6, 1.6), 0.7), options)
    return Run(path, problem, list(mechanics.states(path, problem)))


def test_fast_and_slow_presses_are_elastic() -> None:
    slow, fast = pressed(DOWN, None, pad(())), pressed(DOWN, None, pad((), 1.25))
    assert fast.forces[-1, 2] < 1.2 * slow.forces[-1, 2]
    assert pressed(DOWN, [1e-6] * 4).forces == pytest.approx(fast.forces, rel=1e-3, abs=1e-6)
    assert pressed(DOWN, [1e6] * 4).forces == pytest.approx(slow.forces, rel=1e-3, abs=1e-6)
    untimed = pressed(DOWN, None)
    assert all((a.x == b.x).all() for a, b in zip(untimed.states, slow.states, strict=True))
    assert not untimed.problem.viscous


def test_a_held_ball_feels_the_gel_relax() -> None:
    """Pressed in at once, a gel that keeps its volume bears less as its shear modulus falls."""
    seconds = [1e-6, 0.03, 0.07, 0.3, 1.0, 5.0]
    found = pressed([-0.3] * 6, seconds, pad(nu=0.4995))
    still = pressed([-0.3], None, pad((), nu=0.4995)).forces[-1, 2]
    expected = 1 + np.exp(-np.cumsum(seconds)[:, None] / TAU) @ BETA
    assert found.forces[:, 2] / still == pytest.approx(expected, rel=1e-3)
    assert max(state.balance for state in found.states) < 1e-3


def test_a_release_gives_back_less_than_the_press_took() -> None:
    found = pressed([*DOWN, *DOWN[-2::-1]], [0.1] * 7, friction=0.4)
    push = -found.forces[:, 2]
    assert (push[4:] < 0.97 * push[2::-1]).all()
    elastic = pressed([*DOWN, *DOWN[-2::-1]], None, friction=0.4)
    there = -elastic.forces[:, 2]
    lost, by_friction = 1 - push[3:].sum() / push[:4].sum(), 1 - there[3:].sum() / there[:4].sum()
    assert 0.03 < lost < 0.2
    assert abs(by_friction) < 0.01


def test_halved_frames_converge_at_second_order() -> None:
    sharp = replace(mechanics.DEFAULT_OPTIONS, residual_tol=2e-5, step_tol=1e-3)
    ends = [pressed([-0.5 * (k + 1) / n for k in range(n)], [0.5 / n] * n, options=sharp) for n in (1, 2, 4, 8)]
    change = np.diff([found.forces[-1, 2] for found in ends])
    assert 1.5 < np.log2(change[0] / change[2]) / 2 < 2.5, change
    assert abs(change[0]) < 0.02 * abs(ends[-1].forces[-1, 2])


def test_the_oracle_agrees() -> None:
    fast, true = (
        pressed(DOWN, [0.1] * 4, None, 0.4, options) for options in (mechanics.DEFAULT_OPTIONS, mechanics.plain())
    )
    assert fast.forces[:, 2] == pytest.approx(true.forces[:, 2], rel=5e-3)


def test_a_slow_press_of_a_gel_with_mass_is_the_same() -> None:
    light = GelDynamics(1e-12, 0.0, 0.0, np.inf)
    one, other = pressed(DOWN, [0.1] * 4), pressed(DOWN, [0.1] * 4, dynamics=light)
    assert other.forces == pytest.approx(one.forces, rel=2e-3, abs=1e-6)


def test_each_layer_has_its_own_series() -> None:
    one = pad().layers[0]
    base, skin = replace(one, thickness=1.0, prony=()), replace(one, thickness=1.0)
    both = [pressed(DOWN[:2], [0.01] * 2, replace(pad(), layers=layers)) for layers in ((base, skin), (skin, skin))]
    assert [set(found.states[-1].internal) for found in both] == [{1}, {0, 1}]
    elastic = pressed(DOWN[:2], None, pad(())).forces[-1, 2]
    assert 1.02 * elastic > both[0].forces[-1, 2] > 1.02 * both[1].forces[-1, 2]


def test_the_stress_on_the_face_bears_the_viscous_part() -> None:
    found = pressed([-0.4], [1e-3])
    state, made = found.states[-1], Stresses(found.problem)
    whole = made.quality(made.at(state.x, found.problem.stressed(state.internal)), state)
    elastic = made.quality(made.at(state.x), state)
    assert whole["force_error"] < 0.05
    assert elastic["force_error"] > whole["force_error"] + 0.1


OVERRIDE = """\
sensor_overrides:
  "gel.layers[0].prony": [{g: 0.1, tau_s: 0.3}]
"""
RECIPE = f"""{HEAD}\
  - press: {{depth_mm: 0.5, frames: 2, duration_s: 0.2}}
  - hold: {{frames: 2, duration_s: 1}}
{OVERRIDE}"""


def recipe(folder: Path, text: str = RECIPE) -> Path:
    path = folder / "recipe.yaml"
    path.write_text(text)
    return path


def test_a_recipe_asks_for_it_and_its_bytes_repeat(tmp_path: Path) -> None:
    row = plan.load(recipe(tmp_path)).rows[0]
    found = [pipeline.run_scene(row, tmp_path / name).path for name in ("one", "two")]
    assert check(found[0]) == []
    assert found[0].read_bytes() == found[1].read_bytes()
    kept = bundle.read(found[0])
    assert kept["/frames/time"] == pytest.approx([0.1, 0.2, 0.7, 1.2])
    push = -kept["/frames/force"][:, 2]
    assert 0.85 < push[3] / push[1] < 0.97
    assert "notes" not in kept.attrs or "prony" not in kept.attrs["notes"]


def test_a_speed_is_a_duration_over_the_way(tmp_path: Path) -> None:
    moves = """\
  - press: {depth_mm: 0.5, frames: 2, speed_mm_s: 5}
  - slide: {x_mm: 0.3, y_mm: -0.4, frames: 1, speed_mm_s: 0.1}
  - hold: {frames: 1, duration_s: 2}
  - press: {depth_mm: 0.2, frames: 1, speed_mm_s: 3}
  - release: {frames: 2, speed_mm_s: 0.1}
"""
    text = HEAD.replace("trajectory:", "start: {clearance_mm: 0.1}\ntrajectory:") + moves + OVERRIDE
    found = scene_of_row.build(plan.load(recipe(tmp_path, text)).rows[0]).duration
    assert found == pytest.approx([0.06, 0.06, 5, 2, 0.1, 1.5, 1.5])
    still = recipe(tmp_path, text.replace("x_mm: 0.3, y_mm: -0.4", "x_mm: 0"))
    with pytest.raises(UserError, match=r"trajectory\[1\].slide.speed_mm_s: takes no time, since nothing moves"):
        scene_of_row.build(plan.load(still).rows[0])


@pytest.mark.slow
def test_the_shipped_recipe_relaxes_and_loses_what_it_says(tmp_path: Path) -> None:
    row = plan.load(ROOT / "recipes/relaxation.yaml", ["quality=draft", "outputs=[force]"]).rows[0]
    kept = bundle.read(pipeline.run_scene(row, tmp_path).path)
    push, depth = -kept["/frames/force"][:, 2], 1 - np.abs(np.arange(-5, 6)) / 5
    assert 1 - push[9] / push[4] == pytest.approx(0.037, abs=2e-3)
    curve = PchipInterpolator(depth[:6], [0, *push[:5]]), PchipInterpolator(depth[:4:-1], push[:8:-1])
    assert 1 - curve[1].integrate(0, 1) / curve[0].integrate(0, 1) == pytest.approx(0.09, abs=5e-3)


UNTIMED = RECIPE.replace(", duration_s: 0.2", "").replace(", duration_s: 1", "")


def test_without_durations_it_is_elastic_and_says_so(tmp_path: Path) -> None:
    note = "no movement says how long it takes: every frame is an equilibrium, and the gel's prony has no effect"
    assert note in told("validate", recipe(tmp_path, UNTIMED))
    assert note not in told("validate", recipe(tmp_path))
    kept = bundle.read(pipeline.run_scene(plan.load(recipe(tmp_path, UNTIMED)).rows[0], tmp_path / "still").path)
    assert note in kept.attrs["notes"]
    assert "/frames/time" not in kept
    elastic = plan.load(recipe(tmp_path, UNTIMED.removesuffix(OVERRIDE))).rows[0]
    there = bundle.read(pipeline.run_scene(elastic, tmp_path / "elastic").path)
    assert (kept["/frames/force"] == there["/frames/force"]).all()


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (", duration_s: 1}", "}", "trajectory[1].hold: must say how long it takes: duration_s, as others do"),
        (OVERRIDE, "", "trajectory[0].press.duration_s: has no effect without dynamics or a viscoelastic gel"),
        ("0.2}", "0.2, speed_mm_s: 1}", "trajectory[0].press: must hold at most one of duration_s, speed_mm_s"),
        ("depth_mm: 0.5, frames: 2, duration_s: 0.2", "force_n: 1, frames: 2, speed_mm_s: 1",
         "trajectory[0].press.speed_mm_s: needs a way that is known, which force_n leaves open: say duration_s"),
        ("g: 0.1", "g: 1.0", "gel.layers[0].prony[0].g: must be less than 1 (got 1)"),
        ("[{g", "[{g: 0.9, tau_s: 1}, {g", "gel.layers[0].prony: must have g that add up to less than 1 (got 1)"),
        ("0.3}]", "0.3}]\n  gel.layers[0].law: stable_neo_hooke", "gel.layers[0].prony: is a key of law: neo"),
    ],
)  # fmt: skip
def test_the_impossible_is_reported(tmp_path: Path, old: str, new: str, told: str) -> None:
    text = RECIPE.replace(old, new)
    assert text != RECIPE
    with pytest.raises(UserError) as caught:
        plan.load(recipe(tmp_path, text))
    assert told in caught.value.lines[0]
