"""The measure of how well rendered presses stand for real ones: it finds what was done to them."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.tiny import sensor

from tacgen.calibrate import likeness, normal_net
from tacgen.calibrate.photos import PhotographedPress
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.hertz_dent import BallDent

FINE = {"mm_per_px": 0.1, "width_px": 80, "height_px": 64}
CIRCLES = ((3.0, (30.0, 28.0), 15.0), (2.5, (52.0, 40.0), 12.0), (3.0, (45.0, 20.0), 13.0))


@pytest.fixture(scope="module")
def compared():
    return likeness.Comparison(sensor(camera=FINE, markers=None))


@pytest.fixture(scope="module")
def unit(compared):
    """Photographs of the sensor itself: untouched, presses and their faces."""
    renderer, camera = compared._renderer, PinholeCamera.from_sensor(compared.sensor)
    faces = [BallDent.seen(camera, *circle) for circle in CIRCLES]
    pictures = [renderer.develop(renderer.image(face)) for face in faces]
    rows = zip(CIRCLES, pictures, strict=True)
    presses = [PhotographedPress(f"{k}", p, c[0], c[1], c[2], None) for k, (c, p) in enumerate(rows)]
    return renderer.develop(renderer.flat()), presses, faces


def test_pictures_of_the_sensor_itself_are_alike(compared, unit):
    untouched, presses, faces = unit
    found = compared.likeness(presses, faces, untouched)
    assert found.contrast == pytest.approx(1.0, abs=1e-9)
    assert found.direction == pytest.approx(0.0, abs=1e-6)
    assert found.correlation == pytest.approx(1.0, abs=1e-9)
    assert found.normals < 3 < 15 < found.flat
    assert found.noisy == pytest.approx(found.normals, abs=1e-9)  # this camera has no noise


def test_half_the_change_is_reported(compared, unit):
    untouched, presses, faces = unit
    weak = [replace(p, picture=(untouched + 0.5 * (p.picture.astype(float) - untouched))) for p in presses]
    found = compared.likeness(weak, faces, untouched)
    assert found.contrast == pytest.approx(2.0, rel=0.02)
    assert found.normals > 2 * compared.likeness(presses, faces, untouched).normals
    assert found.noisy < found.normals / 2


def test_the_nets_slope_is_that_of_its_loss(monkeypatch):
    """Against a plain function: a net learns it, and without steps it does not."""
    monkeypatch.setattr(normal_net, "STEPS", 300)
    random = np.random.default_rng(1)
    features = random.uniform(-1, 1, (600, 5))
    wanted = np.column_stack([np.tanh(features[:, 0] - features[:, 3]), 0.5 * features[:, 1] ** 2])
    off = np.abs(normal_net.NormalNet.trained(features, wanted).normals(features) - wanted).mean()
    assert off < 0.04
    monkeypatch.setattr(normal_net, "STEPS", 0)
    assert np.abs(normal_net.NormalNet.trained(features, wanted).normals(features) - wanted).mean() > 5 * off


def test_changes_are_smoothed_and_places_are_not():
    """White noise has 1 / (2 sqrt(pi) SMOOTH) of its standard deviation left."""
    noise = np.random.default_rng(0).normal(0, normal_net.COUNTS, (80, 100, 3))
    found = normal_net.features(noise, np.ones((80, 100), bool))
    assert found[:, :3].std() == pytest.approx(1 / (2 * np.sqrt(np.pi) * normal_net.SMOOTH), rel=0.1)
    assert (found[0, 3], found[-1, 3]) == pytest.approx((-0.99, 0.99))
    assert (found[0, 4], found[-1, 4]) == pytest.approx((-0.79, 0.79))


def test_degrees_apart():
    level, steep = np.zeros((2, 2)), np.array([[0.5, 0.0], [0.0, -1.0]])
    assert normal_net.degrees_apart(level, steep) == pytest.approx([30.0, 90.0])
    assert normal_net.degrees_apart(steep, steep) == pytest.approx(0.0, abs=1e-5)
