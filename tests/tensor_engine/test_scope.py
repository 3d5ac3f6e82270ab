"""The table of docs/GPU.md is what the batch engine does: each feature is a scene that it takes or leaves to cores."""

import json
import re
from pathlib import Path

import pytest
import trimesh

from tacgen.batch import cuda_engine
from tacgen.mechanics.scene import Scene
from tacgen.recipe import plan
from tacgen.tensor_engine import planning

PAGE = (Path(__file__).parents[2] / "docs/GPU.md").read_text()
TOLD = dict(re.findall(r"^\| (.+) \| (yes|no) \|$", PAGE, re.M))
PRESS = [{"press": {"depth_mm": 0.4, "frames": 1}}]
MOVES = [
    *PRESS,
    *({"slide": {"x_mm": 0.2, "frames": 1}}, {"twist": {"angle_deg": 5, "frames": 1}}),
    *({"tilt": {"angle_deg": 2, "frames": 1}}, {"hold": {"frames": 1}}, {"release": {"frames": 1}}),
]
TIMED = [{"press": {"depth_mm": 0.4, "frames": 1, "duration_s": 1}}]
PRONY = {"gel.layers[0].prony": [{"g": 0.1, "tau_s": 1}]}
FEATURES = {  # a line of the table: what it changes in a recipe
    "presses by depth, slides, twists, tilts, holds, releases, replays": {"trajectory": MOVES},
    "presses, slides and releases by force": {"trajectory": [{"press": {"force_n": 1, "frames": 1}}]},
    "replays that meet a table's forces": {"trajectory": [{"replay": {"file": "table.csv", "match": "force"}}]},
    "spheres, cylinders, cones, boxes, wedges, capsules, tori": {
        "indenter": {"shape": "box", "size_x_mm": 3, "size_y_mm": 3}
    },
    "meshes whose edges are as smooth as the grid": {"indenter": {"shape": "mesh", "file": "ball.stl"}},
    "meshes with exact edges": {"indenter": {"shape": "mesh", "file": "key"}},
    "layers, domes, every material law": {"sensor": "digit"},
    "a gel with a Prony series, in timed movements": {"trajectory": TIMED, "sensor_overrides": PRONY},
    "`stress` and `surface_stress` of such a gel": {
        "trajectory": TIMED,
        "sensor_overrides": PRONY,
        "outputs": ["stress"],
    },
    "inertia (`dynamics`)": {"dynamics": {"density_kg_m3": 1000, "frame_s": 0.01, "step_s": 0.01}},
    "gels from meshes, `mesh: tet`": {"mesh": "tet"},
    "`uncertainty`": {"uncertainty": {"material": {"poissons_ratio": 0.1}}},
    "grasps": {"grasp": {"mass_kg": 0.1}, "trajectory": [{"close": {"force_n": 1, "frames": 1}}]},
}


def test_every_line_of_the_table_is_tried() -> None:
    assert TOLD.keys() == FEATURES.keys()


@pytest.mark.parametrize("feature", FEATURES)
def test_the_table_says_what_the_engine_takes(feature: str, tmp_path: Path) -> None:
    recipe = {"tacgen": 1, "name": "one", "sensor": "gelsight_mini", "indenter": {"shape": "sphere", "radius_mm": 4}}
    recipe |= {"trajectory": PRESS, "outputs": ["force"], "quality": "draft"}
    trimesh.creation.icosphere(subdivisions=4, radius=3).export(tmp_path / "ball.stl")
    titles = "time_s,x_mm,y_mm,z_mm,qw,qx,qy,qz,force_x,force_y,force_z"
    (tmp_path / "table.csv").write_text(f"{titles}\n0,0,0,0,1,0,0,0,0,0,-1")
    (tmp_path / "one.yaml").write_text(json.dumps(recipe | FEATURES[feature]))
    (row,) = plan.load(tmp_path / "one.yaml").rows
    scene = cuda_engine.scene_of(row)
    taken = isinstance(scene, Scene) and planning.lacks(scene) is None
    assert taken == (TOLD[feature] == "yes"), scene if isinstance(scene, str) else planning.lacks(scene)
