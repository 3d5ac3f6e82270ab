"""The population is drawn around three units, networks are scored on unseen presses, and the Wedge's photographs."""

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import grain, photographs, real, summary
from tacgen.calibrate import normal_net
from tacgen.calibrate import photos as reading
from tacgen.calibrate.normal_net import NormalNet
from tacgen.calibrate.render_comparison import Comparison, PictureOfPress, PressPixels, circle, learned
from tacgen.recipe import assets, loading, plan
from tacgen.recipe.row import Row
from tacgen.sensor.model import LitSensor

Array = np.ndarray


def pressed(seed: int, gain: float = 1.0) -> PressPixels:
    """Pixels of a ball, in a square, whose change of colour is proportional to the slope."""
    random, along = np.random.default_rng(seed), np.linspace(-0.48, 0.48, 20)
    slopes = np.stack(np.meshgrid(along, along), axis=-1).reshape(400, 2)
    change = gain * np.column_stack([slopes, slopes.sum(axis=1)])
    features = np.column_stack([change, random.uniform(-1, 1, (400, 2))])
    return PressPixels(features, slopes, np.ones((20, 20), bool))


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    """The recipe's scenes."""
    return list(plan.load(assets.recipe_path(real.RECIPE)).rows)


@pytest.fixture(autouse=True)
def one_network(monkeypatch: pytest.MonkeyPatch) -> None:
    """One instead of several, which learns from less in fewer steps."""
    for name, less in (("ENSEMBLE_SIZE", 1), ("TRAINING_SAMPLES", 1000), ("MAX_LBFGS_STEPS", 200)):
        monkeypatch.setattr(normal_net, name, less)


def test_a_network_learns_one_unit_and_fails_on_one_of_another_contrast() -> None:
    net = learned([pressed(k) for k in range(192)])
    assert real.off(net, [pressed(999)]) < 1.5
    assert real.off(net, [pressed(999, gain=2.0)]) > 8


@pytest.mark.slow
def test_own_photographs_are_left_out_in_turn() -> None:
    """The odd third is unlike all others: no network that has not seen it suits it."""
    presses = [pressed(k) for k in range(60)]
    even = real.left_out(presses)
    odd = real.left_out([one if k % 3 else pressed(k, gain=-1.0) for k, one in enumerate(presses)])
    assert even < 2
    assert odd > even + 4


@pytest.mark.slow
def test_the_recipe_draws_as_many_units_around_each_of_the_three_files(rows: list[Row]) -> None:
    count = {name: sum(row.sensor.name == name for row in rows) for name in real.FILES.values()}
    assert sum(count.values()) == len(rows) == 64
    assert min(count.values()) >= 20
    assert len({row.sensor.coating.grain.seed for row in rows}) == 64
    assert all(row.sensor.markers is None for row in rows)
    lights = [real.sensor_of(name).leds[1].radiance[1] for name in count]
    assert max(lights) / min(lights) > 1.2


@pytest.mark.slow
def test_a_unit_is_scored_by_those_drawn_around_the_others(rows: list[Row], monkeypatch: pytest.MonkeyPatch) -> None:
    """The last of three units has another contrast: only networks that have seen its file suit it."""
    names = list(real.FILES)

    def drawn(sensor: LitSensor, count: int, seed: int, deepest: float) -> list[PressPixels]:
        """Dents steeper than the presses of two units are unlike those."""
        gain = 3.0 if sensor.name == real.FILES[names[2]] else 1.0
        made = [pressed(seed + k, gain) for k in range(count)]
        steep = pressed(seed, -1.0)._replace(slopes=1.2 * pressed(seed).slopes)
        return [*made, steep] if deepest > 0.8 and gain == 1.0 else made

    def photographed(name: str, sensor: LitSensor) -> tuple[list[PressPixels], float, float]:
        last = name == names[2]
        return [pressed(99 + k, 3.0 if last else 1.0) for k in range(60)], 20.0, 0.9 if last else 0.75

    steepest = []

    def trained(presses: Sequence[PressPixels]) -> NormalNet:
        steepest.append(max(one.steepest for one in presses))
        return learned(presses)

    monkeypatch.setattr(real, "learned", trained)
    monkeypatch.setattr(real, "drawn", drawn)
    monkeypatch.setattr(real, "photographed", photographed)
    monkeypatch.setattr(real.plan, "load", lambda path: SimpleNamespace(rows=rows))
    monkeypatch.setattr(normal_net, "TRAINING_SAMPLES", 500)
    monkeypatch.setattr(normal_net, "MAX_LBFGS_STEPS", 100)
    table = real.population(lambda text: None)
    assert [row[0] for row in table.rows] == names
    assert all(len(row) == 3 + len(real.TRAINED) for row in table.rows)
    errors = {row[0]: row[3:] for row in table.rows}
    others, own, left_out = errors[names[2]]
    assert others > 8 > 3 > own
    assert left_out < 3
    assert errors[names[0]][0] < others
    each = len(steepest) // len(names)
    assert max(steepest[:-each]) <= 0.75 < max(steepest[-each:])  # dents of a network are as deep as its presses


@pytest.mark.slow
def test_dents_of_a_seed_are_the_same_and_of_another_are_not() -> None:
    compared = Comparison(real.sensor_of("gelsight_mini"))
    one, again, other = (next(compared.dents(0.7, 1, seed)) for seed in (0, 0, 1))
    assert np.array_equal(one.change, again.change)
    assert one.slopes.shape != other.slopes.shape
    made = one.pixels
    assert made.slopes.shape == (one.where.sum(), 2)
    assert made.features.shape == (one.where.sum(), 5)


def test_dots_are_not_smoothed_into_what_is_seen() -> None:
    shape = (64, 80)
    change, hidden, where = np.full((*shape, 3), 20.0), circle(shape, (40.0, 30.0), 6.0), circle(shape, (40, 30), 14.0)
    untouched = np.full_like(change, 100.0)
    change[hidden], untouched[hidden] = -80.0, 15.0
    slopes = np.zeros((where.sum(), 2))
    seen = photographs.without(PictureOfPress(change, untouched, where, slopes, slopes), hidden)
    assert not (seen.where & hidden).any()
    assert len(seen.slopes) == seen.where.sum() == len(seen.pixels.features)
    assert seen.pixels.features[:, :3] * normal_net.CHANGE_PER_INPUT_UNIT == pytest.approx(0.2)


def test_dots_are_found_in_uneven_light() -> None:
    y, x = np.mgrid[:240, :320] + 0.5
    picture = (80 + 40 * np.sin(x / 90) + 20 * np.cos(y / 70))[..., None] * [0.8, 1.0, 1.1]
    spot = np.hypot(x % 32 - 16, y % 32 - 16) < 6
    picture[spot] *= 0.4
    hidden = photographs.dark(picture)
    assert hidden[spot].all()
    assert hidden.mean() < 0.35


def test_the_summary_tells_the_profile_of_9dtact() -> None:
    told = [text for _, text in summary._real({"Depth from grey": [{"profile off, of peak": 0.013}]})]
    assert told == ["9DTact 1.3%"]


def test_grain_tells_reflectance_from_relief() -> None:
    """Reflectance changes all colours alike; relief changes red against blue. A trend of the dent is no grain."""
    random, where = np.random.default_rng(0), circle((120, 120), (60.0, 60.0), 40.0)
    y, x = np.mgrid[:120, :120] / 120.0
    even, relief = random.normal(0, 2.0, (2, 120, 120))
    shape = 60 * np.stack([x**2, x * y, y], axis=2)
    bands = [np.outer([1.0, 1.0, 1.0], [1.0, 1.0, 1.0]), np.outer([1.0, 0.0, -1.0], [1.0, 0.0, -1.0])]
    for field, colours, wanted in ((even, (1, 1, 1), bands[0]), (relief, (1, 0, -1), bands[1])):
        found = grain.covariance(field[..., None] * np.array(colours) + shape, where, (0.6, 1.2))
        assert found / found[0, 0] == pytest.approx(wanted, abs=0.05)
    twice = grain.covariance(2 * even[..., None] * np.ones(3) + shape, where, (0.6, 1.2))
    once = grain.covariance(even[..., None] * np.ones(3) + shape, where, (0.6, 1.2))
    assert np.sqrt(twice[0, 0] / once[0, 0]) == pytest.approx(2.0, abs=0.02)


@pytest.mark.slow
def test_its_sensor_file_and_table_are_what_the_calibration_takes(tmp_path: Path) -> None:
    sensor, _ = loading.read_sensor(real.WEDGE_UNIT)
    assert (sensor.camera.width_px, sensor.camera.height_px) == real.WEDGE_SIZE
    if not (photographs.reference() / real.WEDGE / real.FORCES).is_file():
        pytest.skip(f"no photographs in {photographs.reference()}")
    real.wedge_laid_out(tmp_path)
    photos = reading.read_gauged(tmp_path, sensor.camera)
    assert len(photos.presses) == 43
    assert photos.recordings == ["grip 0", "grip 1"]
    assert max(press.force for press in photos.presses) == pytest.approx(25.35)
