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
    from tacgen.api.frames import Frames as Frames
    from tacgen.api.frames import SceneRejected as SceneRejected
    from tacgen.api.frames import read as read
    from tacgen.api.frames import read_all as read_all
    from tacgen.api.simulation import load_sensor as load_sensor
    from tacgen.api.simulation import run as run
    from tacgen.api.simulation import simulate as simulate
    from tacgen.base.errors import UserError as UserError
    from tacgen.bundle.postprocess import hydrostatic as hydrostatic
    from tacgen.bundle.postprocess import principal as principal
    from tacgen.bundle.postprocess import von_mises as von_mises
    from tacgen.recipe.indenters import Box as Box
    from tacgen.recipe.indenters import Capsule as Capsule
    from tacgen.recipe.indenters import Cone as Cone
    from tacgen.recipe.indenters import Cylinder as Cylinder
    from tacgen.recipe.indenters import Mesh as Mesh
    from tacgen.recipe.indenters import Sphere as Sphere
    from tacgen.recipe.indenters import Torus as Torus
    from tacgen.recipe.indenters import Wedge as Wedge
    from tacgen.recipe.model import Dynamics as Dynamics
    from tacgen.recipe.model import MaterialDeviation as MaterialDeviation
    from tacgen.recipe.model import PoseDeviation as PoseDeviation
    from tacgen.recipe.model import Rayleigh as Rayleigh
    from tacgen.recipe.model import Render as Render
    from tacgen.recipe.model import Uncertainty as Uncertainty
    from tacgen.recipe.trajectory import Hold as Hold
    from tacgen.recipe.trajectory import Press as Press
    from tacgen.recipe.trajectory import Release as Release
    from tacgen.recipe.trajectory import Replay as Replay
    from tacgen.recipe.trajectory import Slide as Slide
    from tacgen.recipe.trajectory import Start as Start
    from tacgen.recipe.trajectory import Tilt as Tilt
    from tacgen.recipe.trajectory import Twist as Twist
    from tacgen.sensor.layers import MooneyRivlinLayer as MooneyRivlinLayer
    from tacgen.sensor.layers import NeoHookeLayer as NeoHookeLayer
    from tacgen.sensor.layers import PronyTerm as PronyTerm
    from tacgen.sensor.layers import StableNeoHookeLayer as StableNeoHookeLayer
    from tacgen.sensor.layers import YeohLayer as YeohLayer
    from tacgen.sensor.model import Camera as Camera
    from tacgen.sensor.model import Dome as Dome
    from tacgen.sensor.model import Gel as Gel
    from tacgen.sensor.model import Sensor as Sensor

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
__all__ = [name for names in _HOMES.values() for name in names]


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
