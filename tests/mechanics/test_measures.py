"""Formulas that both engines share: what they say, and the same of NumPy's arrays and PyTorch's."""

from typing import Any

import numpy as np
import pytest
from helpers.needs import needs

from tacgen.mechanics import measures

R = np.random.default_rng(5)
ALONG = np.tile([0.3, 0.0, 0.1], (1, 1, 2, 1))
ACROSS = np.tile([0.1, 0.0, -0.3], (1, 1, 2, 1))
BOTH = np.ones((1, 1, 2), bool)


@pytest.mark.parametrize(
    ("motion", "before", "touching", "weight"),
    [
        (ALONG, ALONG, BOTH, 1.0),
        (0.5 * ALONG, ALONG, BOTH, 0.25),  # an error of second order
        (3 * ALONG, ALONG, BOTH, 1.0),
        (ACROSS, ALONG, BOTH, 0.0),
        (-ALONG, ALONG, BOTH, 0.0),
        (ALONG, 0 * ALONG, BOTH, 0.0),
        (ALONG, ALONG, ~BOTH, 0.0),
    ],
)
def test_a_motion_that_goes_on_takes_the_last_steps_error_along(
    motion: np.ndarray, before: np.ndarray, touching: np.ndarray, weight: float
) -> None:
    assert measures.ahead(motion, before, touching) == pytest.approx([weight])


def test_a_point_touches_where_its_way_meets_the_surface() -> None:
    """At its end, one that was inside the shrunk indenter, within the tolerances, and goes away from it."""
    gap, ahead = np.array([1.0, 3.0, 1.0, 0.0, -0.1]), np.array([-1.0, -1.0, 0.5, -2.0, 0.4])
    at = measures.onset(np.array([[0.0, 0, -1]] * 5), np.array([[2.0, 0, 1]] * 5), gap, ahead)
    assert at == pytest.approx(np.array([[1.0, 0, 0], [1.5, 0, 0.5], [2, 0, 1], [0, 0, -1], [2, 0, 1]]))


def test_a_change_within_rounding_is_all_that_was_predicted() -> None:
    change, predicted = np.array([1e-9, -0.5, 0.5, -0.5]), np.array([-1.0, -1.0, -1.0, 3.0])
    assert measures.lowers(change, predicted, 1.0, 1e-6, 1e-3).tolist() == [True, True, False, True]
    assert measures.lowers(change, predicted, 1e4, 0.0, 0.0).tolist() == [True, True, False, True]
    enough = -measures.MIN_ENERGY_GAIN * np.array([2.0, 0.5])
    assert measures.lowers(enough, predicted[:2], 0.0, 0.0, 0.0).tolist() == [True, False]


def test_facets_are_touched_or_were_or_are_the_nearest() -> None:
    gap, last = np.array([[0.1, 0.5], [0.2, 0.3], [0.4, 0.1]]), np.array([[0.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    found = [
        measures.touched(gap, dhat, 0.1, old).tolist() for dhat, old in ((0.15, last), (0.05, last), (0.05, 0 * last))
    ]
    assert found == [[True, False, True], [False, True, False], [True, False, True]]


def arguments(name: str) -> tuple[Any, ...]:
    """Arrays for a formula."""
    points, numbers, some = R.normal(size=(2, 3, 4, 3)), R.normal(size=(2, 3, 4)), R.random((2, 3, 4)) > 0.4
    unit = points / np.linalg.norm(points, axis=-1, keepdims=True)
    nodes, held = R.normal(size=(2, 6, 3)), R.random((2, 6, 1)) > 0.5
    return {
        "slip": (points, points[::-1].copy(), unit),
        "onset": (points, points[::-1].copy(), numbers, numbers[::-1].copy()),
        "dragged": (points, points[::-1].copy(), unit, numbers, np.full((2, 1, 1), 0.3), np.full((2, 1, 1), 0.2)),
        "touched": (numbers, np.full((2, 1, 1), -0.5), numbers.min((1, 2), keepdims=True), some),
        "ahead": (points, points + 0.1 * unit, some),
        "imbalance": (nodes, nodes[::-1].copy(), held, np.array([2.0, 3.0])),
        "predicted_change": (nodes, 2 * nodes, nodes[:, 0], nodes[:, 1]),
        "lowers": (numbers[:, 0, 0], numbers[:, 0, 1], numbers[:, 0, 2], np.full(2, 0.1), np.full(2, 0.5)),
    }[name]


NAMES = ("slip", "onset", "touched", "dragged", "ahead", "imbalance", "predicted_change", "lowers")


@pytest.mark.parametrize("name", NAMES)
def test_pytorchs_arrays_have_numpys_answers(name: str) -> None:
    torch, formula, given = needs("torch"), getattr(measures, name), arguments(name)
    one, other = formula(*given), formula(*map(torch.as_tensor, given))
    for a, b in zip(*((each if isinstance(each, tuple) else (each,)) for each in (one, other)), strict=True):
        assert b.numpy() == pytest.approx(np.asarray(a), rel=1e-12, abs=1e-14)
