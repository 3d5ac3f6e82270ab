"""Recipes to which a test only adds what it is about: a ball on a coarse mesh of the GelSight Mini."""

from pathlib import Path
from tempfile import TemporaryDirectory

from tacgen.recipe import plan
from tacgen.recipe.row import Row

BALL = """
tacgen: 1
name: small
sensor: gelsight_mini
indenter: {shape: sphere, radius_mm: 4.0}
"""
PRESS = "press: {depth_mm: 0.4, frames: 1}"
# its forces along a trajectory that the test writes
HEAD = f"""{BALL}outputs: [force]
quality: {{edge_mm: 1.0, dhat_mm: 0.1}}
trajectory:
"""
# and small pictures of it, without noise
PICTURE = f"""{BALL}sensor_overrides: {{camera.width_px: 64, camera.height_px: 48, camera.mm_per_px: 0.317}}
trajectory: [{PRESS}]
quality: {{edge_mm: 1.0, dhat_mm: 0.1, spp: 4}}
render: {{noise: false}}
"""


def row(moves: str = PRESS, *sets: str) -> Row:
    """The scene of the small recipe with these movements, and other keys set as by --set."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "small.yaml"
        path.write_text(f"{HEAD}  [{moves}]\n")
        return plan.load(path, sets).rows[0]
