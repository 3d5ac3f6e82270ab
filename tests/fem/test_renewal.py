"""What is lagged settles where taking it as it comes would not, and takes no detour where it would."""

import numpy as np
import pytest

from tacgen.fem.renewal import Renewal

Array = np.ndarray
WANTED = np.array([[10.0, 11.0], [12.0, 9.0]])


def errors(keeps: Array, count: int = 30, between: bool = False) -> list[float]:
    """Errors of forces of which each renewal keeps a linear part."""
    renewal, lagged, found = Renewal(), WANTED + np.array([[1, -2], [0.5, 1.5]]), list[float]()
    for _ in range(count):
        force = WANTED + (keeps @ (lagged - WANTED).ravel()).reshape(2, 2)
        found.append(float(np.abs(force - lagged).max()))
        x, lagged = renewal.next(force / 2, force, lagged, between)
        assert x == pytest.approx(lagged / 2)
    return found


def turning(angle: float, size: float) -> Array:
    """Errors turn by an angle, in two planes, and grow to `size` of themselves."""
    c, s = size * np.cos(angle), size * np.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    return np.block([[turn, np.zeros((2, 2))], [np.zeros((2, 2)), turn / 2]])


@pytest.mark.parametrize("keeps", [-1.2 * np.eye(4), turning(1.0, 1.1), turning(3.0, 0.97), 0.8 * np.eye(4)])
def test_what_circles_grows_or_creeps_settles(keeps: Array) -> None:
    assert errors(keeps)[-1] < 1e-4


def test_what_settles_by_itself_is_taken_as_it_comes() -> None:
    found = errors(0.6 * np.eye(4), 10)
    assert found == pytest.approx([found[0] * 0.6**k for k in range(10)])


def test_between_known_places_a_swing_settles_and_what_creeps_is_not_run_ahead_of() -> None:
    assert errors(-1.2 * np.eye(4), between=True)[-1] < 1e-4
    creeping = errors(0.9 * np.eye(4), 20, between=True)
    assert creeping == pytest.approx([creeping[0] * 0.9**k for k in range(20)])


def test_between_known_places_errors_of_another_kind_are_not_mixed() -> None:
    """They grow, but turn aside rather than back: halving them led meshes astray."""
    renewal, first, aside = Renewal(), np.array([[1, 0], [0, 0]]), np.array([[-0.5, 1], [0, 0]])
    renewal.next(WANTED, WANTED + first, WANTED)
    x, force = renewal.next(WANTED, WANTED + aside, WANTED, between=True)
    assert force == pytest.approx(WANTED + aside)
    assert x is WANTED
