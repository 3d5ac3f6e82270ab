"""The gain by thickness of a gel that scatters, and how far it spreads, from pictures made with a known one."""

import numpy as np
import pytest
from helpers.tiny import cloudy

from tacgen.calibrate import scattering_fit
from tacgen.calibrate.scattering_fit import GAIN_THICKNESS_CHANGES_MM, RenderedPress, Renders
from tacgen.optics import scattering
from tacgen.sensor.model import ThicknessResponse

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
