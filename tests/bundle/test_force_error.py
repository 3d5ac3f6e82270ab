"""Forces are printed with their expected error: by the recipe's uncertainty, else by the mesh."""

from pathlib import Path

import numpy as np
import pytest
from helpers.command import told
from helpers.synthetic import write

import tacgen
from tacgen.bundle.bundle import read
from tacgen.bundle.force_error import ERROR_BY_MESH, STD_BY_UNCERTAINTY, force_error
from tacgen.mechanics.expected_error import expected_force_error
from tacgen.mechanics.face_overlap import Overlap


@pytest.fixture(scope="module")
def frames() -> tacgen.Frames:
    press = tacgen.Press(depth_mm=0.5, frames=2)
    return tacgen.simulate("gelsight_mini", tacgen.Sphere(radius_mm=4), press, quality={"edge_mm": 1.2, "dhat_mm": 0.1})


def test_a_scene_has_the_error_that_its_mesh_gives(frames: tacgen.Frames, tmp_path: Path) -> None:
    relative = frames["/frames/quality/expected_force_error"]
    width = np.sqrt(2 * 4 * np.array([0.25, 0.5]))
    expected = [expected_force_error(1.2, Overlap(np.pi * w**2, 2 * np.pi * w), 4.0) for w in width]
    assert relative == pytest.approx(expected, rel=0.03)
    assert frames.force_error == pytest.approx(relative * np.linalg.norm(frames.force, axis=1))
    path = frames.save(tmp_path / "scene.h5")
    said = told("show", path)
    assert f"N on the gel, \N{PLUS-MINUS SIGN} about {frames.force_error[1]:.1g} N ({ERROR_BY_MESH})" in said
    page = tmp_path / "view.html"
    told("view", path, "-o", page)
    assert f"\\u00b1 about {frames.force_error[1]:.1g} N" in page.read_text()


def test_the_uncertainty_that_was_asked_for_comes_first() -> None:
    both = {"/frames/uncertainty/force": np.array([[0.3, 0.0, 0.4]]), "/frames/force": np.array([[0.0, 0.0, -1.0]])}
    error = force_error(both | {"/frames/quality/expected_force_error": np.array([0.01])})  # type: ignore[arg-type]
    assert error is not None
    assert error.kind == STD_BY_UNCERTAINTY
    assert error.newton == pytest.approx(0.5)
    assert error.text(0) == "\N{PLUS-MINUS SIGN} about 0.5 N"


def test_an_earlier_bundle_has_none(tmp_path: Path) -> None:
    path = write(tmp_path / "scene.h5")
    assert force_error(read(path)) is None
    assert np.isnan(tacgen.read(path).force_error).all()


def test_validate_tells_it_before_the_run() -> None:
    said = told("validate", "quickstart")
    assert "note: expected error of the force by the mesh: about 1 %, within a factor of 2 (edges of 0.36 mm" in said
    assert "about 4 %" in told("validate", "quickstart", "--set", "quality=draft")
    press = "trajectory=[{press: {force_n: 1, frames: 1}}]"
    assert "expected error" not in told("validate", "quickstart", "--set", press), "the depth is not known yet"
