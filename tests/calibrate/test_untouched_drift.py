"""Drift between the photographs of an untouched sensor and of presses."""

import numpy as np
import pytest

from tacgen.calibrate import untouched_drift
from tacgen.calibrate.photos import PhotographedPress
from tacgen.calibrate.render_comparison import circle, near

SHAPE, RADIUS = (90, 120), 10.0
CENTERS = ((25.0, 30.0), (95.0, 60.0), (60.0, 20.0))
SHADES = ((3.0, 0.0, -1.0), (-3.0, 0.0, 0.0), (0.0, 0.0, 1.0))  # of each picture, mean 0 [counts]


def pressed(reach: float) -> tuple[np.ndarray, list[np.ndarray], list[PhotographedPress]]:
    """An untouched photograph, drifts, and presses that are bright within `reach` contact radii."""
    untouched, (y, x) = np.full((*SHAPE, 3), 90, np.uint8), np.mgrid[: SHAPE[0], : SHAPE[1]]
    streak = 12 * np.exp(-((x - 70) ** 2) / 200.0) + y / 30  # crosses two presses
    drifts = [streak[..., None] + np.array(shade) for shade in SHADES]
    presses = []
    for drift, center in zip(drifts, CENTERS, strict=True):
        lit = 100.0 * circle(SHAPE, center, reach * RADIUS)[..., None]
        picture = np.round(untouched + drift + lit).astype(np.uint8)
        presses.append(PhotographedPress("", picture, 3.0, center, RADIUS, None))
    return untouched, drifts, presses


def test_streaks_and_shades_are_found_inside_of_contacts_too() -> None:
    untouched, drifts, presses = pressed(2.5)
    found = untouched_drift.changes(presses, untouched)
    assert found == pytest.approx(np.array(drifts), abs=1.0)
    for press, one in zip(presses, untouched_drift.removed(presses, untouched), strict=True):
        change = one.picture - untouched.astype(float)
        assert change[near(press, 1.0)] == pytest.approx(100.0, abs=1.5)
        assert change[~near(press, 2.7)] == pytest.approx(0.0, abs=1.5)
        assert (one.center, one.contact) == (press.center, press.contact)


def test_presses_that_fill_the_picture_keep_it() -> None:
    untouched, _, presses = pressed(2.5)
    wide = [PhotographedPress("", one.picture, 3.0, one.center, 80.0, None) for one in presses]
    for press, one in zip(wide, untouched_drift.removed(wide, untouched), strict=True):
        assert np.array_equal(one.picture, press.picture)


def test_of_one_press_nothing_is_known_where_it_is() -> None:
    """But the mean of what has changed elsewhere."""
    untouched, _, presses = pressed(2.5)
    (found,) = untouched_drift.changes(presses[:1], untouched)
    away = np.round(presses[0].picture - untouched.astype(float))[~near(presses[0], 2.7)].mean(axis=0)
    inside = near(presses[0], 1.5)
    assert found[inside] == pytest.approx(np.tile(away, (inside.sum(), 1)), abs=1.0)
