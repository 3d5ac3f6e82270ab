"""Sensitivities of a frame against solving again with other inputs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import small_recipe
from helpers.presses import force

from tacgen import mechanics
from tacgen.base.errors import UserError
from tacgen.batch import pipeline
from tacgen.bundle.bundle import read
from tacgen.fem.materials import NeoHooke
from tacgen.mechanics import mesh
from tacgen.mechanics.scene import Scene
from tacgen.outputs.sensitivities import Sensitivities
from tacgen.recipe import scene_of_row
from tacgen.recipe.model import Uncertainty
from tacgen.recipe.row import Row

PRESS = "press: {depth_mm: 0.8, frames: 2}"
ALL = {"material": {"modulus": 0.1, "poissons_ratio": 0.002, "friction": 0.1}, "pose": {"depth_mm": 0.02}}
EXACT = replace(mechanics.DEFAULT_OPTIONS, step_tol=1e-4, residual_tol=1e-7)


def slopes(row: Row, options: mechanics.SolverOptions = EXACT) -> tuple[Scene, mesh.GelMesh, dict[str, np.ndarray]]:
    built = replace(scene_of_row.build(row), differentiable=True)
    problem = mechanics.Problem.of(built, mesh.of(built), options)
    follow = Sensitivities(problem, Uncertainty.model_validate(ALL).deviations, row.sensor.gel)
    for state in mechanics.states(built, problem):
        found = {unsure.name: unsure.force for unsure in follow.at(state)}
    return built, problem.mesh, found


def differences(built: Scene, on: mesh.GelMesh, options: mechanics.SolverOptions = EXACT) -> dict[str, np.ndarray]:
    """By solving the whole path again with inputs a little larger and smaller, on the same mesh."""

    def solved(**new: object) -> np.ndarray:
        other = replace(built, **new)
        problem = mechanics.Problem.of(other, on, options)
        return force(list(mechanics.states(other, problem))[-1])

    def moduli(times: float, poisson: float) -> dict[str, object]:
        (layer,), nu = built.gel.layers, 0.49 + poisson
        law = NeoHooke(times * layer.law.mu * 1.49 / (1 + nu), 0)
        law = replace(law, kappa=2 * law.mu * (1 + nu) / (3 * (1 - 2 * nu)))
        softer = replace(layer, law=law, youngs_modulus=times * layer.youngs_modulus)
        return {"gel": replace(built.gel, layers=(softer,))}

    def lower(by: float) -> dict[str, object]:
        down = by * np.outer(np.eye(4)[2], np.eye(4)[3])
        return {"poses": built.poses - down, "start": built.start - down}

    ways = {"modulus": (lambda h: moduli(1 + h, 0), 1e-2), "poissons_ratio": (lambda h: moduli(1, h), 5e-4),
            "depth": (lower, 2e-3), "friction": (lambda h: {"friction": built.friction + h}, 5e-3)}  # fmt: skip
    return {
        name: (solved(**way(h)) - solved(**way(-h))) / (2 * h)
        for name, (way, h) in ways.items()
        if name != "friction" or built.friction
    }


@pytest.mark.slow
def test_without_friction_they_are_what_solving_again_gives() -> None:
    built, on, found = slopes(small_recipe.row(PRESS))
    wanted = differences(built, on)
    for name, value in wanted.items():
        assert found[name][2] == pytest.approx(value[2], rel=0.01), name


@pytest.mark.slow
@pytest.mark.parametrize("substeps", [False, True])
def test_with_friction_they_follow_the_path(substeps: bool) -> None:
    """Partly slipping, after a press whose points stuck where they first touched."""
    moves = "press: {depth_mm: 0.6, frames: 3}, slide: {x_mm: 0.2, frames: 2}"
    row = small_recipe.row(moves, "contact.friction=0.6")
    options = replace(EXACT, slide=0.06) if substeps else EXACT
    built, on, found = slopes(row, options)
    for name, value in differences(built, on, options).items():
        assert np.linalg.norm(found[name] - value) < 0.01 * np.linalg.norm(value), name


@pytest.mark.slow
def test_they_follow_frames_that_press_deep_with_the_usual_tolerances() -> None:
    """0.4 mm a frame: many points first touch within one, where the predictor says."""
    row = small_recipe.row(PRESS, "contact.friction=0.6")
    built, on, found = slopes(row, mechanics.DEFAULT_OPTIONS)
    for name, value in differences(built, on, replace(EXACT, step_tol=1e-6, residual_tol=1e-10)).items():
        assert np.linalg.norm(found[name] - value) < 0.01 * np.linalg.norm(value), name


def test_without_cholmod_they_are_the_same() -> None:
    row = small_recipe.row(PRESS, "contact.friction=0.5")
    (_, _, one), (_, _, other) = (slopes(row, replace(EXACT, condense=way, predict=False)) for way in (True, False))
    for name, value in one.items():
        assert other[name] == pytest.approx(value, rel=2e-3, abs=1e-3 * np.linalg.norm(value)), name


def test_a_bundle_says_how_sure_it_is(tmp_path: Path) -> None:
    row = small_recipe.row(PRESS, "outputs=[force, traction]", f"uncertainty={ALL}")
    (done,) = pipeline.run([row], tmp_path / "out")
    bundle = read(done.path)
    frames = {name: bundle[f"/frames/{name}"][-1] for name in ("force", "pressure", "traction")}
    sure = {name: bundle[f"/frames/uncertainty/{name}"][-1] for name in frames}
    slope = {name: bundle[f"/frames/sensitivity/{name}"][-1] for name in ("modulus", "depth", "poissons_ratio")}
    assert slope["modulus"] == pytest.approx(frames["force"])
    parts = [0.1 * slope["modulus"], 0.02 * slope["depth"], 0.002 * slope["poissons_ratio"]]
    assert sure["force"][2] == pytest.approx(np.linalg.norm(parts, axis=0)[2], rel=1e-3)
    inside = frames["pressure"] > 0.5 * frames["pressure"].max()
    assert (sure["pressure"][inside] >= 0.0999 * frames["pressure"][inside]).all()
    assert sure["pressure"][inside].mean() < 0.3 * frames["pressure"][inside].mean()


@pytest.mark.slow
def test_the_meshs_error_is_reported_by_a_coarser_one(tmp_path: Path) -> None:
    """Nine of ten errors of the force, against a mesh half as coarse, are within 1.645 standard deviations."""
    press, sets = PRESS.replace("2", "4"), ("uncertainty={mesh: true}", "quality={edge_mm: 0.5, dhat_mm: 0.05}")
    rows = [small_recipe.row(press, "outputs=[force, traction]", more) for more in sets]
    bundle, fine = (read(pipeline.run_scene(row, tmp_path / str(k)).path) for k, row in enumerate(rows))
    sure, error = bundle["/frames/uncertainty/force"], bundle["/frames/force"] - fine["/frames/force"]
    inside = np.abs(error)[:, 2] <= 1.645 * sure[:, 2]
    assert inside.mean() >= 0.75
    assert (sure[:, 2] < 0.3 * np.abs(bundle["/frames/force"][:, 2])).all()
    pressed = fine["/frames/pressure"] > 0.2 * fine["/frames/pressure"].max()
    off = np.abs(bundle["/frames/pressure"] - fine["/frames/pressure"])[pressed]
    assert 0.7 < (off <= 1.645 * bundle["/frames/uncertainty/pressure"][pressed]).mean() < 0.99


def test_what_has_no_sensitivities_is_refused() -> None:
    with pytest.raises(UserError, match="uncertainty: needs quasi-static frames"):
        small_recipe.row(PRESS, f"uncertainty={ALL}", "dynamics={density_kg_m3: 1000, frame_s: 0.1}")
