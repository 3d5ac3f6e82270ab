"""Drift of the camera's colours over a scene, JPEG, and where the coating's pattern cannot be seen."""

import numpy as np
import pytest
from helpers.tiny import PLAIN, cloudy, sensor

from tacgen.optics import camera_response
from tacgen.render import jpeg, traced_maps
from tacgen.render.images import Renderer
from tacgen.render.pictures import drifted
from tacgen.sensor.imperfections import Drift
from tacgen.sensor.optics_checks import problems

DRIFT = Drift(gain=0.02, frames=20.0, source="test")
GRAIN = {"contrast": 0.05, "length_mm": 0.3, "source": "test"}


def test_gains_scatter_and_last_as_asked_for() -> None:
    gains = np.array([[drifted(DRIFT, seed, frame) for frame in range(0, 61, 20)] for seed in range(800)]) - 1
    assert gains.mean() == pytest.approx(0, abs=0.001)
    assert gains.std(axis=(0, 1)) == pytest.approx(0.02, rel=0.06)
    near = [np.corrcoef(gains[:, k].ravel(), gains[:, k + 1].ravel())[0, 1] for k in range(3)]
    assert near == pytest.approx([np.exp(-0.5)] * 3, abs=0.06)
    assert abs(np.corrcoef(gains[:, 0, 0], gains[:, 0, 1])[0, 1]) < 0.12  # colours drift apart


def test_a_frames_gain_depends_on_seed_and_number_alone() -> None:
    assert np.array_equal(drifted(DRIFT, 3, 7), drifted(DRIFT, 3, 7))
    assert not np.array_equal(drifted(DRIFT, 3, 7), drifted(DRIFT, 4, 7))


def test_gain_acts_on_the_counts_of_each_colour() -> None:
    mixed = sensor(camera={"colour_matrix": [[1, -0.2, -0.3], [0, 1, 0], [0, 0, 1]], "response": "linear"}).camera
    even = np.full((32, 40, 3), 0.4)
    plain = camera_response.develop(even, mixed).astype(float)
    made = camera_response.develop(even, mixed, gain=np.array([0.5, 1.0, 1.2]))
    assert made == pytest.approx(np.minimum(plain * [0.5, 1.0, 1.2], 255), abs=1.1)


def test_jpeg_changes_pictures_by_its_quality_and_none_without() -> None:
    plain = Renderer(sensor(), 8, 0, markers=True)
    flat, off = plain.develop(plain.flat()), []
    for quality in (20, 95):
        compressed = Renderer(sensor(camera={"jpeg_quality": quality}), 8, 0, markers=True)
        picture = compressed.develop(compressed.flat())
        assert np.array_equal(picture, jpeg.compressed(flat, quality))
        off.append(float(np.abs(picture.astype(float) - flat).mean()))
    assert 0 < off[1] < off[0] < 12


def test_a_gel_that_scatters_hides_the_pattern() -> None:
    coat = {**cloudy().coating.model_dump(exclude_none=True), "grain": GRAIN}
    (found,) = problems(cloudy(coating=coat))
    assert found.path == ("coating", "grain")
    assert "cannot be seen through a layer that scatters" in found.message
    assert list(problems(sensor(coating={**PLAIN["coating"], "grain": GRAIN}))) == []


def test_maps_in_the_cache_serve_every_pattern_drift_and_quality() -> None:
    other = sensor(
        coating={**PLAIN["coating"], "grain": GRAIN}, camera={"jpeg_quality": 50, "drift": DRIFT.model_dump()}
    )
    assert traced_maps.key(other, None) == traced_maps.key(sensor(), None)
    assert traced_maps.key(sensor(coating={**PLAIN["coating"], "roughness": 0.3}), None) != traced_maps.key(
        sensor(), None
    )
