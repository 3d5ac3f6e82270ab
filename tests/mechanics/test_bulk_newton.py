"""When a step of the bulk ends Newton's method, and how much the next one is damped."""

import numpy as np
import pytest

from tacgen.mechanics.bulk_newton import in_folds, next_damping, settles
from tacgen.mechanics.condensation import DAMPING_FACTOR, MIN_DAMPING
from tacgen.mechanics.options import DEFAULT_OPTIONS
from tacgen.mechanics.state import State

TOLERANCE, HALF = DEFAULT_OPTIONS.residual_tol, DEFAULT_OPTIONS.residual_max / 2
IN_FOLDS, LAST = DEFAULT_OPTIONS.fold_tol, DEFAULT_OPTIONS.fold_steps


@pytest.mark.parametrize(
    ("residual", "folding", "damping", "still", "converged", "rests", "expected"),
    [
        (0.9 * TOLERANCE, 0, 0.0, False, True, False, True),
        (0.9 * TOLERANCE, 0, 0.0, True, False, False, False),  # contact stalled
        (0.9 * HALF, 0, 0.0, False, True, False, False),
        (0.9 * HALF, 0, 0.0, True, True, False, True),
        (0.9 * HALF, 0, 0.0, False, False, True, True),  # contact goes in circles
        (1.1 * HALF, 0, 0.0, True, False, True, False),
        (0.9 * IN_FOLDS, 0, 0.0, True, True, False, False),
        (0.9 * IN_FOLDS, 1, 0.1, False, True, False, True),
        (0.9 * IN_FOLDS, 1, 0.1, False, False, False, False),
        (1.1 * IN_FOLDS, LAST - 1, 0.1, False, True, False, False),
        (1.1 * IN_FOLDS, LAST, 0.1, False, True, False, True),
        (1.1 * IN_FOLDS, LAST, 0.0, False, True, False, False),  # about to converge
        (1.1 * DEFAULT_OPTIONS.fold_max, 2 * LAST, 0.1, False, True, False, False),
    ],
)
def test_a_step_settles(
    residual: float, folding: int, damping: float, still: bool, converged: bool, rests: bool, expected: bool
) -> None:
    assert settles(DEFAULT_OPTIONS, residual, folding, damping, still, converged, rests) is expected


def test_steps_in_folds_are_counted_over_the_load_steps_of_a_frame() -> None:
    rest = np.zeros((1, 3))
    frame = State(0, np.eye(4), rest, rest, rest, None, None, 5, 1, 0, 0, 0, 0, 0, 0, damped=3)
    assert [in_folds(2, None), in_folds(2, frame), in_folds(0, frame)] == [2, 5, 0]


def test_damping_follows_the_steps() -> None:
    assert next_damping(0.0, 1.0, False, True) == 0
    assert next_damping(1.0, 1.0, False, False) == 1 / DAMPING_FACTOR
    assert next_damping(MIN_DAMPING, 1.0, False, True) == 0
    assert next_damping(1.0, 0.5, False, True) == 1.0
    assert next_damping(1.0, 1.0, True, True) == 1.0
    assert next_damping(0.0, 1.0, True, False) == MIN_DAMPING
    assert next_damping(1.0, 1.0, True, False) == DAMPING_FACTOR
