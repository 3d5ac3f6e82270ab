"""What a grasp's recipe may not say, a line each."""

from pathlib import Path

import pytest
from helpers.small_recipe import BALL

from tacgen.base.errors import UserError
from tacgen.recipe import grasp_of_row, plan

RECIPE = f"""{BALL.replace("4.0", "5")}grasp: {{mass_kg: 0.05}}
trajectory: [close: {{force_n: 1, frames: 2}}, lift: {{height_mm: 2, frames: 1}}, hold: {{frames: 1}}]
outputs: [force]
"""


def load(folder: Path, *sets: str) -> plan.Plan:
    path = folder / "grasp.yaml"
    path.write_text(RECIPE)
    return plan.load(path, sets)


def test_each_finger_has_a_row_of_its_own(tmp_path: Path) -> None:
    row = load(tmp_path, "grasp.right=digit").rows[0]
    left, right = row.bundles
    assert (left.name, right.name) == ("scene-00000-L", "scene-00000-R")
    assert (left.sensor.name, right.sensor.name) == ("gelsight_mini", "digit")
    assert len({row.key, left.key, right.key}) == 3
    assert left.seed != right.seed
    other = load(tmp_path, "grasp.right=digit", "sensor.gel.layers[0].youngs_modulus_mpa=0.3").rows[0]
    assert {each.key for each in other.bundles}.isdisjoint({left.key, right.key})
    plain = load(tmp_path).rows[0]
    assert plain.bundles[1].sensor == plain.sensor


def test_a_cylinder_with_a_length_is_held_at_half_of_it(tmp_path: Path) -> None:
    can = "indenter={shape: cylinder, radius_mm: 4, length_mm: 12}"
    held = [grasp_of_row.build(load(tmp_path, can, *more).rows[0]) for more in ([], ["grasp.height_mm=6"])]
    assert held[0].opening == pytest.approx(8)
    assert (held[0].start == held[1].start).all()
    assert held[0].centre.tolist() == [0, 0, 6]


@pytest.mark.parametrize(
    ("sets", "said"),
    [
        (["grasp=null"], "trajectory[0].close: needs a grasp: add one, or leave this movement out"),
        (["trajectory=[close: {force_n: 1, frames: 1}, twist: {angle_deg: 3, frames: 1}]"],
         "is no movement of a grasp, which has close, lift, tilt, hold, replay"),
        (["trajectory=[hold: {frames: 1}]"], "trajectory[0]: must be close"),
        (["trajectory=[close: {frames: 1}]"], "exactly one aim of width_mm, force_n"),
        (["trajectory=[close: {force_n: 1, frames: 1, duration_s: 1}]"], "duration_s: has no effect in a grasp"),
        (["start.x_mm=1"], "start: has no effect in a grasp: leave it out"),
        (["indenter={shape: box, size_x_mm: 8, size_y_mm: 8}"], "grasp: must say at which height"),
        (["indenter={shape: cylinder, radius_mm: 8}"], "grasp: must say at which height"),
        (["indenter={shape: cylinder, radius_mm: 8, length_mm: 9}", "grasp.height_mm=11"], "object's height, 9"),
        (["indenter={shape: cone, half_angle_deg: 30, tip_radius_mm: 1}"], "indenter: has no upright sides"),
        (["trajectory=[close: {width_mm: 2, frames: 1}]"], "width_mm: must be above 2: first touch is at 10 mm"),
        (["trajectory=[close: {width_mm: 9, frames: 1}, replay: {file: no.csv}]"], "no.csv"),
        (["grasp.height_mm=11"], "grasp.height_mm: must be at most the object's height, 10"),
        (["grasp.gravity=[0, 0, 0]"], "grasp.gravity: must be a direction, such as 0, 0, -1 (got 0, 0, 0)"),
        (["grasp.gravity=[1e300, 0, 0]"], "grasp.gravity[0]: must be within 1e+12"),
        (["grasp.gravity=[0, 0, -1e-320]"], "grasp.gravity: "),
        (["grasp.right=nothing"], "grasp.right: "),
        (["grasp.right=ninedtact", "outputs=[markers]"], "grasp.right: asks for markers"),
    ],
)  # fmt: skip
def test_the_impossible_is_reported_in_one_line(tmp_path: Path, sets: list[str], said: str) -> None:
    with pytest.raises(UserError) as refused:
        load(tmp_path, *sets)
    assert said in str(refused.value)


def test_without_cvxopt_a_grasp_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its Newton's method needs tangents condensed to the contact."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(UserError, match="grasp: needs CVXOPT"):
        load(tmp_path)
