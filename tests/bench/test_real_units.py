"""The population is drawn around three units, and its networks are scored on presses that they have not seen."""

import numpy as np
import pytest

from benchmarks import real_units
from benchmarks.real_units import Samples
from tacgen.calibrate.likeness import Comparison
from tacgen.recipe import assets, plan

Array = np.ndarray


def pressed(seed: int, gain: float = 1.0) -> Samples:
    """Pixels whose change of colour is proportional to the slope."""
    random = np.random.default_rng(seed)
    slopes = random.uniform(-0.5, 0.5, (400, 2))
    change = gain * np.column_stack([slopes, slopes.sum(axis=1)])
    features = np.column_stack([change, random.uniform(-1, 1, (400, 2))])
    return Samples((features, 2 * features), slopes)


def test_a_network_learns_one_unit_and_fails_on_one_of_another_contrast() -> None:
    net = real_units.trained([pressed(k) for k in range(6)], 0)
    assert real_units.off(net, [pressed(9)], 0) < 1.5
    assert real_units.off(net, [pressed(9, gain=2.0)], 0) > 8
    assert real_units.off(net, [pressed(9)], 1) > 8  # pictures smoothed otherwise


def test_own_photographs_are_left_out_in_turn() -> None:
    """The odd one of six is unlike all others: no network that has not seen it suits it."""
    presses = [pressed(k) for k in range(5)]
    even = real_units.left_out(presses, 0)
    odd = real_units.left_out([*presses, pressed(5, gain=-1.0)], 0)
    assert even < 2
    assert odd > even + 4


def test_the_recipe_draws_as_many_units_around_each_of_the_three_files() -> None:
    rows = plan.load(assets.recipe_path(real_units.RECIPE)).rows
    count = {name: sum(row.sensor.name == name for row in rows) for name in real_units.FILES.values()}
    assert sum(count.values()) == len(rows) == 64
    assert min(count.values()) >= 20
    assert len({row.sensor.coating.grain.seed for row in rows}) == 64
    assert all(row.sensor.markers is None for row in rows)
    lights = [real_units.sensor_of(name).leds[1].radiance[1] for name in count]
    assert max(lights) / min(lights) > 1.2


def test_dents_of_a_seed_are_the_same_and_of_another_are_not() -> None:
    compared = Comparison(real_units.sensor_of("gelsight_mini"))
    one, again, other = (next(compared.dents(0.7, 1, seed)) for seed in (0, 0, 1))
    assert np.array_equal(one.change, again.change)
    assert one.slopes.shape != other.slopes.shape
    made = Samples.of(one, 50)
    assert made.slopes.shape == (50, 2)
    assert made.features[1][:, :3].std() < made.features[0][:, :3].std()
    assert made.features[0][:, 3:] == pytest.approx(made.features[1][:, 3:])
