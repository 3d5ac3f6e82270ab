"""Where a gel from a file is held: at the face that looks at the plate, however it was drawn."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.command import refused, told
from helpers.small_recipe import HEAD
from matplotlib.path import Path as Outline
from scipy.spatial import Delaunay

from tacgen.base.errors import UserError
from tacgen.batch import pipeline
from tacgen.bundle import bundle
from tacgen.mechanics import mesh
from tacgen.recipe import loading, plan, scene_of_row

Array = np.ndarray
SENSOR = """\
tacgen_sensor: 1
name: drawn
description: a pad that was drawn
gel:
  solid: {{file: pad.stl, source: made by a test{more}}}
  width_mm: {x}
  height_mm: {y}
  layers: [{{name: gel, thickness_mm: {z}, youngs_modulus_mpa: 0.15, poissons_ratio: 0.48, source: assumed}}]
  source: made by a test
camera: {{distance_mm: 20, mm_per_px: 0.2, width_px: 48, height_px: 48, source: assumed}}
"""
RECIPE = HEAD.replace("gelsight_mini", "./drawn.yaml") + "  - press: {depth_mm: 0.6, frames: 1}\n"
SIZE = (12.2, 16.2, 2.5)
MUSHROOM = [(-4, 0), (4, 0), (4, 1), (6, 1), (6, 3), (-6, 3), (-6, 1), (-4, 1)]

pytestmark = pytest.mark.usefixtures("own_cache")


def pad(deg: float = 0.0, size: tuple[float, float, float] = SIZE) -> trimesh.Trimesh:
    """A box pad, turned before it is exported."""
    drawn = trimesh.creation.box(size)
    return drawn.apply_transform(trimesh.transformations.rotation_matrix(np.radians(deg), [0, 1, 0]))


def prism(profile: list[tuple[float, float]], length: float = 8.0) -> trimesh.Trimesh:
    """The solid that a profile (x, z), whose sides are all edges of its Delaunay triangles, makes along y."""
    xz, n = np.array(profile, float), len(profile)
    front = Delaunay(xz).simplices
    front = front[Outline(xz).contains_points(xz[front].mean(1))]
    k, after = np.arange(n), (np.arange(n) + 1) % n
    walls = [np.stack([k, k + n, after], 1), np.stack([after, k + n, after + n], 1)]
    vertices = np.concatenate([np.insert(xz, 1, y, axis=1) for y in (0.0, length)])
    made = trimesh.Trimesh(vertices, np.concatenate([front, front + n, *walls]), process=False)
    made.fix_normals()
    return made


def folder(tmp_path: Path, drawn: trimesh.Trimesh, more: str = "") -> Path:
    """A recipe on a sensor whose gel is this mesh."""
    assert drawn.is_watertight
    assert drawn.volume > 0
    drawn.export(tmp_path / "pad.stl")
    x, y, z = drawn.extents
    (tmp_path / "drawn.yaml").write_text(SENSOR.format(x=x, y=y, z=z, more=more))
    (tmp_path / "r.yaml").write_text(RECIPE)
    return tmp_path / "r.yaml"


def held(tmp_path: Path, drawn: trimesh.Trimesh, more: str = "") -> Array:
    """Centres (f, 3) [mm] and areas [mm^2] (f,) of the bonded facets on a fine triangulation of the surface."""
    folder(tmp_path, drawn, more)
    sensor, _ = loading.read_sensor(tmp_path / "drawn.yaml")
    gel = scene_of_row.gel_of(sensor, tmp_path / "pad.stl")
    v, t = trimesh.remesh.subdivide_to_size(*gel.surface(0, 0)[:2], 1.0)
    corners = v[t]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    found = gel.patches(corners, normal / area[:, None], 0.06)
    assert not (found["bonded"] & found["coated"]).any()
    return np.column_stack([corners.mean(1), area / 2])[found["bonded"]]


@pytest.mark.parametrize("deg", [0.0, 0.1, 0.5, 2.0, 6.0])
def test_a_pad_that_is_turned_is_held_at_its_back(deg: float, tmp_path: Path) -> None:
    """At the whole back, and no higher: at .1 deg it was held in part, at 2 deg at one edge."""
    found = held(tmp_path, pad(deg))
    assert found[:, 3].sum() == pytest.approx(12.2 * 16.2)
    way = np.radians(deg)
    flat = found[:, :3] @ [np.sin(way), 0, np.cos(way)]
    assert np.ptp(flat) < 1e-6


def test_a_curved_back_is_held_all_over(tmp_path: Path) -> None:
    for sign in (1, -1):  # convex, hollow
        x = np.linspace(-6, 6, 25)
        back = [(a, sign * 0.03 * a * a - (sign < 0) * -1.1) for a in x]
        found = held(tmp_path, prism([*back, (6, 4.0), (-6, 4.0)]))
        assert np.abs(found[:, 0]).max() > 5.5
        assert found[:, 3].sum() > 12 * 8


def test_a_groove_is_not_held_nor_an_overhang(tmp_path: Path) -> None:
    grooved = [(-6, 0), (-0.5, 0), (-0.5, 0.6), (0.5, 0.6), (0.5, 0), (6, 0), (6, 3), (-6, 3)]
    found = held(tmp_path, prism(grooved))
    assert found[:, 3].sum() == pytest.approx(11 * 8)
    found = held(tmp_path, prism(MUSHROOM))
    assert found[:, 3].sum() == pytest.approx(8 * 8)
    assert found[:, 2].max() < -2.9


def test_the_bonded_share_is_told(tmp_path: Path) -> None:
    recipe = folder(tmp_path, prism(MUSHROOM))
    line = "note: 67% of the gel's footprint is bonded to the plate\n"
    for file in (recipe, tmp_path / "drawn.yaml"):
        assert line in told("validate", file)
    gel = scene_of_row.build(plan.load(recipe).rows[0]).gel
    corner = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    made = mesh.GelMesh(corner, np.arange(4)[None], np.zeros(1, np.int32), {})
    assert mesh.quality(gel, made)["bonded_share"] == pytest.approx(2 / 3, abs=1e-3)


FEET = [(-6, 0), (-5, 0), (-5, 0.6), (5, 0.6), (5, 0), (6, 0), (6, 3), (-6, 3)]


@pytest.mark.parametrize(
    ("drawn", "more"),
    [(pad(40.0), ""), (prism(FEET), ""), (pad(2.0), ", bonded_mm: 0.02"), (prism(FEET), ", bonded_mm: 0.02")],
    ids=["askew", "on feet", "named too low", "feet named"],
)
def test_a_gel_that_is_hardly_held_is_refused(drawn: trimesh.Trimesh, more: str, tmp_path: Path) -> None:
    recipe = folder(tmp_path, drawn, more)
    for command in (("validate", recipe), ("run", recipe, "-o", tmp_path / "out")):
        said = refused(*command).splitlines()[0]
        assert "gel.solid: " in said
        assert "of its footprint would be bonded to the plate, and at least half must be" in said


def test_every_body_of_a_file_is_held_or_inside_one_that_is(tmp_path: Path) -> None:
    base, apart = pad(), trimesh.creation.box((2.0, 2.0, 1.0)).apply_translation([0.0, 0.0, 2.0])
    folder(tmp_path, trimesh.util.concatenate([base, apart]))
    with pytest.raises(UserError, match=r"gel\.solid: 1 of its 2 bodies would not be bonded to the plate: unite them"):
        loading.read_sensor(tmp_path / "drawn.yaml")
    within = trimesh.creation.box((2.0, 2.0, 1.0))
    within.invert()  # a bubble, which is filled
    folder(tmp_path, trimesh.util.concatenate([base, within]))
    assert loading.read_sensor(tmp_path / "drawn.yaml")[0].gel.solid is not None


def test_a_height_that_is_named_is_held(tmp_path: Path) -> None:
    """A back of feet and the plate behind them, potted up to 1 mm."""
    found = held(tmp_path, prism(FEET), ", bonded_mm: 1.0")
    assert found[:, 2].max() < -1.9
    assert found[:, 3].sum() > 12 * 8


@pytest.mark.slow
def test_turned_pads_bear_the_same_force(tmp_path: Path) -> None:
    """They gave .90, .85, .53, .065 and .008 N where the straight one gives .94; at 6 deg there was no solution."""
    force = {}
    for deg in (0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 6.0):
        row = plan.load(folder(tmp_path, pad(deg))).rows[0]
        done = pipeline.run_scene(row, tmp_path, overwrite=True)
        assert done.status == "ok", done.reason
        found = bundle.read(done.path)
        force[deg] = -found["/frames/force"][0, 2]
        assert json.loads(found.attrs["mesh"])["bonded_share"] > 0.95
    assert np.array(list(force.values())) == pytest.approx(force[0.0], rel=0.03), force
