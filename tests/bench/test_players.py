"""Players of other simulators, at toy size where they are installed: signs, friction, rest and the search."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.referee import reference, tune
from benchmarks.referee.case import CASES, PAD_MM, Case, Pose, dots
from benchmarks.referee.player import NotPlayed
from benchmarks.referee.players import (
    MODULES,
    felupe_contact,
    felupe_pad,
    felupe_player,
    fots,
    mujoco_flex,
    mujoco_rigid,
    newton_hydroelastic,
    players,
    uipc_parts,
)
from benchmarks.referee.playing import Simulator, answer, place, speed, steps
from benchmarks.reference_runs import row_of
from tacgen.recipe import scene_of_row
from tests.helpers.needs import needs

BY_NAME = {case.name: case for case in CASES}


@pytest.mark.parametrize("name", MODULES)
def test_players_without_packages_say_so(name: str) -> None:
    for player in players(name):
        assert player.settings[0] == "default"
        why = player.available()
        told = ("not installed: ", "needs a CUDA GPU")
        assert (why is None or why.startswith(told)) != (name == "not_run")


def test_a_package_that_is_missing_is_named() -> None:
    player = Simulator("x", ("numpy", "no_such_package"), (), {}, mujoco_rigid.run)
    assert player.available() == "not installed: no_such_package"


def test_steps_reach_each_frame_and_rest_in_it() -> None:
    case = Case("", "ball", 0.3, (Pose(z=-0.4), Pose(x=0.5, z=-0.4), Pose(z=0.2)), (0, 2))
    every = list(steps(case, 4, 2))
    assert [n for n, (*_, judged) in enumerate(every) if judged] == [5, 17]
    assert every[0][0] == Pose(z=0.2)  # the clearance of the path
    np.testing.assert_allclose([now for _, now, _ in every][3:6], [Pose(z=-0.4)] * 3)
    assert all(before == now for (_, before, _), (now, _, _) in pairwise(every))
    assert len(list(steps(case, 4, 2, creeping=True))) == 14  # no rest after the slide, nor after it is lifted and back


def test_poses_and_speeds_are_si() -> None:
    turned = Pose(x=1.0, yaw=90.0)
    np.testing.assert_allclose(place(turned), [0.001, 0, 0, np.sqrt(0.5), 0, 0, np.sqrt(0.5)], atol=1e-12)
    np.testing.assert_allclose(speed(Pose(), turned, 0.5), [0.002, 0, 0, 0, 0, np.pi], atol=1e-12)


def test_an_answer_sums_forces_at_points() -> None:
    said = answer([(np.array([[1.0, 0, 0], [0, 2.0, 0]]), np.array([[0, 0, -1.0], [0, 0, -2.0]]))], 0.1, {})
    np.testing.assert_allclose(said.force, [[0, 0, -3]])
    np.testing.assert_allclose(said.torque, [[-4, 1, 0]])
    assert said.pressure is not None
    assert said.pressure.sum() * 0.5**2 == pytest.approx(3)
    with pytest.raises(NotPlayed, match="not finite"):
        answer([(np.zeros((1, 3)), np.full((1, 3), np.nan))], 0.1, {})


def test_mujoco_rigid_presses_holds_and_slides_within_friction() -> None:
    needs("mujoco")
    press = mujoco_rigid.run(BY_NAME["press ball"], mujoco_rigid.DEFAULT)
    assert (np.diff(-press.force[:, 2], prepend=0) > 0).all()
    slide = mujoco_rigid.run(BY_NAME["slide ball, friction .3"], mujoco_rigid.TUNED).force
    assert slide[-1, 0] > 0  # the ball drags the gel along
    assert slide[-1, 0] <= 0.3 * -slide[-1, 2] * 1.001
    grasp = BY_NAME["grasp box"]
    np.testing.assert_allclose(mujoco_rigid.run(grasp, mujoco_rigid.DEFAULT).force, [[0, grasp.weight, 0]], atol=0.01)
    ring = mujoco_rigid.run(BY_NAME["press ring"], mujoco_rigid.DEFAULT)
    np.testing.assert_allclose(ring.force[:, :2], 0, atol=1e-3)


def test_mujoco_flex_is_as_stiff_as_its_pad() -> None:
    needs("mujoco")
    coarse = mujoco_flex.TUNED | {"cell_mm": 2.0, "young_factor": 1.0}
    soft = mujoco_flex.run(BY_NAME["release ball"], coarse).force
    stiff = mujoco_flex.run(BY_NAME["release ball"], coarse | {"young_factor": 2.0}).force
    hertz = 4 / 3 * 0.2 / (1 - 0.48**2) * np.sqrt(4) * 0.8**1.5  # of a half space [N]
    assert hertz < -soft[0, 2] < 4 * hertz
    assert 1.2 < stiff[0, 2] / soft[0, 2] < 2
    np.testing.assert_allclose(soft[1], 0, atol=1e-9)
    with pytest.raises(NotPlayed, match="between two soft pads"):
        mujoco_flex.run(BY_NAME["grasp box"], coarse)


def test_fots_markers_are_driven_away_drawn_along_and_turned() -> None:
    """Closed forms: opposite motion on opposite sides of a press, the whole slide under the middle, a turn of all."""
    here, middle = dots(), 40  # of the markers, at the origin
    wide = {"dilate": 1e-3, "shear": 1e-4, "twist": 1e-9}
    pressed = Case("", "ball", 0.0, (Pose(z=-0.8), Pose(z=0.2)), (0, 1))
    moved = fots.run(pressed, wide).markers
    assert moved is not None
    np.testing.assert_allclose(moved[0], -moved[0][::-1], atol=1e-3)
    assert (moved[0] * here).sum(1).min() >= 0 < moved[0][middle + 1, 0]
    np.testing.assert_array_equal(moved[1], 0)  # lifted
    turned = Case("", "ball", 0.0, (Pose(z=-0.8, yaw=20.0), Pose(x=1.0, z=-0.8)), (0, 1))
    twist, slide = fots.run(turned, wide | {"dilate": 9.0}).markers  # which leaves no motion of a press
    turn = np.radians(20.0)
    np.testing.assert_allclose(
        twist, here @ [[np.cos(turn) - 1, np.sin(turn)], [-np.sin(turn), np.cos(turn) - 1]], atol=0.02
    )
    assert slide[middle, 0] == pytest.approx(np.exp(-1e-4 * fots.PX_PER_MM**2), abs=1e-6)
    with pytest.raises(NotPlayed, match="grasp"):
        fots.run(BY_NAME["grasp box"], wide)


@pytest.mark.parametrize("first", [0, 1])
def test_a_hydroelastic_contact_pushes_into_the_pad(first: int) -> None:
    """By 2 N/mm times a depth of .1 mm at x = 1 mm, of a shape that stands at (1, 0, -1) mm, whichever comes first."""
    ends = np.array([[[0.0, 0, 0.9]], [[1.0, 0, 0]]]) / 1000  # of the shape in its frame, and of the pad
    order = (0, 1) if first == 0 else (1, 0)
    parts = {"shape0": [first], "point0": ends[order[0]], "point1": ends[order[1]], "stiffness": [2000.0]}
    parts |= {"count": [1], "normal": [[0, 0, -1.0 if first == 0 else 1.0]]}
    told = {f"rigid_contact_{k}": SimpleNamespace(numpy=lambda v=v: np.array(v)) for k, v in parts.items()}
    at, force = newton_hydroelastic._normal(SimpleNamespace(**told), Pose(x=1.0, z=-1.0).matrix)
    np.testing.assert_allclose(at, [[1.0, 0, -0.05]], atol=1e-9)
    np.testing.assert_allclose(force, [[0, 0, -0.2]], atol=1e-9)


def test_five_tetrahedra_a_box_fill_the_pad_and_meet_face_to_face() -> None:
    points, tets = uipc_parts.tetrahedra(2.0)
    volumes = np.linalg.det(points[tets[:, 1:]] - points[tets[:, :1]]) / 6
    assert volumes.min() > 0
    assert volumes.sum() == pytest.approx(np.prod(PAD_MM))
    faces = np.sort(tets[:, [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)]].reshape(-1, 3))
    counts = np.unique(faces, axis=0, return_counts=True)[1]
    assert np.bincount(counts).tolist() == [0, 560, 1720]  # two on each square outside, and those that two share


def test_the_search_finds_the_least_error() -> None:
    module = SimpleNamespace(LOW=(0.0, 0.0), HIGH=(4.0, 2.0), settings_at=lambda x: {"a": x[0], "b": x[1]})
    told: list[str] = []
    best = tune.search(module, lambda s: (s["a"] - 1) ** 2 + (s["b"] - 1.5) ** 2, 60, told.append)
    assert best == pytest.approx({"a": 1, "b": 1.5}, abs=0.02)
    assert len(told) <= 60


def test_friction_is_within_coulombs_cone_and_its_derivative_is_exact() -> None:
    rng, mu = np.random.default_rng(0), 0.3
    shape = scene_of_row.build(row_of(BY_NAME["press ball"].recipe)).shape
    before = np.column_stack([rng.uniform(-1, 1, (300, 2)), np.full(300, 0.05)])
    y = before + rng.normal(size=(300, 3)) * (0.002, 0.002, 0.01)
    kept = np.zeros(300), 0.05 * rng.normal(size=(300, 3)), np.zeros((300, 1), bool)
    _, slope, (p, rub, sticks) = felupe_contact.contact(y, before, kept, shape, mu, False)
    size, touches = np.linalg.norm(rub, axis=1), p > 0
    assert (size <= mu * p * (1 + 1e-12)).all()
    slips = touches & ~sticks[:, 0]
    assert 20 < slips.sum() < touches.sum() - 20 < 260  # some slip, some stick, some are away
    np.testing.assert_allclose(size[slips], mu * p[slips])
    for k, step in enumerate(1e-7 * np.eye(3)):
        ends = (felupe_contact.contact(y + sign * step, before, kept, shape, mu, False)[0] for sign in (1, -1))
        np.testing.assert_allclose(np.subtract(*ends) / 2e-7, slope[:, :, k], atol=1e-5)


@pytest.mark.slow
def test_felupes_pad_presses_as_on_a_finer_mesh_and_drags_by_friction() -> None:
    """Closed form of full slip: tangential = friction times normal, where the contact is so small that it is flat."""
    needs("felupe")
    needs("pypardiso")
    press = felupe_player.run(BY_NAME["press ball"], {"edge_mm": 1.25, "steps": 2, "points": 2}).force
    np.testing.assert_allclose(press, reference.kept()["press ball"].answer.force, atol=0.01)
    shallow = Case("", "ball", 0.3, (Pose(z=-0.1), Pose(x=0.3, z=-0.1)), (1,))
    force = felupe_player.run(shallow, {"edge_mm": 0.6, "steps": 2, "points": 2}).force[0]
    assert force[0] / -force[2] == pytest.approx(0.3, rel=0.015)


def test_a_quarter_that_turns_is_the_whole() -> None:
    """Displacements that turn with the pad are free, others are not."""
    needs("felupe")
    pad = felupe_pad.Pad(BY_NAME["twist punch"], 3.0, 2)
    x = pad.points
    twist = np.column_stack([-x[:, 1], x[:, 0], 0 * x[:, 0]]) * (x[:, 2:] + 4)
    shift = np.tile([1.0, 0, 0], (len(x), 1)) * (x[:, 2:] + 4)
    sizes = np.asarray(pad.free.power(2).sum(0)).ravel()
    left = [np.linalg.norm(v.ravel() - pad.free @ (pad.free.T @ v.ravel() / sizes)) for v in (twist, shift)]
    assert left[0] < 1e-9 < left[1]
    points, forces = pad.whole(x[pad.face], np.tile([1.0, 0, 2.0], (len(pad.face), 1)))
    np.testing.assert_allclose(forces.sum(0), [0, 0, 8.0 * len(pad.face)], atol=1e-9)
    assert points[:, 0].min() == -points[:, 0].max() == -10
