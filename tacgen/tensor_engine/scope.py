"""Scenes that the batch engine solves: the laws and indenters that it has as numbers."""

from tacgen.geometry import analytic_sdf as sdf
from tacgen.geometry.analytic_sdf import Shape
from tacgen.geometry.sdf_grid import Field
from tacgen.mechanics.scene import Scene

# the numbers of each analytic shape, in the order in which gpu_distance takes them
SHAPE_NUMBERS: dict[type, tuple[str, ...]] = {
    sdf.SphereSdf: ("radius",),
    sdf.CapsuleSdf: ("radius", "length"),
    sdf.TorusSdf: ("radius", "tube_radius"),
    sdf.CylinderSdf: ("radius", "fillet"),
    sdf.BoxSdf: ("size_x", "size_y", "fillet"),
    sdf.ConeSdf: ("half_angle", "tip_radius"),
    sdf.WedgeSdf: ("half_angle", "tip_radius", "length"),
}
SUPPORTED_SHAPES = (*SHAPE_NUMBERS, Field)


def lacks(scene: Scene) -> str | None:
    """The first thing in a scene that the batch engine does not do, in words; None: it solves the scene."""
    wanted = {
        "a mesh of tets": scene.element != "hex",
        "inertia": scene.dynamics is not None,
        "a viscous gel": scene.duration is not None and any(layer.prony for layer in scene.gel.layers),
        "this indenter": not known(scene.shape),
    }
    return next((what for what, is_so in wanted.items() if is_so), None)


def known(shape: Shape) -> bool:
    """Whether a shape has a kernel on a GPU."""
    return type(shape) in SUPPORTED_SHAPES
