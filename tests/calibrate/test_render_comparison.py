"""The measure of how well rendered presses stand for real ones: it finds what was done to them."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.tiny import sensor

from tacgen.calibrate import normal_net, render_comparison
from tacgen.calibrate.photos import PhotographedPress
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.hertz_dent import BallDent
from tacgen.recipe import assets, loading

FINE = {"mm_per_px": 0.1, "width_px": 80, "height_px": 64}
CIRCLES = ((3.0, (30.0, 28.0), 15.0), (2.5, (52.0, 40.0), 12.0), (3.0, (45.0, 20.0), 13.0))


@pytest.fixture(scope="module", autouse=True)
def one_network():
    """One instead of several."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(normal_net, "ENSEMBLE_SIZE", 1)
        yield


@pytest.fixture(scope="module")
def compared():
    return render_comparison.Comparison(sensor(camera=FINE, markers=None))


@pytest.fixture(scope="module")
def unit(compared):
    """Photographs of the sensor itself: untouched, presses and their faces."""
    renderer, camera = compared._renderer, PinholeCamera.from_sensor(compared.sensor)
    faces = [BallDent.seen(camera, *circle) for circle in CIRCLES]
    pictures = [renderer.develop(renderer.image(face)) for face in faces]
    rows = zip(CIRCLES, pictures, strict=True)
    presses = [PhotographedPress(f"{k}", p, c[0], c[1], c[2], None) for k, (c, p) in enumerate(rows)]
    return renderer.develop(renderer.flat()), presses, faces


@pytest.fixture(scope="module")
def alike(compared, unit):
    """How like the sensor's own pictures are."""
    untouched, presses, faces = unit
    return compared.likeness(presses, faces, untouched)


@pytest.mark.slow
def test_pictures_of_the_sensor_itself_are_alike(alike):
    assert alike.contrast == pytest.approx(1.0, abs=1e-9)
    assert alike.direction == pytest.approx(0.0, abs=1e-6)
    assert alike.correlation == pytest.approx(1.0, abs=1e-9)
    assert alike.normals < 3 < 15 < alike.flat
    assert alike.noisy == pytest.approx(alike.normals, abs=1e-9)  # this camera has no noise


@pytest.mark.slow
def test_half_the_change_is_reported(compared, unit, alike):
    untouched, presses, faces = unit
    weak = [replace(p, picture=(untouched + 0.5 * (p.picture.astype(float) - untouched))) for p in presses]
    found = compared.likeness(weak, faces, untouched)
    assert found.contrast == pytest.approx(2.0, rel=0.02)
    assert found.normals > 2 * alike.normals
    assert found.noisy < found.normals / 2


def test_a_network_learns_a_plain_function(monkeypatch):
    """The slope of its loss is right; without steps it does not learn."""
    monkeypatch.setattr(normal_net, "MAX_LBFGS_STEPS", 300)
    random, presses = np.random.default_rng(1), []
    for _ in range(60):
        features = random.uniform(-1, 1, (100, 5))
        presses.append((features, np.column_stack([np.tanh(features[:, 0] - features[:, 3]), features[:, 1] ** 2 / 2])))

    def off() -> float:
        net = normal_net.NormalNet.trained(presses)
        return float(np.mean([np.abs(net.normals(features) - wanted).mean() for features, wanted in presses]))

    learnt = off()
    assert learnt < 0.04
    monkeypatch.setattr(normal_net, "MAX_LBFGS_STEPS", 0)
    assert off() > 5 * learnt


@pytest.mark.slow
def test_few_presses_are_not_learnt_by_heart(monkeypatch):
    """The decay by press: with that of 192 presses, networks of five find them better, and others worse."""
    monkeypatch.setattr(normal_net, "MAX_LBFGS_STEPS", 300)
    mini = render_comparison.Comparison(loading.read_sensor(assets.sensor_path("gelsight_mini"))[0])
    *sets, others = ([dent.pixels for dent in mini.dents(0.75, *some)] for some in ((5, 0), (5, 2), (5, 3), (16, 1)))

    def off() -> list[float]:
        each = []
        for few in sets:
            net = render_comparison.learned(few)
            each.append([np.mean([one.off(net) for one in part]) for part in (few, others)])
        return np.mean(each, axis=0).tolist()

    held = off()
    monkeypatch.setattr(normal_net, "WEIGHT_DECAY", normal_net.WEIGHT_DECAY * 5 / render_comparison.TRAINING_DENTS)
    loose = off()
    assert loose[0] < held[0] / 2
    assert loose[1] > 1.2 * held[1]


@pytest.mark.slow
def test_noise_in_training_makes_the_network_smooth(monkeypatch):
    """Normals that turn to and fro within small changes are learnt as their mean, which bears a colour that is off."""
    monkeypatch.setattr(normal_net, "MAX_LBFGS_STEPS", 300)
    monkeypatch.setattr(normal_net, "WEIGHT_DECAY", 1e-5)
    features = np.random.default_rng(1).uniform(-1, 1, (4000, 5))
    waves = np.sin(2 * np.pi * normal_net.CHANGE_PER_INPUT_UNIT / 0.6 * features[:, 0])  # of 0.6

    def learnt(noise: float) -> float:
        monkeypatch.setattr(normal_net, "TRAINING_NOISE", noise)
        net = normal_net.NormalNet.trained([(features, np.column_stack([waves / 3, 0 * waves]))])
        return float(3 * np.mean(net.normals(features)[:, 0] * waves) / np.mean(waves**2))

    assert learnt(0.0) > 0.8
    assert learnt(0.1) == pytest.approx(np.exp(-((2 * np.pi * 10 / 60) ** 2) / 2), abs=0.1)


@pytest.mark.slow
def test_several_networks_that_differ_are_averaged(compared, monkeypatch):
    monkeypatch.setattr(normal_net, "ENSEMBLE_SIZE", 2)
    dents = [dent.pixels for dent in compared.dents(0.75, 20)]
    net, features = render_comparison.learned(dents), dents[0].features
    one, other = (normal_net.NormalNet((member,)).normals(features) for member in net.members)
    assert net.normals(features) == pytest.approx((one + other) / 2, abs=1e-6)
    assert np.abs(one - other).max() > 1e-3


def test_changes_are_smoothed_and_places_are_not():
    """White noise has 1 / (2 sqrt(pi) SMOOTH) of its standard deviation left."""
    untouched = np.full((80, 100, 3), 50.0)
    noise = np.random.default_rng(0).normal(0, 50 * normal_net.CHANGE_PER_INPUT_UNIT, untouched.shape)
    found = normal_net.features(noise, untouched, np.ones((80, 100), bool))
    assert found[:, :3].std() == pytest.approx(1 / (2 * np.sqrt(np.pi) * normal_net.CHANGE_BLUR_PX), rel=0.1)
    assert (found[0, 3], found[-1, 3]) == pytest.approx((-0.99, 0.99))
    assert (found[0, 4], found[-1, 4]) == pytest.approx((-0.79, 0.79))


def test_gain_and_power_of_the_lamps_cancel(unit):
    """Colours are scaled by a factor each, as another unit's lamps would do."""
    untouched, (press, *_), _ = unit
    gain, here = np.array([0.6, 1.3, 0.9]), np.ones(untouched.shape[:2], bool)
    change = press.picture.astype(float) - untouched
    one, other = (normal_net.features(k * change, k * untouched, here) for k in (1.0, gain))
    assert np.abs(one[:, :3]).max() > 0.5
    assert other == pytest.approx(one, abs=1e-9)


def test_degrees_apart():
    level, steep = np.zeros((2, 2)), np.array([[0.5, 0.0], [0.0, -1.0]])
    assert normal_net.degrees_apart(level, steep) == pytest.approx([30.0, 90.0])
    assert normal_net.degrees_apart(steep, steep) == pytest.approx(0.0, abs=1e-5)
