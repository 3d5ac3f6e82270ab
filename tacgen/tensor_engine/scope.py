"""Scenes that the batch engine solves: the laws and indenters that it has as numbers."""

from tacgen.fem.materials import Law, MooneyRivlin, NeoHooke, StableNeoHooke, Stiffened, Yeoh
from tacgen.geometry import analytic_sdf as sdf
from tacgen.geometry.analytic_sdf import Shape
from tacgen.geometry.sdf_grid import Field
from tacgen.mechanics.scene import Scene

# the numbers of each analytic shape, in the order in which gpu_distance takes them
NUMBERS: dict[type, tuple[str, ...]] = {
    sdf.SphereSdf: ("radius",),
    sdf.CapsuleSdf: ("radius", "length"),
    sdf.TorusSdf: ("radius", "tube_radius"),
    sdf.CylinderSdf: ("radius", "fillet"),
    sdf.BoxSdf: ("size_x", "size_y", "fillet"),
    sdf.ConeSdf: ("half_angle", "tip_radius"),
    sdf.WedgeSdf: ("half_angle", "tip_radius", "length"),
}
KINDS = (*NUMBERS, Field)


def lacks(scene: Scene) -> str | None:
    """The first thing in a scene that the batch engine does not do, in words; None: it solves the scene."""
    wanted = {
        "a mesh of tets": scene.element != "hex",
        "inertia": scene.dynamics is not None,
        "a viscous gel": scene.duration is not None and any(layer.prony for layer in scene.gel.layers),
        "this material law": any(numbers(layer.law) is None for layer in scene.gel.layers),
        "this indenter": not known(scene.shape),
    }
    return next((what for what, is_so in wanted.items() if is_so), None)


def numbers(law: Law) -> list[float] | None:
    """The numbers of a law, in the order of laws.NUMBERS; None: it is none of the shipped ones."""
    if isinstance(law, Stiffened):
        inner = numbers(law.law)
        return None if inner is None else [law.times * v for v in inner[:5]] + inner[5:]
    if isinstance(law, NeoHooke):
        return [law.mu / 2, 0, 0, 0, 0, law.kappa, 0, 0]
    if isinstance(law, MooneyRivlin):
        return [law.c10, law.c01, 0, 0, 0, law.kappa, 0, 0]
    if isinstance(law, Yeoh):
        return [law.c10, 0, law.c20, law.c30, 0, law.kappa, 0, 0]
    if isinstance(law, StableNeoHooke):
        return [0, 0, 0, 0, law.mu / 2, 0, law.lam, law.mu]
    return None


def known(shape: Shape) -> bool:
    """Whether a shape has a kernel on a GPU."""
    return type(shape) in KINDS
