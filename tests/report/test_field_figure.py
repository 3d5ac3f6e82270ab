"""Pictures of one field and of a sensor: what is drawn where, with its unit; and the cut through the gel."""

import re
from pathlib import Path

import numpy as np
import pytest
from helpers.command import refused, told
from helpers.synthetic import write
from matplotlib.collections import LineCollection
from matplotlib.patches import Polygon

import tacgen
from tacgen.api.simulation import untouched
from tacgen.bundle.bundle import read
from tacgen.fem.elements import HEX_CORNERS
from tacgen.report import field_figure, sensor_figure
from tacgen.report.plane_cut import crossed, cut, outline

Array = np.ndarray


@pytest.mark.parametrize(
    ("field", "bars"),
    [
        ("pressure", ["pressure [MPa]"]),
        ("traction", ["traction [MPa]"]),
        ("slip", [""]),
        ("stress", ["$σ_{zz}$ [MPa]", "$σ_{xz}$ [MPa]", "von Mises [MPa]"]),
    ],
)
def test_a_field_is_drawn_with_its_unit(tmp_path: Path, field: str, bars: list[str]) -> None:
    bundle, out = write(tmp_path / "x.h5"), tmp_path / "x.png"
    told("show", bundle, "--field", field, "-o", out)
    assert out.stat().st_size > 5000
    drawn = field_figure.figure(read(bundle), field)
    rows = len(bars)
    panels, found = drawn.axes[: 4 * rows], drawn.axes[4 * rows :]
    assert [bar.get_ylabel() for bar in found] == bars
    assert panels[0].get_title() == "frame 0 press"
    for panel in panels[-4:]:
        assert panel.get_xlabel() in ("x [px]", "x [mm]")
        assert panel.xaxis.get_tick_params()["labelbottom"]
    assert any("z out of the gel" in text.get_text().replace("\n", " ") for text in drawn.texts)
    if field == "slip":
        assert [label.get_text() for label in found[0].get_yticklabels()] == ["free", "edge", "stick", "slip"]
    low, high = panels[0].get_ylim()
    assert (low < high) == (field == "stress")  # z rises, y falls


def test_a_section_shows_the_indenter_and_stress_without_steps(tmp_path: Path) -> None:
    drawn = field_figure.figure(read(write(tmp_path / "x.h5")), "stress")
    (smooth,) = (c for c in drawn.axes[3].collections if type(c).__name__ == "TriMesh")
    assert smooth.get_array().shape == (len(smooth._triangulation.x),)  # a colour a corner, and none a cell
    lines = [np.concatenate(c.get_segments()) for c in drawn.axes[3].collections if isinstance(c, LineCollection)]
    pose = read(tmp_path / "x.h5")["/frames/pose"][-1]
    out = lines[-1] - pose[[0, 2], 3]
    assert len(out) > 100
    assert np.hypot(*(out[out[:, 1] < 1] - [0, 4]).T) == pytest.approx(4.0, abs=0.03)  # the ball, from its lowest point


def test_rounding_errors_of_stress_have_no_colour(tmp_path: Path) -> None:
    from matplotlib.figure import Figure

    bundle, panel = read(write(tmp_path / "x.h5")), Figure().add_subplot()
    rounding = ("rounding", lambda s: 1e-15 * np.arange(len(s)) / len(s), "magma", False)
    [(drawn, _, _)] = field_figure.draw_stress(bundle, [[panel]], np.array([0]), (24, 32), (rounding,))
    assert drawn.get_clim() == (0, 1e-6)


def test_a_triangle_mesh_crosses_a_plane_in_lines() -> None:
    points = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 4.0]])
    triangles = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    found = crossed(points, triangles, 1.5)
    assert np.unique(found.reshape(-1, 2).round(9), axis=0) == pytest.approx(np.array([[0, 0], [0, 2], [1, 0]]))
    assert len(found) == 3
    assert crossed(points, triangles, 3.5).shape == (0, 2, 2)


def test_what_cannot_be_drawn_is_reported_in_one_line(tmp_path: Path) -> None:
    bare = write(tmp_path / "x.h5", outputs=frozenset({"force"}))
    for args, words in (
        ("hight -o x.png", "hight: unknown field, did you mean height?; there are: camera, markers, pressure"),
        ("stress -o x.png", "has no /fields/cauchy_stress: the recipe's outputs need stress"),
        ("slip -o x.png", "the recipe's outputs need traction"),
        ("slip", "--field: draws a picture, and needs --out"),
    ):
        assert words in refused("show", bare, "--field", *args.split())
    said = refused("show", write(tmp_path / "y.h5"), "--field", "slip", "-o", "y.doc")
    assert "unknown kind of picture" in said


@pytest.mark.parametrize("y", [-0.93, -0.2, 0.41])
def test_a_cut_is_whole_and_interpolates(y: float) -> None:
    points = HEX_CORNERS + 0.15 * np.random.default_rng(0).uniform(-1, 1, (8, 3)) * [1, 0, 1]
    slope = np.array([[2.0], [-1.0], [0.5]])
    corners, values = cut(points, np.arange(8)[None], points @ slope, y)
    at = np.stack([corners[..., 0], np.full(corners.shape[:2], y), corners[..., 1]], -1)
    assert values == pytest.approx(at @ slope)
    rim = outline(corners)
    total = np.linalg.norm(rim[:, 1] - rim[:, 0], axis=1).sum()
    area = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 2
    assert area == pytest.approx(_polygon(points, y), rel=0.02)
    assert 6 < total < 10  # around a square of side 2, and nothing inside it


def _polygon(points: Array, y: float) -> float:
    """Area of the cut of a hex whose edges along y are straight."""
    pairs = [(0, 3), (1, 2), (5, 6), (4, 7)]
    ends = np.array([points[a] + (y + 1) / 2 * (points[b] - points[a]) for a, b in pairs])
    x, z = ends[:, 0], ends[:, 2]
    return float(abs(x @ np.roll(z, -1) - z @ np.roll(x, -1)) / 2)


def test_a_cut_beside_the_mesh_is_empty() -> None:
    corners, values = cut(HEX_CORNERS, np.arange(8)[None], HEX_CORNERS, 3.0)
    assert corners.shape == (0, 3, 2)
    assert values.shape == (0, 3, 3)


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
