"""Errors of forces by range: what one who does not look gets, where predictions stop, and what was never learned."""

import numpy as np
import pytest

from tacgen.report import force_ranges

TRUE = np.linspace(0.1, 40, 400)


def test_errors_stand_beside_those_of_the_mean_in_each_range() -> None:
    found = force_ranges.ranges(TRUE, 1.1 * TRUE, 10.0)
    assert [one["low"] for one in found] == [0.0, 2.0, 5.0, 10.0, 14.0, 20.0, 30.0]
    assert [one["high"] for one in found] == [2.0, 5.0, 10.0, 14.0, 20.0, 30.0, 45.0]  # not the largest force seen
    assert sum(one["n"] for one in found) == 400
    for one in found:
        assert one["mae"] == pytest.approx(0.1 * one["true"])
        assert one["bias"] == pytest.approx(one["mae"])
    assert found[0]["guess"] == pytest.approx(9.0, abs=0.1)


@pytest.mark.parametrize("stop", [12.0, 25.0])
def test_the_force_where_predictions_stop_growing_is_found(stop: float) -> None:
    found = force_ranges.saturation(force_ranges.ranges(TRUE, np.minimum(TRUE, stop), 10.0))
    assert found == pytest.approx(stop, abs=6)
    assert force_ranges.saturation(force_ranges.ranges(TRUE, TRUE, 10.0)) is None


def test_few_forces_join_the_next_range_and_none_is_lost() -> None:
    true = np.array([0.5, 1.0, 3.0, 4.0, 4.5, 6.0, 7.0, 8.0, 9.0, 9.5, 31.0])
    found = force_ranges.ranges(true, true, 5.0)
    assert sum(one["n"] for one in found) == len(true)
    assert min(one["n"] for one in found) >= force_ranges.MIN_RANGE_FORCES


def test_forces_beyond_all_that_were_learned_are_named() -> None:
    said = force_ranges.lines(TRUE, np.minimum(TRUE, 14.0), TRUE[TRUE < 14])
    assert any(line.startswith("predictions stop growing at ") for line in said)
    assert "larger than any learned from" in said[-1]
    assert "larger than any learned from" not in force_ranges.lines(TRUE, TRUE, TRUE)[-1]
