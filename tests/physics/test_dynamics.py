"""A gel with mass: slow is quasi-static, fast is stiffer, a gel let go rings down, and time converges."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import presses
from helpers.load_steps import watched
from helpers.presses import Run, gel, poses
from helpers.small_recipe import HEAD

from tacgen import mechanics
from tacgen.base.errors import UserError
from tacgen.batch import pipeline
from tacgen.bundle import bundle
from tacgen.bundle.check import check
from tacgen.geometry.analytic_sdf import SphereSdf
from tacgen.mechanics.course import Course
from tacgen.mechanics.scene import GelDynamics
from tacgen.recipe import plan, scene_of_row

Array = np.ndarray
DOWN = [(0.0, 0.0, -0.1 * k) for k in range(1, 5)]


def tap(path: list[tuple[float, float, float]], seconds: float, longest: float = np.inf, friction: float = 0.0,
        alpha: float = 0.0, beta: float = 0.0, density: float = 1e-9) -> Run:  # fmt: skip
    """Small and coarse; `seconds` for all of the path, none for quasi-static."""
    made = presses.scene(SphereSdf(2.5), poses(path), pad=gel(8, 8, 2.0), edge=0.7, friction=friction)
    if seconds:
        each = np.full(len(path), seconds / len(path))
        made = replace(made, dynamics=GelDynamics(density, alpha, beta, longest), duration=each)
    return presses.run(made)


def test_a_slow_press_is_quasi_static() -> None:
    still, slow = (tap(DOWN, seconds, friction=0.4, beta=1e-4).forces for seconds in (0, 2.0))
    assert slow[:, 2] == pytest.approx(still[:, 2], rel=5e-3)


@pytest.mark.parametrize(("beta", "more"), [(0.0, 0.15), (1e-4, 0.8)])
def test_a_fast_tap_takes_more_force(beta: float, more: float) -> None:
    """With inertia alone and still more with damping; every force is in balance, inertia counted."""
    still, fast = (tap(DOWN, seconds, 2.5e-5, beta=beta) for seconds in (0, 2e-4))
    assert fast.forces[-1, 2] < (1 + more) * still.forces[-1, 2]
    for state in fast.states:
        assert state.balance < 1e-3
        assert state.residual < 1e-3
        assert state.min_gap > 0


def test_the_base_bears_another_force_than_the_indenter_gives() -> None:
    """The difference is what the gel's own acceleration takes, and nothing at rest."""
    fast = tap(DOWN, 4e-4, alpha=0.0)
    held = np.unique(fast.problem.mesh.facets["bonded"])
    inner = sum(part.gradient(fast.states[-1].x) for part in fast.problem.elastic)
    assert abs(inner[held, 2].sum() - fast.forces[-1, 2]) > 0.05 * -fast.forces[-1, 2]


@pytest.mark.slow
def test_force_converges_with_the_step_in_time_at_first_order() -> None:
    steps = np.array([4, 8, 16, 64])
    found = [tap([(0.0, 0.0, -0.4)], 1.6e-3, 1.6e-3 / n, beta=2e-4).forces[-1, 2] for n in steps]
    errors = np.abs(np.array(found[:-1]) - found[-1])
    assert -np.polyfit(np.log(steps[:-1]), np.log(errors), 1)[0] == pytest.approx(1.0, abs=0.25), found


def test_a_gel_let_go_springs_back_and_comes_to_rest() -> None:
    """A ball snatched away leaves the dent behind it, which closes in its own time."""
    up = [(0.0, 0.0, 1.0)] * 12
    quick = tap([*DOWN, *up], 16 * 1e-4, beta=5e-5)
    rest = quick.problem.mesh.points
    middle = np.argmin(np.linalg.norm(rest, axis=1))
    dent = np.array([state.x[middle, 2] for state in quick.states])
    assert np.abs(quick.forces[4:]).max() == 0
    assert 0.8 * dent[3] < dent[4] < 0.5 * dent[3]  # not yet closed
    assert dent.max() > 0.01  # beyond flat
    late = tap([*DOWN, *up[:1]], 5 * 0.5, beta=5e-5)
    assert np.abs(late.states[-1].x - rest).max() < 2e-3


def test_halved_steps_halve_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    def careful(now: Course) -> mechanics.NotConverged | None:
        far = np.linalg.norm(now.legs[0].b[:3, 3] - now.history.pose.position) > 0.06
        return mechanics.NotConverged(mechanics.Failure.newton, steps=1) if far else None

    with monkeypatch.context() as patched:
        taken = watched(patched, careful)
        found = tap(DOWN[:2], 8e-4)
    assert [leg.duration for leg in taken] == pytest.approx([2e-4] * 4)
    assert [state.substeps for state in found.states] == [2, 2]
    asked = tap(DOWN[:2], 8e-4, 2e-4)
    assert found.forces == pytest.approx(asked.forces, abs=1e-6)


ALL_BUT_MOVES = HEAD.removesuffix("trajectory:\n")
RECIPE = f"""{ALL_BUT_MOVES}\
dynamics: {{density_kg_m3: 1050, rayleigh: {{alpha_per_s: 5, beta_s: 1.0e-4}}, frame_s: 0.002, step_s: 0.001}}
trajectory:
  - press: {{depth_mm: 0.5, frames: 2, duration_s: 0.003}}
  - hold: {{frames: 1}}
"""


def recipe(folder: Path, text: str = RECIPE) -> Path:
    path = folder / "recipe.yaml"
    path.write_text(text)
    return path


def test_a_recipe_asks_for_it_and_the_bundle_tells_the_time(tmp_path: Path) -> None:
    row = plan.load(recipe(tmp_path)).rows[0]
    made = scene_of_row.build(row).dynamics
    assert made is not None
    assert (made.density, made.alpha, made.beta, made.longest) == (pytest.approx(1.05e-9), 5, 1e-4, 1e-3)
    found = pipeline.run_scene(row, tmp_path / "out")
    assert check(found.path) == []
    kept = bundle.read(found.path)
    assert kept["/frames/time"] == pytest.approx([0.0015, 0.003, 0.005])
    assert kept["/frames/quality/substeps"].tolist() == [2, 2, 2]
    still = plan.load(recipe(tmp_path), ["dynamics=null", "trajectory[0].press.duration_s=null"]).rows[0]
    assert "/frames/time" not in bundle.read(pipeline.run_scene(still, tmp_path / "still").path)


def test_a_replay_keeps_its_own_time(tmp_path: Path) -> None:
    (tmp_path / "poses.csv").write_text(
        "time,x,y,z,qw,qx,qy,qz\n" + "".join(f"{t},0,0,{-0.1 * t},1,0,0,0\n" for t in (5, 5.1, 5.4))
    )
    moves = "  - replay: {file: poses.csv, units: mm}\n  - hold: {frames: 2, duration_s: 1}\n"
    text = RECIPE.split("  - press")[0] + moves
    made = scene_of_row.build(plan.load(recipe(tmp_path, text)).rows[0]).duration
    assert made is not None
    assert made == pytest.approx([0.1, 0.1, 0.3, 0.5, 0.5])


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        (", frame_s: 0.002", "", "11:11: trajectory[1].hold: must say how long it takes: duration_s, or frame_s"),
        ("dynamics:", "# dynamics:", "10:39: trajectory[0].press.duration_s: has no effect without dynamics"),
        ("1050", "0", "8:27: dynamics.density_kg_m3: must be greater than 0 (got 0)"),
    ],
)  # fmt: skip
def test_times_must_be_known_and_of_use(tmp_path: Path, old: str, new: str, line: str) -> None:
    with pytest.raises(UserError) as caught:
        plan.load(recipe(tmp_path, RECIPE.replace(old, new)))
    assert caught.value.lines[0].removeprefix(f"{tmp_path}/recipe.yaml:").startswith(line)


def test_a_table_that_cannot_be_read_is_reported_once(tmp_path: Path) -> None:
    text = RECIPE.replace(", frame_s: 0.002", "").split("  - press")[0]
    with pytest.raises(UserError) as caught:
        plan.load(recipe(tmp_path, text + "  - hold: {frames: 2}\n  - replay: {file: gone.csv}\n"))
    told = [line.split(": ", 1)[1] for line in caught.value.lines if not line.startswith(" ")]
    assert [line.partition(":")[0] for line in told] == ["trajectory[0].hold", "trajectory[1].replay.file"]


def test_what_is_quasi_static_does_not_even_import_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tacgen.fem.inertia", None)
    assert len(tap(DOWN[:1], 0).states) == 1
    with pytest.raises(ImportError):
        tap(DOWN[:1], 1.0)
