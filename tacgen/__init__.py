"""tacgen: labelled data of vision-based tactile sensors, computed by finite elements and light transport.

    >>> import tacgen
    >>> press = tacgen.Press(depth_mm=0.4, frames=2)
    >>> frames = tacgen.simulate("gelsight_mini", tacgen.Sphere(radius_mm=4), press, quality="draft")
    >>> frames.force.shape  # [N]
    (2, 3)
    >>> bool(frames.force[-1, 2] < 0)  # the ball pushes the gel along -z
    True

`__all__` lists the public names. Beside them only what docs/API.md describes is public; all else may change.
"""

from typing import TYPE_CHECKING, Any

from tacgen.base.version import __version__ as __version__

if TYPE_CHECKING:
    from tacgen.api.frames import Frames, SceneRejected, read, read_all
    from tacgen.api.simulation import load_sensor, run, simulate
    from tacgen.base.errors import UserError
    from tacgen.bundle.postprocess import hydrostatic, principal, von_mises
    from tacgen.recipe.indenters import Box, Capsule, Cone, Cylinder, Mesh, Sphere, Torus, Wedge
    from tacgen.recipe.model import Dynamics, MaterialDeviation, PoseDeviation, Rayleigh, Render, Uncertainty
    from tacgen.recipe.trajectory import Hold, Press, Release, Replay, Slide, Start, Tilt, Twist
    from tacgen.sensor.layers import MooneyRivlinLayer, NeoHookeLayer, PronyTerm, StableNeoHookeLayer, YeohLayer
    from tacgen.sensor.model import Camera, Dome, Gel, Sensor

# The public names by the module that holds them; a module is imported when one of its names is first asked for.
_HOMES = {
    "tacgen.api.simulation": ("simulate", "run", "load_sensor"),
    "tacgen.api.frames": ("Frames", "SceneRejected", "read", "read_all"),
    "tacgen.bundle.postprocess": ("von_mises", "principal", "hydrostatic"),
    "tacgen.base.errors": ("UserError",),
    "tacgen.recipe.indenters": ("Sphere", "Cylinder", "Cone", "Box", "Wedge", "Capsule", "Torus", "Mesh"),
    "tacgen.recipe.trajectory": ("Start", "Press", "Slide", "Twist", "Tilt", "Hold", "Release", "Replay"),
    "tacgen.sensor.model": ("Sensor", "Gel", "Dome", "Camera"),
    "tacgen.sensor.layers": ("NeoHookeLayer", "StableNeoHookeLayer", "MooneyRivlinLayer", "YeohLayer", "PronyTerm"),
    "tacgen.recipe.model": ("Uncertainty", "MaterialDeviation", "PoseDeviation", "Dynamics", "Rayleigh", "Render"),
}
__all__ = [  # in full, for type checkers
    "Box", "Camera", "Capsule", "Cone", "Cylinder", "Dome", "Dynamics", "Frames", "Gel", "Hold", "MaterialDeviation",
    "Mesh", "MooneyRivlinLayer", "NeoHookeLayer", "PoseDeviation", "Press", "PronyTerm", "Rayleigh", "Release",
    "Render", "Replay", "SceneRejected", "Sensor", "Slide", "Sphere", "StableNeoHookeLayer", "Start", "Tilt", "Torus",
    "Twist", "Uncertainty", "UserError", "Wedge", "YeohLayer", "hydrostatic", "load_sensor", "principal", "read",
    "read_all", "run", "simulate", "von_mises",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    from importlib import import_module

    home = next((module for module, names in _HOMES.items() if name in names), None)
    if home is not None:
        globals()[name] = found = getattr(import_module(home), name)
        return found
    from difflib import get_close_matches

    close = [] if name.startswith("_") else get_close_matches(name, __all__, n=1)
    hint = f", did you mean {close[0]}?" if close else ""
    raise AttributeError(f"module 'tacgen' has no attribute {name!r}{hint}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
