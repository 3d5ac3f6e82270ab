"""What the contact does: eight small scenes of which it is known, and loads of which the friction used is known."""

from pathlib import Path

import numpy as np
import pytest
from helpers import small_recipe
from helpers.small import patch
from helpers.synthetic import attributes, write

from tacgen.batch import pipeline
from tacgen.bundle.bundle import Bundle, read
from tacgen.bundle.caption import Change, caption, changes, modes
from tacgen.mechanics.barrier import Faces
from tacgen.optics.camera import PinholeCamera
from tacgen.outputs.contact_events import friction_used, touched
from tacgen.report import viewer
from tacgen.report.bundle_figure import figure, summary

Array = np.ndarray
BALL, PUNCH = "{shape: sphere, radius_mm: 4}", "{shape: cylinder, radius_mm: 3, fillet_mm: 0.4}"
PRESS = "press: {depth_mm: 0.6, frames: 2}"
SCENES = {  # indenter, friction, trajectory, modes
    "comes near and touches": (BALL, 0.4, ["press: {depth_mm: 0.4, frames: 3}"], "apart touching touching"),
    "is held": (BALL, 0.4, [PRESS, "hold: {frames: 1}"], "touching touching touching"),
    "sticks": (PUNCH, 2.0, [PRESS, "slide: {x_mm: 0.6, frames: 1}"], "touching touching sticking"),
    "slips at its rim": (BALL, 0.6, [PRESS, "slide: {y_mm: -0.4, frames: 1}"], "touching touching slipping"),
    "stops": (BALL, 0.3, [PRESS, "slide: {x_mm: 2, frames: 1}", "hold: {frames: 1}"],
              "touching touching sliding sticking"),
    "lets go": (BALL, 0.4, [PRESS, "release: {frames: 3}"], "touching touching releasing apart apart"),
    "slides, then turns": (BALL, 0.2, [PRESS, "slide: {x_mm: 1.5, frames: 2}", "twist: {angle_deg: -80, frames: 1}"],
                           "touching touching sliding sliding turning"),
    "slides without friction": (BALL, 0.0, [PRESS, "slide: {x_mm: 1, frames: 1}"], "touching touching touching"),
}  # fmt: skip


def made(
    folder: Path, indenter: str, friction: float, moves: list[str], more: tuple[str, ...] = (), outputs: str = "events"
) -> Bundle:
    sets = f"indenter={indenter}", f"contact.friction={friction}", f"outputs=[{outputs}]", "start.clearance_mm=0.4"
    return read(pipeline.run_scene(small_recipe.row(", ".join(moves), *sets, *more), folder).path)


@pytest.mark.parametrize("name", SCENES)
def test_modes_are_those_of_a_scene_made_by_hand(name: str, tmp_path: Path) -> None:
    indenter, friction, moves, expected = SCENES[name]
    bundle = made(tmp_path, indenter, friction, moves)
    assert [mode.split()[-1] for mode in modes(bundle)] == expected.split()
    parts = {"/frames/normal_force", "/frames/friction_force"}
    assert parts & bundle.shapes.keys() == (parts if friction else set())


def test_a_caption_tells_what_is_done_and_what_happens(tmp_path: Path) -> None:
    moves = ["press: {depth_mm: 0.6, frames: 1, duration_s: 1}", "slide: {x_mm: -2, frames: 2, duration_s: 1}"]
    timed = ("sensor.gel.layers[0].prony=[{g: 0.05, tau_s: 0.3}]",)
    bundle = made(tmp_path, BALL, 0.3, moves, timed)
    assert changes(bundle) == [Change(0, "touching", 1.0), Change(1, "sliding", 1.5)]
    force = np.linalg.norm(bundle["/frames/force"], axis=1)
    assert caption(bundle) == (
        "A sphere, radius 4 mm, on gelsight_mini: pressed 0.6 mm deep, slid -2 mm along x. Touching from frame 0 (1 s),"
        f" sliding from frame 1 (1.5 s). The largest force is {force.max():.3g} N, in frame {force.argmax()}."
    )


def test_a_caption_rounds_and_names_the_finger_of_a_grasp(tmp_path: Path) -> None:
    moves = [{"close": {"force_n": 3.00049}}, {"lift": {"height_mm": -5.12345}}, {"tilt": {"angle_deg": -123.6}},
             {"close": {"width_mm": 11.98765}}]  # fmt: skip
    indenter = {"shape": "capsule", "radius_mm": 4.238172, "length_mm": 14.0}
    recipe = attributes()["recipe"] | {"indenter": indenter, "trajectory": moves}
    bundle = read(write(tmp_path / "a.h5", recipe=recipe, finger="right", sensor="digit"))
    assert caption(bundle).startswith(
        "A capsule, length 14 mm, radius 4.24 mm, on digit (right finger): gripped with 3 N, lowered 5.12 mm,"
        " tilted by -124 degrees, gripped 12 mm wide. The largest force is"
    )
    assert "digit (right finger)" in summary(bundle.path)
    assert "digit (right finger)" in viewer.block([bundle], in_3d=False)
    assert any(text.get_text().endswith("on digit (right finger)") for text in figure(bundle).texts)


def test_share_area_and_center_agree_with_the_maps(tmp_path: Path) -> None:
    moves, fine = [PRESS, "slide: {x_mm: 0.6, frames: 2}"], ("quality=draft",)
    bundle = made(tmp_path, BALL, 0.6, moves, fine, "events, traction, force_map")
    force = bundle["/frames/pressure"] * bundle["/frames/area"]
    slid = (force * bundle["/frames/sliding"]).sum((1, 2)) / force.sum((1, 2))
    assert bundle["/frames/events/stick_ratio"] == pytest.approx(1 - slid, abs=0.01)
    seen = (bundle["/frames/area"] * bundle["/frames/contact"]).sum((1, 2))
    assert bundle["/frames/events/contact_area"] == pytest.approx(seen, rel=0.015)  # in whole pixels
    assert bundle["/frames/events/patches"].tolist() == [1, 1, 1, 1]
    center = bundle["/frames/events/center_of_pressure"]
    assert np.abs(center[:2, :2]).max() < 0.01
    camera = PinholeCamera.from_sensor(bundle.sensor)
    column = (force[3] * (np.arange(force.shape[2]) + 0.5)).sum() / force[3].sum() * camera.shape[1] / force.shape[2]
    assert camera.project(center[3:])[0, 0] == pytest.approx(column, abs=1)


def test_events_are_those_of_all_of_the_face_whatever_the_camera_sees(tmp_path: Path) -> None:
    """A box tilted onto its edge at the side, seen by the camera, by half, and not at all."""
    box, moves = "{shape: box, size_x_mm: 4, size_y_mm: 3, fillet_mm: 0.5}", [PRESS, "slide: {x_mm: 0.3, frames: 1}"]
    start = "start={x_mm: 6, y_mm: 0, tilt_deg: 15, clearance_mm: 0.4}"
    seen = []
    for width in 320, 190, 40:
        bundle = made(tmp_path / str(width), box, 0.6, moves, (start, f"sensor.camera.width_px={width}"))
        seen.append({name: bundle[name] for name in bundle.shapes if name.startswith("/frames/events/")})
    assert seen[0]["/frames/events/contact_area"][-1] > 2
    assert seen[0]["/frames/events/patches"].tolist() == [1, 1, 1]
    for other in seen[1:]:
        for name, values in seen[0].items():
            assert np.array_equal(other[name], values), name


@pytest.mark.parametrize("along", [2, 3])
def test_area_and_patches_of_a_face_are_those_of_what_touches_it(along: int) -> None:
    """Two squares and the corner between them, on a level grid whose cells are 0.5 mm wide; and a single point."""
    points, faces, pat = patch(12, 6.0)
    faces = Faces.on(pat, points, faces.conn, along)
    x, y, _ = faces.at(points).transpose(2, 0, 1)
    two = ((x < -1) & (y < -1)) | ((x > 1) & (y > 0))
    area, patches = touched(faces, points, two)
    assert patches == 2
    assert area == pytest.approx(4 + 6, rel=0.08)  # as RIM_SHARE is less than half
    leaning = points + points[:, :1] * [0, 0, 1]
    assert touched(faces, leaning, two) == (pytest.approx(np.sqrt(2) * area), 2)
    assert touched(faces, points, np.ones_like(two)) == (pytest.approx(36), 1)
    one = np.zeros_like(two)
    one[50, 2] = True
    said = "a tip that presses touches"
    assert touched(faces, points, one) == (pytest.approx(faces.areas[50, 2]), 1), said
    assert touched(faces, points, np.zeros_like(two)) == (0.0, 0)


def test_force_is_its_normal_part_and_friction_which_obeys_coulombs_law(tmp_path: Path) -> None:
    """A ball that slides is held back by more than friction: it ploughs."""
    moves = [PRESS, "slide: {x_mm: 2, frames: 2}"]
    bundle = made(tmp_path, BALL, 0.2, moves, outputs="traction, force_map")
    force, normal, friction = (bundle[f"/frames/{name}"] for name in ("force", "normal_force", "friction_force"))
    assert force == pytest.approx(normal + friction, abs=1e-12)
    pressed = (bundle["/frames/pressure"] * bundle["/frames/area"]).sum((1, 2))
    size, tangential = np.linalg.norm(friction, axis=1), np.hypot(force[:, 0], force[:, 1])
    assert (size <= 0.2 * pressed * (1 + 1e-3)).all()
    assert size[-1] > 0.95 * 0.2 * pressed[-1]
    assert tangential[-1] / -force[-1, 2] > 0.21, "or this scene does not plough"
    assert -normal[-1, 0] / force[-1, 2] > 0.01, "which is in the normal part"


def disc(n: int, radius: float = 2.0) -> tuple[Array, Array, Array]:
    """Points (k, 3) on a level disc, each of the same part of 1 N; their normals, and shares of the force (k,)."""
    turn = np.arange(n) * np.pi * (3 - np.sqrt(5))
    at = np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1) * (radius * np.sqrt((np.arange(n) + 0.5) / n))[:, None]
    return at, np.tile([0.0, 0.0, -1.0], (n, 1)), np.full(n, 1 / n)


@pytest.mark.parametrize("part", [0.0, 0.3, 1.0])
def test_friction_used_is_force_or_torque_over_what_slides(part: float) -> None:
    """A flat round punch bears mu N along the face, and 2/3 mu N R about its axis; of that a part is asked for."""
    at, normal, p = disc(4000)
    most = 0.4 * p
    along = part * most[:, None] * np.array([0.6, -0.8, 0.0])
    assert friction_used(at, normal, most, along) == pytest.approx(part, abs=2e-3)
    around = part * most[:, None] * np.cross([0.0, 0.0, 1.0], at / np.linalg.norm(at, axis=1, keepdims=True))
    assert friction_used(at, normal, most, around) == pytest.approx(part, abs=2e-3)


def test_friction_used_in_a_slide_with_a_turn_is_one() -> None:
    """Whatever the centre of the turn: all slides, and no load of these pressures could be larger."""
    at, normal, p = disc(2000)
    for center in ([1.0, 0.0, 0.0], [0.0, 5.0, 0.0], [-2.0, 2.0, 0.0]):
        way = np.cross([0.0, 0.0, 1.0], at - center)
        slid = 0.3 * p[:, None] * way / np.linalg.norm(way, axis=1, keepdims=True)
        assert friction_used(at, normal, 0.3 * p, slid) == pytest.approx(1.0, abs=3e-3)
        assert friction_used(at, normal, 0.6 * p, slid) == pytest.approx(0.5, abs=3e-3)
