"""Scenes that the batch engine solves."""

from tacgen.geometry.exact_edges import SharpField
from tacgen.mechanics.scene import Scene


def lacks(scene: Scene) -> str | None:
    """The first thing in a scene that the batch engine does not do, in words; None: it solves the scene."""
    wanted = {
        "a mesh of tets": scene.element != "hex",
        # it would solve them, at 3 frames a second on an H100 where six scenes are all there is: cores are faster
        "exact edges": isinstance(scene.shape, SharpField),
    }
    return next((what for what, is_so in wanted.items() if is_so), None)
