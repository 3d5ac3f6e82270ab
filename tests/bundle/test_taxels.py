"""Forces by taxel add up to the force, whatever the layout; wrenches tell the same in every frame."""

from pathlib import Path

import numpy as np
import pytest
from helpers import small_recipe

from tacgen.base.errors import UserError
from tacgen.batch import pipeline
from tacgen.bundle import taxels
from tacgen.bundle.bundle import Bundle, read
from tacgen.bundle.postprocess import wrench
from tacgen.geometry.pose import about

LAYOUTS = {
    "grid": taxels.grid(4, 4, 4.0),
    "one": np.zeros((1, 2)),
    "odd": np.array([[3.0, 1.0], [-2.0, 5.0], [0.1, 0.2]]),
}


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Bundle:
    """A ball pressed beside the middle, and dragged."""
    sets = "outputs=[force, force_map]", "start={x_mm: 4.1, y_mm: -2.0}", "contact.friction=0.6"
    row = small_recipe.row("press: {depth_mm: 0.8, frames: 1}, slide: {x_mm: 0.4, frames: 1}", *sets)
    return read(pipeline.run_scene(row, tmp_path_factory.mktemp("taxels")).path)


@pytest.mark.parametrize("name", LAYOUTS)
def test_taxels_add_up_to_the_wrench(scene: Bundle, name: str) -> None:
    for frame in range(scene.frames):
        found = taxels.forces(scene, frame, LAYOUTS[name])
        assert found.shape == (len(LAYOUTS[name]), 3)
        assert found.sum(0) == pytest.approx(wrench(scene)[frame, :3], rel=1e-5, abs=1e-6)


def test_a_taxel_feels_what_is_above_it(scene: Bundle) -> None:
    """Nearly all of it where the taxels are far apart, and the moments of many small ones are those of the force."""
    far = np.array([[4.1, -2.0], [-6.0, 5.0]])
    assert taxels.forces(scene, 0, far)[0] == pytest.approx(scene.frame("/frames/force", 0), rel=1e-5, abs=1e-6)
    fine = taxels.grid(40, 40, 0.5)
    normal = taxels.forces(scene, 0, fine)[:, 2]
    assert normal @ fine / normal.sum() == pytest.approx([4.1, -2.0], abs=0.15)
    transposed = taxels.grid(2, 3, 2.0, (1.0, 0.0))
    assert transposed.tolist() == [[-1, -1], [1, -1], [3, -1], [-1, 1], [1, 1], [3, 1]]


def test_layouts_are_read_and_what_is_none_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "layout.csv"
    path.write_text("name,y_mm,x_mm\na,1,2\nb,-1,0.5\n")
    assert taxels.read(path).tolist() == [[2, 1], [0.5, -1]]
    for text, says in (
        ("x_mm,y_mm\n", "csv: must hold"),
        ("x,y\n1,2\n", "has no column x_mm, y_mm"),
        ("x_mm,y_mm\n1,nan\n", "csv:2: x_mm and y_mm must be numbers"),
        ("x_mm,y_mm\n1,2\n1,a\n", "csv:3: x_mm and y_mm must be numbers"),
        ("x_mm,y_mm\n1\n", "csv:2: has 1 cells, and the header 2"),
        ("x_mm,y_mm\n0,5,1\n", "csv:2: has 3 cells, and the header 2"),
    ):
        path.write_text(text)
        with pytest.raises(UserError, match=says):
            taxels.read(path)
    with pytest.raises(UserError, match="cannot be read"):
        taxels.read(tmp_path / "none.csv")


def test_wrenches_in_two_frames_do_the_same_work(scene: Bundle) -> None:
    """Whatever rigid motion: that is what makes them one wrench."""
    rng = np.random.default_rng(0)
    still = np.eye(4)
    still[:3, :3], still[:3, 3] = about(np.array([0.6, 0.0, 0.8]), 1.1), (5.0, -3.0, 20.0)
    for pose in (still, scene["/frames/pose"]):
        each = np.broadcast_to(pose, (scene.frames, 4, 4))
        turn, at = each[:, :3, :3], each[:, :3, 3]
        v, w = rng.normal(size=(2, scene.frames, 3))  # of the sensor's origin
        there = v + np.cross(w, at)
        motion = np.hstack([np.einsum("nji,nj->ni", turn, part) for part in (there, w)])
        power = (wrench(scene) * np.hstack([v, w])).sum(1)
        assert (wrench(scene, pose) * motion).sum(1) == pytest.approx(power, rel=1e-9)
        size = np.linalg.norm(scene["/frames/force"], axis=1)
        assert np.linalg.norm(wrench(scene, pose)[:, :3], axis=1) == pytest.approx(size)
