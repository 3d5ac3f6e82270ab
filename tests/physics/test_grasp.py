"""A grasp: both fingers and the weight balance in the world frame, and the object slips where the closed form says."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.flanged_rod import flanged

from tacgen.base.errors import UserError
from tacgen.batch import pipeline
from tacgen.bundle.bundle import Bundle, read
from tacgen.bundle.check import check
from tacgen.bundle.run_status import survey
from tacgen.geometry.pose import about
from tacgen.mechanics.failures import NotConverged
from tacgen.mechanics.grasp_balance import Frame, Held, Mode, Trial, held, problem_of
from tacgen.recipe import grasp_of_row as two_fingers
from tacgen.recipe import plan, scene_checks
from tacgen.recipe.row import Row

Array = np.ndarray
MASS, FRICTION = 0.05, 0.6
WEIGHT = MASS * 9.80665  # [N]
SLIPS = WEIGHT / (2 * FRICTION)  # normal force of a finger below which a block slips [N]
HEAD = f"""
tacgen: 1
name: grasp
sensor: gelsight_mini
contact: {{friction: {FRICTION}}}
outputs: [force]
quality: {{edge_mm: 1.0, dhat_mm: 0.1}}
"""
BLOCK = f"""{HEAD}indenter: {{shape: box, size_x_mm: 8, size_y_mm: 6, fillet_mm: 1}}
grasp: {{mass_kg: {MASS}, height_mm: 6, fall_mm: 0.4}}
"""
BALL = f"""{HEAD}indenter: {{shape: sphere, radius_mm: 5}}
grasp: {{mass_kg: {MASS}}}
"""


def planned(folder: Path, text: str, *moves: str) -> Row:
    path = folder / "grasp.yaml"
    path.write_text(text + "trajectory:\n" + "".join(f"  - {move}\n" for move in moves))
    return plan.load(path).rows[0]


def found(folder: Path, text: str, *moves: str) -> list[Held]:
    grasp = two_fingers.build(planned(folder, text, *moves))
    left, right = (problem_of(scene) for scene in grasp.fingers)
    return list(held(grasp, (left, right)))


def on_object(frame: Held) -> Array:
    """Force of each finger on the object (2, 3) in the world, written out for a gripper that has not turned: the left
    sensor's x, y, z are the world's y, z, x, the right one's -y, z, -x."""
    left, right = (-state.traction_force.sum((0, 1)) for state in frame.states)
    return np.array([[left[2], left[0], left[1]], [-right[2], -right[0], right[1]]])


def grip(frame: Held) -> float:
    return float(on_object(frame)[0, 0])


@pytest.mark.slow
def test_a_block_slips_below_half_its_weight_over_friction(tmp_path: Path) -> None:
    moves = [f"close: {{force_n: {part * SLIPS:.6f}, frames: 1}}" for part in (1.2, 1.015, 0.985, 0.9)]
    frames = found(tmp_path, BLOCK, moves[0], "lift: {height_mm: 3, frames: 1}", *moves[1:])
    assert [frame.mode for frame in frames] == [Mode.standing, *[Mode.held] * 2, *[Mode.falling] * 2]
    still = frames[2]
    assert grip(still) == pytest.approx(1.015 * SLIPS, rel=4e-3)
    assert abs(still.unborne) < 1e-3 * grip(still)
    for frame in frames[3:]:
        assert frame.unborne == pytest.approx(WEIGHT - 2 * FRICTION * grip(frame), rel=0.02)
    sunk = np.diff([frame.pose[2, 3] for frame in frames[2:]])
    assert sunk == pytest.approx([-0.4, -0.4])  # fall_mm a frame


@pytest.mark.slow
def test_what_friction_cannot_lift_stays_on_the_table(tmp_path: Path) -> None:
    frames = found(tmp_path, BLOCK, "close: {force_n: 0.2, frames: 1}", "lift: {height_mm: 1, frames: 2}")
    assert [frame.mode for frame in frames] == [Mode.standing] * 3
    assert frames[-1].pose[:3, 3] == pytest.approx(frames[0].pose[:3, 3], abs=1e-9)
    assert frames[-1].sensors[0][2, 3] == pytest.approx(1.0)
    assert frames[-1].unborne == pytest.approx(WEIGHT - 2 * FRICTION * grip(frames[-1]), rel=0.01)


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> list[Held]:
    moves = "close: {force_n: 1, frames: 2}", "lift: {height_mm: 2, frames: 1}", "tilt: {angle_deg: 40, frames: 1}"
    return found(tmp_path_factory.mktemp("ball"), BALL, *moves)


def test_a_lifted_ball_is_borne_by_both_fingers_alike(ball: list[Held]) -> None:
    closed, lifted = ball[1:3]
    assert (closed.mode, lifted.mode) == (Mode.standing, Mode.held)
    assert grip(closed) == pytest.approx(1.0, rel=3e-3)
    forces = on_object(lifted)
    assert forces.sum(0) == pytest.approx([0, 0, WEIGHT], abs=1e-3 * grip(lifted))
    assert forces[:, 2] == pytest.approx(WEIGHT / 2, rel=0.01)  # both push it up
    assert forces[0, 0] > 0.9  # the left finger pushes it to the right
    assert closed.sensors[1][0, 3] - closed.sensors[0][0, 3] == pytest.approx(closed.width)
    sunk = closed.pose[2, 3] + 2 - lifted.pose[2, 3]
    assert 0 < sunk < 0.5  # it hangs a little lower than it was gripped
    assert max(frame.balance for frame in ball) < 1e-3


def test_a_tilted_grasp_balances_in_the_world(ball: list[Held]) -> None:
    frame = ball[3]
    turn = about(np.array([1.0, 0, 0]), np.radians(40))
    assert frame.sensors[0][:3, :3] == pytest.approx(turn @ [[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    world = [
        -s[:3, :3] @ state.traction_force.sum((0, 1)) for s, state in zip(frame.sensors, frame.states, strict=True)
    ]
    assert sum(world) == pytest.approx([0, 0, WEIGHT], abs=1e-3 * grip(frame))


def test_a_weight_beside_the_grip_turns_the_object_until_its_moment_is_borne(tmp_path: Path) -> None:
    text = BALL.replace(f"mass_kg: {MASS}", f"mass_kg: {MASS}, centre_mm: [0, 0.5, 5]")
    frames = found(tmp_path, text, "close: {force_n: 2, frames: 2}", "lift: {height_mm: 1, frames: 1}")
    lifted = frames[-1]
    assert lifted.mode == Mode.held
    assert lifted.balance < 1e-3  # moments too
    lean = np.arctan2(lifted.pose[2, 1], lifted.pose[1, 1])
    assert lean < np.radians(-0.5)  # the heavy side, at +y, goes down


def test_two_gels_press_alike_whatever_they_are_made_of(tmp_path: Path) -> None:
    text = BALL.replace(f"mass_kg: {MASS}", f"mass_kg: {MASS}, right: digit")
    frames = found(tmp_path, text, "close: {width_mm: 9.2, frames: 2}")
    left, right = on_object(frames[-1])
    assert left[0] > 0.3
    assert right[0] == pytest.approx(-left[0], rel=1e-3)
    assert frames[-1].width == pytest.approx(9.2)
    assert abs(frames[-1].pose[0, 3]) > 0.01  # it is not in the middle: the gels are not alike


def test_a_gripper_goes_as_a_table_goes_on_from_its_first_row(tmp_path: Path) -> None:
    """Rows of another frame, a metre away and turned by a quarter; the gripper is lifted and moved along its y."""
    turned = "0,0,0.7071067811865476,0.7071067811865476"  # qx, qy, qz, qw: a quarter turn about z
    rows = [f"{t},1000,{-y},{500 + z},{turned}" for t, (y, z) in enumerate(((0, 0), (1, 1), (3, 1)))]
    (tmp_path / "way.csv").write_text("\n".join(["time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw", *rows]))
    still, up, beside = found(tmp_path, BALL, "close: {force_n: 1, frames: 1}", "replay: {file: way.csv}")[1:]
    assert [frame.mode for frame in (up, beside)] == [Mode.held, Mode.held]
    middle = [np.mean([s[:3, 3] for s in frame.sensors], 0) for frame in (still, up, beside)]
    assert np.diff(middle, axis=0) == pytest.approx(np.array([[-1, 0, 1], [-2, 0, 0]]), abs=1e-9)
    assert beside.pose[:3, 3] - up.pose[:3, 3] == pytest.approx([-2, 0, 0], abs=0.02)


def bundles(folder: Path) -> tuple[Bundle, Bundle]:
    left, right = (read(folder / f"scene-00000-{side}.h5") for side in "LR")
    return left, right


def test_a_scene_has_a_bundle_for_each_finger_and_goes_on_where_it_stopped(tmp_path: Path) -> None:
    row, out = (
        planned(tmp_path, BALL, "close: {force_n: 1, frames: 1}", "lift: {height_mm: 1, frames: 1}"),
        tmp_path / "out",
    )
    assert pipeline.run_scene(row, out).status == "ok"
    left, right = bundles(out)
    assert (left.attrs["finger"], right.attrs["finger"]) == ("left", "right")
    assert left.attrs["input_key"] != right.attrs["input_key"]
    assert (left["/frames/grasp/object"] == right["/frames/grasp/object"]).all()
    total = sum(-b["/frames/grasp/sensor"][1, :3, :3] @ b["/frames/force"][1] for b in (left, right))
    assert total == pytest.approx([0, 0, WEIGHT], abs=1e-3)
    for b in (left, right):  # the object's pose in the world by way of the sensor's
        assert b["/frames/grasp/sensor"] @ b["/frames/pose"] == pytest.approx(b["/frames/grasp/object"], abs=1e-12)
    assert check(out) == []
    written = [(out / f"scene-00000-{side}.h5").read_bytes() for side in "LR"]
    (out / "scene-00000-R.h5").unlink()
    assert "presolve" in pipeline.run_scene(row, out).seconds
    assert [(out / f"scene-00000-{side}.h5").read_bytes() for side in "LR"] == written
    assert not pipeline.run_scene(row, out).seconds  # kept


@pytest.mark.slow
def test_status_and_plan_name_both_bundles(tmp_path: Path) -> None:
    from tacgen import batch

    path = tmp_path / "grasp.yaml"
    path.write_text(BALL + "trajectory: [close: {width_mm: 9.9, frames: 1}]\n")
    batch.run(plan.load(path), tmp_path / "out")
    assert [(s.name, s.state) for s in survey(tmp_path / "out").scenes] == [
        ("scene-00000-L", "ok"),
        ("scene-00000-R", "ok"),
    ]


def test_a_grasp_that_cannot_be_reached_says_so_in_both_bundles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    row, out = planned(tmp_path, BALL, "close: {force_n: 1, frames: 2}"), tmp_path / "out"
    monkeypatch.setattr("tacgen.mechanics.grasp_balance.MAX_GRASP_TRIALS", 1)
    assert pipeline.run_scene(row, out).status == "rejected"
    assert all("not found in 1 trials" in b.attrs["reason"] for b in bundles(out))


def test_fingers_do_not_close_through_the_gels(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"trajectory\[0\].close.width_mm: must be above"):
        two_fingers.build(planned(tmp_path, BALL, "close: {width_mm: 1, frames: 1}"))


def test_fingers_that_touch_nothing_stop_at_once() -> None:
    """Without contact there is no tangent: 40 trials were the same."""
    frame = object.__new__(Frame)
    frame.problems, frame.force, frame.tol, frame.balanced = (SimpleNamespace(edge=1.0),) * 2, 1.0, 1e-3, 1e-3
    frame.load, frame.scale, frame.grasp = np.zeros(6), np.ones(6), SimpleNamespace(opening=21.5)
    frame.heaviness, frame.down = 1.0, np.array([0.0, 0.0, -1.0])
    frame._tangent = lambda at: np.zeros((7, 7))  # type: ignore[method-assign]
    frame._trial = lambda *_: pytest.fail("tried")  # type: ignore[method-assign]
    apart = Trial(np.eye(4), 34.8, (), np.zeros(6), 0.0)
    with pytest.raises(NotConverged, match=r"the fingers, 34.8 mm apart, do not touch the object; .* at 21.5 mm"):
        frame._newton(apart, Mode.standing)


def test_a_force_is_looked_for_where_the_object_is() -> None:
    """Fingers that were opened wide begin at first touch."""
    frame = object.__new__(Frame)
    frame.problems, frame.force, frame.width = (SimpleNamespace(thickness=4.0),) * 2, 1.0, np.nan
    frame.grasp = SimpleNamespace(opening=21.5)
    frame.last = Trial(np.eye(4), 40.0, (), np.zeros(6), 0.0)
    assert frame._first_width() == pytest.approx(21.5 - 0.04)


def test_a_plate_beside_the_middle_is_gripped_at_once_from_afar(tmp_path: Path) -> None:
    """In one frame from wide open to the whole force, as recorded grippers close; then held, and let almost go."""
    plate = HEAD.replace("edge_mm: 1.0", "edge_mm: 1.5") + (
        f"indenter: {{shape: box, size_x_mm: 14, size_y_mm: 12, fillet_mm: 0.5}}\n"
        f"grasp: {{mass_kg: {MASS}, height_mm: 5, y_mm: 4}}\n"
    )
    moves = ("close: {width_mm: 40, frames: 1}", "close: {force_n: 6, frames: 1}", "lift: {height_mm: 1, frames: 1}")
    _, gripped, lifted, light = found(tmp_path, plate, *moves, "close: {force_n: 1, frames: 1}")
    assert gripped.mode == Mode.standing
    assert lifted.mode == light.mode == Mode.held
    assert [grip(one) for one in (gripped, light)] == pytest.approx([6.0, 1.0], rel=3e-3)
    for one in (lifted, light):
        assert on_object(one).sum(0) == pytest.approx([0.0, 0.0, WEIGHT], abs=1e-3 * max(grip(one), WEIGHT))


def test_an_object_is_held_where_it_is_between_the_pads(tmp_path: Path) -> None:
    """A rod gripped at its middle, with flanges beyond the pads; first touch was that of the flanges."""
    flanged().export(tmp_path / "rod.stl")
    text = f"""{HEAD}indenter: {{shape: mesh, file: rod.stl, up: "-x"}}
grasp: {{mass_kg: 0.05, height_mm: 30}}
"""
    grasp = two_fingers.build(planned(tmp_path, text, "close: {force_n: 1, frames: 1}"))
    assert grasp.opening == pytest.approx(8.0, abs=1e-6)
    beside = text.replace("height_mm: 30", "height_mm: 30, y_mm: 40")
    with pytest.raises(UserError, match="grasp: nothing of the object is between the fingers"):
        two_fingers.build(planned(tmp_path, beside, "close: {force_n: 1, frames: 1}"))
    apart = planned(tmp_path, BALL, "close: {width_mm: 12, frames: 1}")
    (note,) = scene_checks.notes([apart])
    assert note.startswith("scene-00000 touches the gel in no frame: closest approach 1 mm")
