"""How close an indenter comes to the gel that it does not touch, by closed forms."""

from pathlib import Path

import numpy as np
import pytest
from helpers.command import told
from helpers.presses import poses
from helpers.small_recipe import HEAD

from tacgen.geometry import first_touch
from tacgen.geometry.analytic_sdf import BoxSdf, ConeSdf, Shape, SphereSdf
from tacgen.geometry.gel import GelBody
from tacgen.recipe import assets, loading, plan, scene_checks
from tacgen.recipe.scene_of_row import gel_of


def closest(shape: Shape, gel: GelBody, *places: tuple[float, float, float]) -> float:
    return first_touch.closest(shape, gel, poses([*places]))


def gel_in(sensor: str = "gelsight_mini"):
    return gel_of(loading.read_sensor(assets.sensor_path(sensor))[0])


@pytest.mark.parametrize(
    "shape", [SphereSdf(4.0), ConeSdf(0.4, 0.1), BoxSdf(6.0, 4.0, 0.2)], ids=lambda s: type(s).__name__
)
def test_over_a_level_face_it_is_the_height_of_the_lowest_point(shape) -> None:
    gel = gel_in()
    assert closest(shape, gel, (0.1, 0.2, 5), (3.123, -1.017, 1.5)) == pytest.approx(1.5, abs=1e-3)
    assert closest(shape, gel, (0.0, 0.0, 5), (0.313, 0.117, -0.01)) <= 0


def test_beside_the_pad_and_over_a_dome() -> None:
    gel, dome, ball = gel_in(), gel_in("digit"), SphereSdf(4.0)
    assert closest(ball, gel, (gel.width / 2 + 3, 0, -1)) == pytest.approx(np.hypot(3, 3) - 4, abs=1e-3)
    assert closest(ball, dome, (0, 0, 0.5)) == pytest.approx(0.5, abs=1e-3)
    assert closest(ball, dome, (6.0, 0, 0.0)) > 0.05, "the face falls away from its crown"


SLIDE = "slide: {x_mm: 1, frames: 2}"
REJECTED = "a run rejects it; check its start or poses, and their unit; may_miss: true keeps such scenes"


def written(folder: Path, moves: str = SLIDE, more: str = "") -> Path:
    (folder / "r.yaml").write_text(f"{HEAD}  - {moves}\n{more}\n")
    return folder / "r.yaml"


@pytest.mark.parametrize(
    ("moves", "start", "said"),
    [
        (SLIDE, "{clearance_mm: 2.5}", f"closest approach 2.5 mm: {REJECTED}"),
        (SLIDE, "{clearance_mm: 2.5}\nmay_miss: true", "closest approach 2.5 mm"),
        ("press: {depth_mm: 0.02, frames: 2}", "{x_mm: 1.03}", ""),
        ("press: {force_n: 1, frames: 2}", "{clearance_mm: 2.5}", ""),
    ],
)
def test_validate_says_so_before_the_run(tmp_path: Path, moves: str, start: str, said: str) -> None:
    path = written(tmp_path, moves, f"start: {start}")
    note = f"note: scene-00000 touches the gel in no frame: {said}\n" if said else ""
    notes = [line for line in told("validate", path).splitlines(keepends=True)[1:] if "expected error" not in line]
    assert "".join(notes) == note


def test_what_is_inside_the_gel_without_force_is_never_ok(tmp_path: Path) -> None:
    """A tip between contact points."""
    path, why = written(tmp_path), "the indenter is 0.158 mm inside the gel without force, between contact points"
    for may_miss in ("true", "false"):
        recipe = plan.load(path, [f"may_miss={may_miss}"]).rows[0].recipe
        fine, said = scene_checks.verdict(recipe, -0.158)
        assert (fine, said.split(": ")[0]) == (False, why)
        assert scene_checks.verdict(recipe, 0.05)[0] == (may_miss == "true")


def test_scenes_without_contact_are_one_note(tmp_path: Path) -> None:
    vary = "vary: {samples: 60, seed: 1, over: {start.clearance_mm: {uniform: [0.5, 1.5]}}}"
    (note,) = scene_checks.notes(plan.load(written(tmp_path, SLIDE, vary)).rows)
    assert note.startswith("scene-00000 touches the gel in no frame: closest approach ")
    assert note.endswith("; nor do 49 more of the first 50 scenes: a run rejects it; " + scene_checks.KEEP_HINT)
