"""Which renderers can draw on a GPU, and what draws for them there. PyTorch is imported only when it is asked to."""

from functools import lru_cache
from typing import TYPE_CHECKING

from tacgen.render.images import Clear, Renderer

if TYPE_CHECKING:
    from tacgen.tensor_optics.drawing import Drawing


def drawable(renderer: Renderer) -> bool:
    """Whether a GPU can draw what a renderer does: clear gels, one ray a pixel, square ones, no fitted response, a
    fixed exposure."""
    light, sensor = renderer.light, renderer.sensor
    camera = sensor.camera
    plain = sensor.thickness_response is None and camera.aspect == 1 and not camera.auto_exposure
    return isinstance(light, Clear) and light.direct.view.samples == 1 and plain


@lru_cache(maxsize=2)  # as many as pictures keep renderers
def drawing(renderer: Renderer, device: str) -> "Drawing":
    """The drawing of a renderer that is drawable, on a device that is `taken`. Raises PyTorch's RuntimeError."""
    from tacgen.tensor_optics.drawing import Drawing

    assert isinstance(renderer.light, Clear)
    light = renderer.light
    return Drawing(light.direct, light.glow, renderer.stray, renderer.texture, device, renderer.glare, renderer.relief)


def taken(device: str) -> str:
    """Use a device from now on in this thread, which it shares with other processes; its name, and the version of
    PyTorch. Raises PyTorch's RuntimeError."""
    from tacgen.tensor_engine.device import named, shared

    shared(device)
    return named(device)
