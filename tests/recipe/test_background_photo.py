"""A photograph of one's own unit behind the pictures: photo x (deformed / flat), and told when it cannot be."""

from pathlib import Path

import numpy as np
import pytest
from helpers.small_recipe import PICTURE
from helpers.tiny import sensor
from PIL import Image

from tacgen.base.errors import UserError
from tacgen.batch import pipeline
from tacgen.bundle import bundle
from tacgen.optics import camera_response
from tacgen.recipe import plan
from tacgen.render.pictures import Backdrop

RECIPE = f"{PICTURE.replace('noise: false', 'noise: false, background: mine.png')}outputs: [rgb]\n"


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    (tmp_path / "own.yaml").write_text(RECIPE)
    seen = np.random.default_rng(0).integers(40, 160, (48, 64, 3)).astype(np.uint8)
    Image.fromarray(seen).save(tmp_path / "mine.png")
    return tmp_path / "own.yaml"


SMALL = {  # a sensor's picture, shrunk
    "gelsight_mini": (64, 48, 0.317),
    "digit": (48, 64, 0.252),
    "ninedtact": (46, 35, 0.509),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensor", "method"),
    [("gelsight_mini", "path"), ("digit", "transport"), ("digit", "path"), ("ninedtact", "transport")],
)
def test_photograph_and_noise_on_every_sensor(
    sensor: str, method: str, recipe: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TACGEN_CACHE_DIR", str(recipe.parent / "cache"))
    width, height, scale = SMALL[sensor]
    mine = np.random.default_rng(1).integers(60, 140, (height, width, 3)).astype(np.uint8)
    Image.fromarray(mine).save(recipe.parent / "mine.png")
    camera = f"{{camera.width_px: {width}, camera.height_px: {height}, camera.mm_per_px: {scale}}}"
    sets = (f"sensor={sensor}", f"sensor_overrides={camera}", f"render.method={method}", "quality.spp=2")

    def made(name: str, *more: str) -> bundle.Bundle:
        return bundle.read(pipeline.run_scene(plan.load(recipe, (*sets, *more)).rows[0], recipe.parent / name).path)

    over, grainy = made("over"), made("grainy", "render.noise=true")
    assert np.array_equal(over["/reference/rgb"], mine)  # also where few paths found no light
    changed = np.abs(over["/frames/rgb"][0].astype(int) - mine).max(-1)
    assert changed.max() > 8
    if method == "transport":
        assert np.median(changed) <= 2  # the press is small, and elsewhere it is the photograph
    grain = grainy["/frames/rgb"][0].astype(float) - over["/frames/rgb"][0]
    assert np.array_equal(grainy["/reference/rgb"], mine)
    low, high = (0.3, 0.8) if sensor == "ninedtact" else (0.8, 5)
    assert low < grain[(over["/frames/rgb"][0] > 40).all(-1)].std() < high


def test_the_change_is_laid_over_the_photograph_which_stands_alone_beside_the_gel(tmp_path: Path) -> None:
    camera = sensor().camera
    light = np.full((32, 40, 3), 0.5)
    light[:, :5] = 0.0
    mine = np.random.default_rng(2).integers(20, 200, (32, 40, 3)).astype(np.uint8)
    Image.fromarray(mine).save(tmp_path / "mine.png")
    behind = Backdrop(tmp_path / "mine.png", light, camera)
    assert np.array_equal(camera_response.develop(behind.under(light), camera), mine)
    assert np.array_equal(camera_response.develop(behind.under(2 * light), camera)[:, :5], mine[:, :5])
    assert behind.under(2 * light)[:, 5:] == pytest.approx(2 * behind.under(light)[:, 5:]), "elsewhere it is changed"


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
def test_the_impossible_is_reported_in_one_line(recipe: Path, make, sets: tuple[str, ...], says: str) -> None:
    make(recipe.parent / "mine.png")
    with pytest.raises(UserError) as told:
        plan.load(recipe, sets)
    (line,) = [line for line in told.value.lines if not line.startswith(" ")]
    assert says in line
    assert "render.background" in line
