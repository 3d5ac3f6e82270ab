"""Dots moved by the indenter's pose alone: signs, limits, memory of the first touch, and what refuses it."""

import numpy as np
import pytest
from helpers import small_recipe
from helpers.tiny import sensor

from tacgen.batch.pipeline import run
from tacgen.bundle import bundle
from tacgen.geometry.analytic_sdf import SphereSdf
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.coating import centers
from tacgen.outputs.fots_markers import FotsMarkers
from tacgen.sensor.markers import Motion

MOTION = Motion(press=(0.02, 0.05), shear=(0.5, 0.1), twist=(20.0, 0.1), source="test")
TINY = sensor()
PX = TINY.camera.mm_per_px


def pose(z: float, x: float = 0.0, turn_deg: float = 0.0) -> np.ndarray:
    made, turn = np.eye(4), np.radians(turn_deg)
    made[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    made[:3, 3] = x, 0.0, z
    return made


@pytest.fixture
def drift():
    return FotsMarkers(MOTION, centers(TINY.markers), TINY.gel, SphereSdf(3.0), PinholeCamera.from_sensor(TINY))


def flow(drift: FotsMarkers, *poses: np.ndarray) -> np.ndarray:
    """Of the dots (3, 3, 2) [px] at the last pose."""
    return (np.array([drift.at(one)[0] for one in poses])[-1] - drift.undisturbed).reshape(3, 3, 2)


def test_a_press_drives_dots_apart_and_leaves_the_middle(drift):
    moved = flow(drift, pose(-0.5))
    assert moved[1, 1] == pytest.approx([0, 0], abs=1e-6)
    outward = [moved[1, 2, 0], -moved[1, 0, 0], moved[2, 1, 1], -moved[0, 1, 1]]
    assert min(outward) > 0.05


def test_a_slide_drags_the_middle_along_up_to_its_limit(drift):
    pressed = flow(drift, pose(-0.5))
    part = flow(drift, pose(-0.5), pose(-0.5, x=0.2)) - pressed
    assert part[1, 1, 0] == pytest.approx(0.2 / PX, rel=0.05)
    far = flow(drift, pose(0.5), pose(-0.5, x=-0.9), pose(-0.5, x=0.0))
    assert far[1, 1, 0] == pytest.approx(0.5 / PX, rel=0.02)


def test_a_twist_turns_dots_about_the_contact(drift):
    moved = flow(drift, pose(-0.5), pose(-0.5, turn_deg=10)) - flow(drift, pose(0.1), pose(-0.5))
    arm = TINY.markers.pitch_mm[0]
    assert moved[1, 2, 1] == pytest.approx(np.radians(10) * arm * np.exp(-0.1 * arm**2) / PX, rel=0.02)
    assert moved[1, 2, 0] == pytest.approx(0, abs=1e-3)
    most = flow(drift, pose(0.1), pose(-0.5), pose(-0.5, turn_deg=MOTION.twist[0]))
    assert flow(drift, pose(-0.5, turn_deg=50)) == pytest.approx(most)
    assert np.abs(most - flow(drift, pose(-0.5, turn_deg=15))).max() > 0.01


def test_off_the_gel_all_is_still_and_forgotten(drift):
    assert (flow(drift, pose(-0.5), pose(-0.5, x=0.4), pose(0.2, x=0.4)) == 0).all()
    again = flow(drift, pose(-0.5, x=0.4))
    assert abs(again[1, 1, 0]) < 0.3 / PX  # not dragged: it touched down there


def test_a_recipe_can_ask_for_it(tmp_path):
    moves, flows = "press: {depth_mm: 0.5, frames: 1}, slide: {x_mm: 0.4, frames: 1}", {}
    for method in ("fem", "analytic"):
        row = small_recipe.row(moves, "outputs=[markers]", f"markers.method={method}", "contact.friction=0.6")
        (done,) = run([row], tmp_path / method)
        flows[method] = bundle.read(done.path)["/frames/marker_flow"][-1]
    off = np.linalg.norm(flows["fem"] - flows["analytic"]) / np.linalg.norm(flows["fem"])
    assert 0.05 < off < 0.8  # alike, and not the same
