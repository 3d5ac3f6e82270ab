"""What the scenes of one sensor share of their pictures."""

from typing import Any

import numpy as np
import pytest
from helpers.tiny import sensor

from tacgen.optics.surface_grid import Untouched
from tacgen.render import pictures

FILE = sensor()


class Told:
    """A renderer that tells its arguments."""

    def __init__(self, *asked: Any, **named: Any) -> None:
        self.asked = asked, named

    def flat(self) -> np.ndarray:
        return np.zeros((32, 40, 3), np.float32)


def settings(method: Any, seed: int) -> pictures.PictureSettings:
    return pictures.PictureSettings(FILE, method, 16, seed, True, None, frozenset({"rgb"}))


@pytest.mark.parametrize(("method", "shared"), [("transport", True), ("table", True), ("path", False)])
def test_scenes_share_a_renderer_whose_pictures_do_not_depend_on_their_seed(
    method: str, shared: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pictures, "Renderer", Told)
    pictures._rendering.cache_clear()
    face = Untouched.of(FILE.gel)
    one, again, other = (pictures.Pictures(settings(method, seed), face) for seed in (1, 1, 2))
    pictures._rendering.cache_clear()
    assert (one.renderer is again.renderer) is shared
    assert (one.renderer is other.renderer) is shared
    assert (one.renderer.asked == other.renderer.asked) is shared
