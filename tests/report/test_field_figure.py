"""Pictures of one field: what is drawn where, with its unit; and the cut through the gel."""

from pathlib import Path

import numpy as np
import pytest
from helpers.synthetic import write
from typer.testing import CliRunner

from tacgen import cli
from tacgen.bundle.bundle import read
from tacgen.errors import UserError
from tacgen.fem.elements import HEX_CORNERS
from tacgen.report import field_figure
from tacgen.report.plane_cut import cut, outline

Array = np.ndarray


@pytest.mark.parametrize(
    ("field", "bars"),
    [
        ("pressure", ["pressure [MPa]"]),
        ("traction", ["traction [MPa]"]),
        ("slip", [""]),
        ("stress", ["σ_zz [MPa]", "σ_xz [MPa]", "von Mises [MPa]"]),
    ],
)
def test_a_field_is_drawn_with_its_unit(tmp_path: Path, field: str, bars: list[str]) -> None:
    bundle, out = write(tmp_path / "x.h5"), tmp_path / "x.png"
    done = CliRunner().invoke(cli.app, ["show", str(bundle), "--field", field, "-o", str(out)])
    assert done.exit_code == 0, done.output
    assert out.stat().st_size > 5000
    drawn = field_figure.figure(read(bundle), field)
    rows = len(bars)
    panels, found = drawn.axes[: 4 * rows], drawn.axes[4 * rows :]
    assert [bar.get_ylabel() for bar in found] == bars
    assert panels[0].get_title() == "frame 0 press"
    assert any("z out of the gel" in text.get_text() for text in drawn.texts)
    if field == "slip":
        assert [label.get_text() for label in found[0].get_yticklabels()] == ["free", "edge", "stick", "slip"]
    low, high = panels[0].get_ylim()
    assert (low < high) == (field == "stress")  # z rises, y falls


def test_what_cannot_be_drawn_is_told_in_a_line(tmp_path: Path) -> None:
    bare = write(tmp_path / "x.h5", outputs=frozenset({"force"}))
    for args, words in (
        (("--field", "heat", "-o", "x.png"), "heat: unknown field, use one of pressure, traction, slip, stress"),
        (("--field", "stress", "-o", "x.png"), "has no /fields/cauchy_stress: the recipe's outputs need stress"),
        (("--field", "slip", "-o", "x.png"), "the recipe's outputs need traction"),
        (("--field", "slip"), "--field: draws a picture, and needs --out"),
    ):
        done = CliRunner().invoke(cli.app, ["show", str(bare), *args])
        assert done.exit_code == 2
        assert words in done.stderr
    with pytest.raises(UserError, match="unknown kind of picture"):
        field_figure.picture(write(tmp_path / "y.h5"), "slip", tmp_path / "y.doc")


def area(corners: Array) -> float:
    side = corners[:, 1:] - corners[:, :1]
    return float(np.abs(np.linalg.det(side)).sum() / 2)


@pytest.mark.parametrize("y", [-0.93, -0.2, 0.41])
def test_a_cut_is_whole_and_interpolates(y: float) -> None:
    points = HEX_CORNERS + 0.15 * np.random.default_rng(0).uniform(-1, 1, (8, 3)) * [1, 0, 1]
    slope = np.array([[2.0], [-1.0], [0.5]])
    corners, values = cut(points, np.arange(8)[None], points @ slope, y)
    at = np.stack([corners[..., 0], np.full(corners.shape[:2], y), corners[..., 1]], -1)
    assert values == pytest.approx(at @ slope)
    rim = outline(corners)
    total = np.linalg.norm(rim[:, 1] - rim[:, 0], axis=1).sum()
    assert area(corners) == pytest.approx(_polygon(points, y), rel=0.02)
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
