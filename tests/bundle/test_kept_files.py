"""A bundle holds the object and the poses of its scene: it is drawn and made again where their files are gone."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from helpers import small_recipe
from helpers.synthetic import attributes

import tacgen
from tacgen.api.simulation import _tree
from tacgen.batch import pipeline
from tacgen.bundle import kept_files
from tacgen.bundle.bundle import Writer, read
from tacgen.bundle.caption import caption, indenter_text
from tacgen.bundle.check import check
from tacgen.recipe import assets, plan
from tacgen.recipe.row import Row
from tacgen.report.field_figure import indenter_surface

COARSE = {"edge_mm": 1.0, "dhat_mm": 0.1}
MESH = "/files/indenter.file"


def read_again(recipe: dict[str, Any]) -> Sequence[Row]:
    return plan.load(_tree(recipe, "recipe", {})).rows


def test_a_scene_of_a_trimesh_along_an_array_of_poses_is_made_again(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=3.0)
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, 2, 3] = 0.1, -0.3
    frames = tacgen.simulate("gelsight_mini", ball, poses, outputs="force", quality=COARSE)
    kept = frames.save(tmp_path / "kept.h5")
    del frames
    frames = tacgen.read(kept)
    (made,) = pipeline.run(read_again(dict(frames.recipe)), tmp_path / "out")  # as tacgen.run, in this process
    assert made.path.read_bytes() == kept.read_bytes()
    assert frames.recipe["indenter"]["file"].endswith("/sphere.stl")
    assert repr(frames) == "Frames(kept.h5: 2 frames, sphere, on gelsight_mini)"
    assert check(kept) == []


def test_a_scene_on_a_sensor_made_in_python_is_made_again_on_it() -> None:
    soft = tacgen.load_sensor("gelsight_mini")
    layer = soft.gel.layers[0].model_copy(update={"youngs_modulus_mpa": 0.15})
    soft = soft.model_copy(update={"gel": soft.gel.model_copy(update={"layers": (layer,)})})
    press = tacgen.Press(depth_mm=0.3, frames=1)
    for given in (soft, soft.gel, "gelsight_mini"):
        over = {} if given is not soft else {"camera.exposure": 2.0}
        how = {"outputs": "force", "quality": COARSE, "sensor_overrides": over}
        made = tacgen.simulate(given, tacgen.Sphere(radius_mm=4), press, **how)
        (row,) = read_again(made.recipe)
        assert row.sensor == made.sensor


@pytest.mark.parametrize(
    ("name", "said"),
    [("nut M8.stl", "nut M8"), ("../up/there.ply", "there"), ("C:\\a\\b.obj", "b"), ("letters", "letters")],
)
def test_an_object_is_called_by_the_name_of_its_file(tmp_path: Path, name: str, said: str) -> None:
    with Writer(tmp_path / "x.h5", attributes(recipe={"indenter": {"shape": "mesh", "file": name}}), 1) as writer:
        writer.append({"/frames/force": np.ones(3)})
        bundle = writer.finish()
    assert indenter_text(bundle) == said
    assert caption(bundle).startswith(f"A {said}, on gelsight_mini")


def test_the_object_of_a_file_that_is_gone_is_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "tip.stl"
    trimesh.creation.icosphere(subdivisions=1, radius=3.0).export(file)
    row = small_recipe.row(small_recipe.PRESS, f"indenter={{shape: mesh, file: {file}, scale: 1.5}}")
    bundle = read(pipeline.run_scene(row, tmp_path / "out").path)
    assert bundle[MESH].tobytes() == file.read_bytes()
    file.unlink()
    drawn = indenter_surface(bundle, 10.0)
    assert drawn is not None
    assert np.ptp(drawn.vertices, axis=0) == pytest.approx([9, 9, 9], rel=0.1)


def test_what_ships_is_not_kept_and_what_is_too_large_is_noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shipped = small_recipe.row(small_recipe.PRESS, "indenter={shape: mesh, file: ring}")
    assert kept_files.of(shipped) == {}
    file = assets.mesh_path("ring")
    row = small_recipe.row(small_recipe.PRESS, f"indenter={{shape: mesh, file: {file}}}")
    assert kept_files.of(row).keys() == {MESH}
    assert kept_files.note(row) == ""
    monkeypatch.setattr(kept_files, "MAX_KEPT_BYTES", 1000)
    assert kept_files.of(row) == {}
    assert kept_files.note(row).startswith("ring.stl is larger than 0.001 MB and not in the bundle: keep it")


def test_a_kept_file_has_the_hash_that_the_recipe_gives_it(tmp_path: Path) -> None:
    recipe = {**attributes()["recipe"], "indenter": {"shape": "mesh", "file": "../../x\n/..\\..", "sha256": "0" * 64}}
    with Writer(tmp_path / "x.h5", attributes(recipe=recipe), 1) as writer:
        writer.put(MESH, np.frombuffer(b"solid", np.uint8))
        writer.append({"/frames/force": np.ones(3)})
        bundle = writer.finish()
    assert [each.message for each in check(bundle.path)] == [f"{MESH} is not the file of the recipe's indenter.sha256"]
    (path,) = kept_files.located(bundle).values()
    assert path.read_bytes() == b"solid"
    assert path.parent.parent == kept_files.folder().path, "whatever it is called, it goes nowhere else"
