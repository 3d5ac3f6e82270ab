"""When a step of the bulk ends Newton's method, and how much the next one is damped."""

import pytest

from tacgen.mechanics.bulk_newton import next_damping, settles
from tacgen.mechanics.condensation import DAMPING_FACTOR, LEAST_DAMPING
from tacgen.mechanics.options import DEFAULT

TOLERANCE, HALF = DEFAULT.residual_tol, DEFAULT.residual_max / 2


@pytest.mark.parametrize(
    ("residual", "damping", "still", "converged", "rests", "expected"),
    [
        (0.9 * TOLERANCE, 0.0, False, True, False, True),
        (0.9 * TOLERANCE, 0.1, False, True, False, True),
        (0.9 * TOLERANCE, 0.0, True, False, False, False),  # contact stalled
        (0.9 * HALF, 0.0, False, True, False, False),
        (0.9 * HALF, 0.0, True, True, False, True),
        (0.9 * HALF, 0.1, True, True, False, False),
        (0.9 * HALF, 0.0, False, False, True, True),  # contact goes in circles
        (0.9 * HALF, 0.1, False, False, True, False),
        (1.1 * HALF, 0.0, True, False, True, False),
    ],
)
def test_a_step_settles(
    residual: float, damping: float, still: bool, converged: bool, rests: bool, expected: bool
) -> None:
    assert settles(DEFAULT, residual, damping, still, converged, rests) is expected


def test_damping_follows_the_steps() -> None:
    assert next_damping(0.0, 1.0, False, True) == 0
    assert next_damping(1.0, 1.0, False, False) == 1 / DAMPING_FACTOR
    assert next_damping(LEAST_DAMPING, 1.0, False, True) == 0
    assert next_damping(1.0, 0.5, False, True) == 1.0
    assert next_damping(1.0, 1.0, True, True) == 1.0
    assert next_damping(0.0, 1.0, True, False) == LEAST_DAMPING
    assert next_damping(1.0, 1.0, True, False) == DAMPING_FACTOR
