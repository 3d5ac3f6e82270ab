"""Parts of `calibrate optics`: the search, contact circles, drift of light, and the gain of a gel that scatters."""

import numpy as np
import pytest
from helpers.tiny import cloudy, sensor

from benchmarks.photographs import filled
from tacgen.calibrate import contact_circle, robust_least_squares, scattering_fit, untouched_drift
from tacgen.calibrate.photos import PhotographedPress
from tacgen.calibrate.render_comparison import circle, near
from tacgen.calibrate.robust_least_squares import LinearModel, Ridge
from tacgen.calibrate.scattering_fit import GAIN_THICKNESS_CHANGES_MM, RenderedPress, Renders
from tacgen.optics import scattering
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.hertz_dent import BallDent
from tacgen.render.images import Renderer
from tacgen.sensor.model import ThicknessResponse

U, LIGHTS, SOFT = np.array([0.4, -0.3]), np.array([2.0, 0.7, 0.0]), 15.0


def tables(u: np.ndarray = U, marks: float = 0.0) -> LinearModel:
    """Equations with noise of one count whose solution is u and LIGHTS; a tenth of the pixels is off by `marks`."""
    random = np.random.default_rng(0)
    rows, slopes = random.normal(0, 40, (600, 4)), random.normal(0, 20, (2, 600, 4))
    slopes[:, :, -1] = 0.0
    made = rows[:, :-1] + np.tensordot(u, slopes[..., :-1], 1)
    rows[:, -1] = made @ LIGHTS + random.normal(0, 1, 600)
    rows[::10, -1] += marks
    return LinearModel(np.zeros(2), rows, slopes)


def found(near: LinearModel, weight: float = 1e-3, most: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    ridge = Ridge(weight, np.ones(3), np.ones(3))
    return robust_least_squares.minimise(near, np.ones(3), (np.full(2, -most), np.full(2, most)), ridge, SOFT)


def test_parameters_and_radiances_are_found_together() -> None:
    u, lights = found(tables())
    assert u == pytest.approx(U, abs=0.005)
    assert lights == pytest.approx(LIGHTS, abs=0.005)
    assert lights.min() >= 0


def test_marks_on_a_tenth_of_the_pixels_hardly_matter() -> None:
    marked = tables(marks=300.0)
    u, _ = found(marked)
    assert u == pytest.approx(U, abs=0.04)
    table = np.column_stack([(marked.slopes @ np.append(LIGHTS, -1)).T, marked.rows[:, :-1]])
    squares = np.linalg.lstsq(table, marked.rows[:, -1], rcond=None)[0][:2]  # even with the right radiances
    assert np.abs(u - U).max() < 0.5 * np.abs(squares - U).max()


def test_bounds_and_a_strong_ridge_hold() -> None:
    u, _ = found(tables(), most=0.2)
    assert u == pytest.approx([0.2, -0.2], abs=1e-9)
    u, lights = found(tables(), weight=1e6)
    assert u == pytest.approx(np.zeros(2), abs=1e-3)
    assert lights == pytest.approx(np.ones(3), abs=1e-3)


@pytest.fixture(scope="module")
def made():
    return sensor(camera={"mm_per_px": 0.05, "width_px": 160, "height_px": 128}, markers=None)


@pytest.fixture(scope="module")
def lamps(made):
    """Those of another unit: of other power, and elsewhere."""
    elsewhere = [one.model_copy(update={"center_mm": tuple(np.add(one.center_mm, (0.3, -0.3, 0.2))), "power": power})
                 for one, power in zip(made.leds, (0.7, 1.2, 0.9), strict=False)]  # fmt: skip
    return contact_circle.LampChanges(made.model_copy(update={"leds": tuple(elsewhere)}))


@pytest.fixture(scope="module")
def pictures(made):
    """Untouched, and a ball's press with a known contact circle, with noise."""
    renderer, random = Renderer(made, 16, 0, markers=False), np.random.default_rng(0)
    face = BallDent.seen(PinholeCamera.from_sensor(made), 2.5, (70.0, 66.0), 26.0)
    noise = [random.normal(0, 2, (128, 160, 3)) for _ in range(2)]
    return [renderer.develop(p) + n for p, n in zip((renderer.flat(), renderer.image(face)), noise, strict=True)]


@pytest.mark.parametrize("given", [(70.0, 66.0, 26.0), (72.0, 64.5, 30.0), (68.5, 67.0, 24.5)])
def test_the_circle_is_found_from_one_that_is_drawn_badly(pictures, lamps, given):
    untouched, pressed = pictures
    found = contact_circle.refined(PhotographedPress("p", pressed, 2.5, given[:2], given[2], None), untouched, lamps)
    assert found.center == pytest.approx((70.0, 66.0), abs=0.4)
    assert found.contact == pytest.approx(26.0, rel=0.04)


@pytest.mark.parametrize("start", [(12.0, 10.0), (4.0, 20.0), (20.0, 2.0)])
def test_dots_that_move_do_not_move_the_circle(pictures, lamps, start):
    y, x = np.mgrid[:128, :160]
    dots = [(a, b) for a in np.arange(start[0], 160, 32) for b in np.arange(start[1], 128, 32)]
    painted, hidden = [], np.zeros((128, 160), bool)
    for picture, moved in zip(pictures, (0.0, 3.0), strict=True):
        apart = np.min([np.hypot(x - a - moved, y - b + moved) for a, b in dots], axis=0)
        painted.append(np.where(apart[..., None] < 6, 0.2 * picture, picture))
        hidden |= apart < 8
    untouched, pressed = painted
    press = PhotographedPress("p", untouched + filled(pressed - untouched, hidden), 2.5, (72.0, 64.5), 30.0, None)
    found = contact_circle.refined(press, untouched, lamps, hidden)
    assert found.center == pytest.approx((70.0, 66.0), abs=0.5)
    assert found.contact == pytest.approx(26.0, rel=0.06)


def test_what_shows_no_circle_keeps_its_own(pictures, lamps):
    untouched, pressed = pictures
    solved = PhotographedPress("p", pressed, 2.5, (70.0, 66.0), None, 0.4)
    assert contact_circle.refined(solved, untouched, lamps) is solved
    cut = PhotographedPress("p", pressed, 2.5, (1.0, 2.0), 26.0, None)  # three quarters of it lie outside the picture
    assert contact_circle.refined(cut, untouched, lamps) is cut


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


MM_PER_PX = 0.05


def press(spread: float) -> tuple[RenderedPress, ThicknessResponse]:
    """A dent with a steep rim and a bulge around it; beside the pad there is no gel."""
    y, x = (np.mgrid[:160, :200] - np.array([80, 90])[:, None, None]) * MM_PER_PX
    r = np.hypot(x, y)
    change = np.where(r < 2, 0.35 * r**2 - 1.4, 0.3 * (r - 2) * np.exp(-(r - 2)))
    change[:, :4] = np.nan
    gain = [(1 + 0.2 * c, 1 + 0.3 * c, 1 + 0.4 * c) for c in GAIN_THICKNESS_CHANGES_MM]
    truth = ThicknessResponse(change_mm=GAIN_THICKNESS_CHANGES_MM, gain=tuple(gain), spread_mm=spread, source="test")
    own = np.repeat(1 + 0.05 * np.nan_to_num(change).reshape(-1, 1), 3, axis=1)
    wanted = own * scattering.gains(truth, change, MM_PER_PX).reshape(-1, 3)
    return RenderedPress(change, MM_PER_PX, own, wanted, np.ones(change.size, bool)), truth


@pytest.mark.parametrize("spread", [0.0, 0.2])
def test_gain_and_spread_are_found(spread: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scattering_fit, "DEPTH_FACTORS", (1.0,))
    monkeypatch.setattr(scattering_fit, "GAIN_SPREADS_MM", (0.0, 0.1, 0.2, 0.3))
    seen, truth = press(spread)
    linear, file = np.full((seen.change.size, 3), 0.4), np.ones((len(GAIN_THICKNESS_CHANGES_MM), 3))
    renders = Renders(cloudy(), linear, file, 0.0, [], [[seen]])
    off, found, _ = renders.best([0], 1e-6)
    assert off < 0.2
    assert found.spread_mm == spread
    there = [k for k, change in enumerate(GAIN_THICKNESS_CHANGES_MM) if -1.3 < change < 0.1]
    assert np.array(found.gain)[there] == pytest.approx(np.array(truth.gain)[there], abs=0.01)
    assert found.gain[GAIN_THICKNESS_CHANGES_MM.index(0.0)] == (1.0, 1.0, 1.0)


def test_a_gain_that_spreads_turns_a_step_into_a_slope_and_keeps_its_mean() -> None:
    step = np.where(np.arange(80)[None, :] < 40, -1.0, 0.0).repeat(3, axis=0)
    table = {"change_mm": (-1.0, 0.0), "gain": ((0.5,) * 3, (1.0,) * 3), "source": "test"}
    sharp, soft = (
        scattering.gains(ThicknessResponse(**table, spread_mm=s), step, MM_PER_PX)[1, :, 0] for s in (0.0, 0.2)
    )
    assert set(np.round(sharp, 6)) == {0.5, 1.0}
    assert soft.mean() == pytest.approx(sharp.mean(), abs=1e-9)
    at = np.interp([0.5 + 0.5 * 0.158655, 0.5 + 0.5 * 0.841345], soft, np.arange(80))
    assert np.diff(at)[0] * MM_PER_PX == pytest.approx(2 * 0.2, rel=0.03)  # one standard deviation to each side
