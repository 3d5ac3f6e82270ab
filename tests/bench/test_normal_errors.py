"""Sources of the error of normals: a wrong centre, a wrong file, light from elsewhere and dots are told from noise."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.tiny import sensor

from benchmarks import mini_units, normal_errors
from benchmarks.mini_units import MiniUnit
from tacgen.calibrate import likeness, normal_net
from tacgen.calibrate.likeness import Comparison, PictureOfPress, circle
from tacgen.calibrate.normal_net import NormalNet
from tacgen.calibrate.photos import PhotographedPress
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.hertz_dent import BallDent
from tacgen.sensor.model import LitSensor

Array = np.ndarray
SHAPE = (64, 80)
CIRCLES = ((3.0, (30.0, 28.0), 15.0), (2.5, (52.0, 40.0), 12.0))


def tiny() -> LitSensor:
    """A small sensor with a picture of SHAPE."""
    return sensor(camera={"mm_per_px": 0.1, "width_px": SHAPE[1], "height_px": SHAPE[0]}, markers=None)


class Ball(NormalNet):
    """A network that finds the slopes of a ball, whatever the picture."""

    def normals(self, features: Array) -> Array:
        """Slopes 1/40 px around (42, 29) px."""
        width = SHAPE[1]
        place = (features[:, 3:] + [1, SHAPE[0] / width]) * width / 2
        return np.asarray((place - [42.0, 29.0]) / 40)


def test_a_wrong_centre_is_found() -> None:
    where = circle(SHAPE, (40.0, 30.0), 14.0)
    y, x = np.nonzero(where)
    slopes = np.column_stack([x + 0.5 - 40, y + 0.5 - 30]) / 40
    press = PictureOfPress(np.zeros((*SHAPE, 3)), where, slopes, 0 * slopes)
    error, away = normal_errors.shifted(Ball(()), press)
    assert away == pytest.approx([2.0, -1.0])
    assert error < 1e-3 < 2 < press.off(Ball(()).normals(press.features))


def test_dots_are_not_smoothed_into_what_is_seen() -> None:
    change = np.full((*SHAPE, 3), 20.0)
    hidden = circle(SHAPE, (40.0, 30.0), 6.0)
    change[hidden] = -80.0
    where = circle(SHAPE, (40.0, 30.0), 14.0)
    slopes = np.zeros((where.sum(), 2))
    seen = mini_units.without(PictureOfPress(change, where, slopes, slopes), hidden)
    assert not (seen.where & hidden).any()
    assert len(seen.slopes) == seen.where.sum() == len(seen.features)
    assert seen.features[:, :3] * normal_net.COUNTS == pytest.approx(20.0)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """One network learns from few dents, in few steps."""
    monkeypatch.setattr(likeness, "DENTS", 60)
    monkeypatch.setattr(normal_net, "STEPS", 60)
    monkeypatch.setattr(normal_net, "MEMBERS", 1)


@pytest.fixture(scope="module")
def unit() -> MiniUnit:
    """Photographs of the sensor itself."""
    one = tiny()
    compared, camera, random = Comparison(one), PinholeCamera.from_sensor(one), np.random.default_rng(1)
    pictures = [compared.picture(BallDent.seen(camera, *press), random) for press in CIRCLES]
    presses = tuple(
        PhotographedPress(f"{k}", p, *c, None) for k, (c, p) in enumerate(zip(CIRCLES, pictures, strict=True))
    )
    return MiniUnit("another", compared.flat, presses, tuple(np.zeros(SHAPE, bool) for _ in presses))


@pytest.mark.slow
def test_a_wrong_file_is_told_from_noise(unit: MiniUnit) -> None:
    one = tiny()
    clean, noisy, grainy, found, moved, real, *_ = normal_errors.sources(one, unit)
    assert grainy is found is moved is None  # known of the Minis alone
    assert clean == noisy == pytest.approx(real, abs=1e-9)  # this camera has no noise
    weak = [replace(p, picture=unit.untouched + 0.6 * (p.picture.astype(float) - unit.untouched)) for p in unit.presses]
    found_weak = normal_errors.sources(one, replace(unit, presses=tuple(weak)))
    assert found_weak[:2] == [clean, noisy]
    assert (found_weak[5] or 0) > 1.5 * (real or 0)
    assert (found_weak[9] or 0) < 0.8 * (found_weak[5] or 0)  # less the linear misfit


@pytest.mark.slow
def test_grain_and_circles_are_sources_of_a_mini(unit: MiniUnit, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(normal_errors.real_grain, "fitted", lambda power: (5.0, 1.0))
    one = tiny()
    cells = normal_errors.sources(one, replace(unit, name="gelsight_mini"))
    assert all(cell is not None for cell in cells)
    _, noisy, grainy, found, moved, *_ = (float(cell or 0) for cell in cells)
    assert noisy < grainy  # 5 % of grain
    assert moved < found < 15


@pytest.fixture
def pair() -> tuple[PictureOfPress, PictureOfPress]:
    """A photographed and a rendered press, which differ by 3 counts, 20 counts per slope along x in red, and 50 per
    squared slope along y in blue."""
    random, where = np.random.default_rng(1), np.zeros((12, 10), bool)
    where[2:9, 3:9] = True
    slopes, flat = random.uniform(-0.7, 0.7, (where.sum(), 2)), np.full((where.sum(), 2), 0.1)
    made = PictureOfPress(random.normal(size=(12, 10, 3)), where, slopes, flat)
    change, (x, y) = made.change.copy(), (slopes - flat).T
    change[where] += np.column_stack([3 + 20 * x, np.full(len(x), 3.0), 3 + 50 * y**2])
    return PictureOfPress(change, where, slopes, flat), made


def test_a_misfit_is_taken_off_by_the_order_of_its_polynomial(pair: tuple[PictureOfPress, PictureOfPress]) -> None:
    real, made = pair
    less = [normal_errors.without(real, made, order).change for order in range(3)]
    left = [np.abs((change - made.change)[real.where]).max(axis=0) for change in less]
    assert left[0][0] > 5
    assert left[0][1] < 1e-9
    assert left[1][0] < 1e-9
    assert left[1][2] > 5
    assert (left[2] < 1e-9).all()
    assert all((change == real.change)[~real.where].all() for change in less)
