"""What is lagged settles where taking it as it comes would not, and takes no detour where it would."""

import numpy as np
import pytest

from tacgen.mechanics.mesh_contact import Lag

Array = np.ndarray
WANTED = np.array([[10.0, 11.0], [12.0, 9.0]])


def errors(keeps: Array, count: int = 30) -> list[float]:
    """Errors of forces of which each renewal keeps a linear part."""
    lag, lagged, found = Lag(), WANTED + np.array([[1, -2], [0.5, 1.5]]), list[float]()
    for _ in range(count):
        force = WANTED + (keeps @ (lagged - WANTED).ravel()).reshape(2, 2)
        found.append(float(np.abs(force - lagged).max()))
        x, lagged = lag.next(force / 2, force, lagged)
        assert x == pytest.approx(lagged / 2)
    return found


def test_a_swing_that_grows_settles() -> None:
    assert errors(-1.2 * np.eye(4))[-1] < 1e-4


def test_what_settles_or_creeps_is_taken_as_it_comes() -> None:
    for part in (0.6, 0.9):
        found = errors(part * np.eye(4), 20)
        assert found == pytest.approx([found[0] * part**k for k in range(20)])


def test_errors_of_another_kind_are_not_mixed() -> None:
    """They grow, but turn aside rather than back: halving them led meshes astray."""
    lag, first, aside = Lag(), np.array([[1, 0], [0, 0]]), np.array([[-0.5, 1], [0, 0]])
    lag.next(WANTED, WANTED + first, WANTED)
    x, force = lag.next(WANTED, WANTED + aside, WANTED)
    assert force == pytest.approx(WANTED + aside)
    assert x is WANTED


def test_the_mixture_lies_between_the_last_two_and_pushes() -> None:
    lag = Lag()
    lag.next(np.zeros(2), np.array([4.0, -1.0]), np.array([2.0, 1.0]))  # off by 2, -2
    x, force = lag.next(np.ones(2), np.array([1.0, -0.5]), np.array([2.0, -1.5]))  # and by -1, 1
    assert x == pytest.approx([2 / 3, 2 / 3])
    assert force == pytest.approx([2.0, 0.0])  # no force pulls
    lag.next(np.zeros(1), np.array([1.0]), np.array([0.0]))
