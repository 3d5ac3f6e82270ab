"""A photograph of one's own unit behind the pictures: photo x (deformed / flat), and told when it cannot be."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tacgen import bundle, photo, pipeline, plan
from tacgen.errors import UserError
from tacgen.optics import response

RECIPE = """
tacgen: 1
name: own
sensor: gelsight_mini
sensor_overrides: {camera.width_px: 64, camera.height_px: 48, camera.mm_per_px: 0.317}
indenter: {shape: sphere, radius_mm: 4.0}
trajectory: [press: {depth_mm: 0.4, frames: 1}]
outputs: [rgb]
render: {noise: false, background: mine.png}
quality: {edge_mm: 1.0, dhat_mm: 0.1, spp: 4}
"""


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    (tmp_path / "own.yaml").write_text(RECIPE)
    seen = np.random.default_rng(0).integers(40, 160, (48, 64, 3)).astype(np.uint8)
    Image.fromarray(seen).save(tmp_path / "mine.png")
    return tmp_path / "own.yaml"


def test_the_change_is_rendered_and_the_rest_is_the_photograph(recipe: Path) -> None:
    made, plain = (
        bundle.read(pipeline.run_scene(plan.load(recipe, sets).rows[0], recipe.parent / name).path)
        for name, sets in (("own", ()), ("plain", ("render.background=null",)))
    )
    mine = photo.read(recipe.parent / "mine.png")
    assert np.array_equal(made["/reference/rgb"], mine)
    assert made.recipe["render"]["background_sha256"]
    flat, deformed = (response.linear(plain[p] / 255.0) for p in ("/reference/rgb", "/frames/rgb"))
    wanted = 255 * response.srgb(response.linear(mine / 255.0) * deformed[0] / np.maximum(flat, 1e-4))
    bright = (plain["/reference/rgb"] > 50).all(-1)  # where rounding plain pictures to 8 bit does not show
    error = np.abs(made["/frames/rgb"][0] - wanted)[bright]
    assert error.max() < 4
    assert error.mean() < 0.8
    assert np.abs(made["/frames/rgb"][0].astype(int) - mine).max() > 10


def test_another_photograph_is_another_scene(recipe: Path) -> None:
    before = plan.load(recipe).rows[0].key
    assert plan.load(recipe).rows[0].key == before
    Image.new("RGB", (64, 48), (90, 90, 90)).save(recipe.parent / "mine.png")
    assert plan.load(recipe).rows[0].key != before


@pytest.mark.parametrize(
    ("make", "sets", "says"),
    [
        (lambda p: p.unlink(), (), "mine.png: cannot be read: No such file"),
        (lambda p: p.write_text("no picture"), (), "mine.png: is no picture that can be read"),
        (lambda p: p.write_bytes(p.read_bytes()[:2000]), (), "mine.png: is no picture that can be read"),
        (lambda p: Image.new("RGB", (64, 47)).save(p), (), "is 64 x 47, and the camera's pictures are 64 x 48"),
        (lambda p: None, ("outputs=[force]",), "has no effect"),
        (lambda p: None, (f"render.background_sha256={'f' * 64}",), "is another file now"),
    ],
)
def test_what_cannot_be_is_told_in_one_line(recipe: Path, make, sets: tuple[str, ...], says: str) -> None:
    make(recipe.parent / "mine.png")
    with pytest.raises(UserError) as told:
        plan.load(recipe, sets)
    (line,) = [line for line in told.value.lines if not line.startswith(" ")]
    assert says in line
    assert "render.background" in line
