"""The drawing of a sensor: picture, plan and cut, to scale."""

import re
from pathlib import Path

import numpy as np
import pytest
from helpers.command import refused, told
from matplotlib.patches import Polygon

import tacgen
from tacgen.api.simulation import untouched
from tacgen.report import sensor_figure


def test_the_sensor_is_drawn_to_scale() -> None:
    sensor = tacgen.load_sensor("gelsight_wedge")
    frames = untouched("gelsight_wedge")
    picture, plan, cut = sensor_figure.figure(frames.bundle).axes
    assert [panel.get_title() for panel in (picture, plan, cut)] == ["untouched picture", "plan", "cut at y = 0"]
    (shown,) = picture.get_images()
    assert np.asarray(shown.get_array()).shape == (sensor.camera.height_px, sensor.camera.width_px, 3)
    left, right, bottom, top = shown.get_extent()
    assert right - left == pytest.approx(sensor.camera.width_px * sensor.camera.mm_per_px)
    assert bottom > top  # y down
    assert sensor.leds
    lamps = {tuple(np.round(np.array(led.radiance) / max(led.radiance), 6)) for led in sensor.leds}
    filled = [part for part in cut.patches if isinstance(part, Polygon)]
    assert lamps <= {tuple(np.round(part.get_facecolor()[:3], 6)) for part in filled}
    blue = pytest.approx((0x9C / 255, 0xC3 / 255, 0xDC / 255))
    gel = np.concatenate([part.get_xy() for part in filled if part.get_facecolor()[:3] == blue])
    assert (gel[:, 1].min(), gel[:, 1].max()) == pytest.approx((-sensor.gel.thickness_mm, 0.0), abs=1e-6)
    assert np.ptp(gel[:, 0]) == pytest.approx(sensor.gel.width_mm)
    assert sensor.plate
    hole = -(sensor.gel.thickness_mm + sensor.plate.thickness_mm + sensor.camera.distance_mm)
    assert [line.get_ydata()[0] for line in cut.lines if line.get_marker() == "^"] == pytest.approx([hole])
    words, wide = " ".join(text.get_text() for text in cut.texts), sensor.plate.thickness_mm
    assert re.search(rf"{sensor.gel.thickness_mm:g}\s+mm.*plate\s+{wide:g}\s+mm.*camera", words, re.S)


def test_a_gel_without_lamps_has_no_picture() -> None:
    gel = tacgen.load_sensor("gelsight_wedge").gel
    ball, start = tacgen.Sphere(radius_mm=1), tacgen.Start(clearance_mm=1)
    how = {"outputs": "stress", "quality": "draft", "may_miss": True}
    frames = tacgen.simulate(gel, ball, tacgen.Hold(frames=1), start=start, **how)
    assert [panel.get_title() for panel in sensor_figure.figure(frames.bundle).axes] == ["plan", "cut at y = 0"]


def test_the_command_draws_or_says_why_not(tmp_path: Path) -> None:
    out, show = tmp_path / "wedge.png", ("sensor", "show", "gelsight_wedge", "-o")
    assert told(*show, out) == f"{out}\n"
    assert out.stat().st_size > 20_000
    assert "is there already" in refused(*show, out)
    assert refused(*show, tmp_path / "wedge.doc").startswith(".doc: unknown kind of picture, ")
