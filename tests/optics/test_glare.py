"""Glare: added to every picture as it is given, and found in an untouched photograph."""

from typing import Any

import numpy as np
import pytest
from helpers.tiny import sensor

from tacgen.base.errors import UserError
from tacgen.calibrate import glare_fit
from tacgen.optics import camera_response
from tacgen.optics.hertz_dent import BallDent
from tacgen.render.images import Renderer
from tacgen.sensor.imperfections import Glare

FLAT = {"red": [[0.1, 0.1], [0.1, 0.1]], "green": [[0.0, 0.0], [0.0, 0.0]], "blue": [[-0.02, -0.02], [-0.02, -0.02]]}
RISING = {key: [[0.0, 0.02, 0.04, 0.06]] * 3 for key in ("red", "green", "blue")}


def lit(**camera: Any) -> Any:
    """A sensor with a vignette and mixed colours, which the glare must not have, so bright that none is below 0."""
    mixed = {"vignette_mm": [5.0, 6.0, 7.0], "colour_matrix": [[1, -0.2, 0.1], [0, 1, 0], [0, 0, 1]]}
    return sensor(camera={"response": "linear", "ambient": 0.1, **mixed, **camera}, markers=None)


def counts(made: Any, face: Any = None) -> np.ndarray:
    """Light of a picture, over full scale."""
    renderer = Renderer(made, 16, 0, False)
    return camera_response.expose(renderer.image(face or renderer.untouched).astype(float), made.camera)


@pytest.mark.parametrize("face", [None, BallDent(2.0, 1.2, (0.4, -0.3))], ids=["untouched", "pressed"])
def test_is_added_to_each_picture(face: Any) -> None:
    added = counts(lit(glare=FLAT), face) - counts(lit(), face)
    assert added == pytest.approx(np.broadcast_to([0.1, 0.0, -0.02], added.shape), abs=1e-6)


def test_is_smooth_between_the_middles_of_cells() -> None:
    camera = lit(glare=RISING).camera
    seen = camera_response.expose(camera_response.glare(camera), camera)
    across = (np.arange(camera.width_px) + 0.5) / camera.width_px * 4 - 0.5
    middle = (across > 1) & (across < 2)
    assert seen[:, middle, 1] == pytest.approx(
        np.broadcast_to(0.02 * across[middle], seen[:, middle, 1].shape), abs=2e-3
    )
    assert np.ptp(seen, axis=0).max() < 1e-9


def test_is_found_in_an_untouched_picture() -> None:
    true = lit(glare=RISING)
    picture = np.round(255 * counts(true)).astype(np.uint8)
    found = glare_fit.glare(lit(), picture)
    assert [len(found.red), len(found.red[0])] != [3, 4]  # by its own cells
    again = counts(lit(glare=found.model_dump(mode="json")))
    assert np.abs(255 * again - picture).max() < 2
    assert np.abs(255 * counts(lit()) - picture).max() > 10


def test_rows_must_be_alike() -> None:
    with pytest.raises(UserError, match="as many rows in each colour"):
        Glare(**{**FLAT, "blue": [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]})


def test_is_dimmed_as_the_light_that_a_gel_scatters(monkeypatch: pytest.MonkeyPatch) -> None:
    renderer = Renderer(lit(glare=FLAT), 16, 0, False)
    plain = Renderer(lit(), 16, 0, False)
    monkeypatch.setattr(Renderer, "_scatters", True)
    face = BallDent(2.0, 1.2, (0.4, -0.3))
    share = plain.image(face) / plain.flat()
    assert renderer.image(face) == pytest.approx(renderer.flat() * share, rel=1e-5)
    assert np.abs(renderer.flat() - plain.flat()).max() > 0.05
