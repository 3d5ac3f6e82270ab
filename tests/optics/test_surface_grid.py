"""The sheet over the coated face, its drawing, and the sparse evaluation over it."""

import numpy as np
import pytest
from helpers.tiny import sensor

from tacgen.geometry.outline import Pad
from tacgen.geometry.rasterize import Hits, blend, hits, nearest
from tacgen.optics import adaptive_sampling
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.hertz_dent import BallDent
from tacgen.optics.surface_grid import Sheet, Untouched

SHEET = Sheet(Pad(12.0, 10.0, 1.0), (21, 25))


class Tilted:
    """z = 0.1 x - 0.2 y, and it refuses points off the pad."""

    def at(self, xy):
        core = np.array([5.0, 4.0])
        assert np.all(np.linalg.norm(xy - np.clip(xy, -core, core), axis=1) <= 1.0)
        return np.column_stack([xy, 0.1 * xy[:, 0] - 0.2 * xy[:, 1]])


def test_triangles_face_the_camera_and_cover_the_pad():
    p = SHEET.at(Untouched())[SHEET.faces]
    normals = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    assert np.all(normals[:, 2] < 0)
    assert -normals[:, 2].sum() / 2 == pytest.approx(120.0)


def test_a_tilted_face_has_its_normal_and_corners_are_only_asked_on_the_pad():
    nodes = SHEET.at(Tilted())
    inner = np.all(np.abs(SHEET.rest) < [4.0, 3.0], axis=1)
    expected = np.array([0.1, -0.2, -1.0]) / np.sqrt(1.05)
    assert SHEET.normals(nodes)[inner] == pytest.approx(np.tile(expected, (inner.sum(), 1)), abs=1e-12)


def test_drawing_interpolates_linearly_and_keeps_the_nearest():
    nodes = SHEET.at(Untouched())
    screen = (nodes[:, :2] + [6.0, 5.0]) * 4
    value = (2 * nodes[:, 0] - nodes[:, 1])[:, None]
    faces = np.concatenate([SHEET.faces, SHEET.faces + len(nodes)])
    at, near = np.tile(screen, (2, 1)), np.repeat([1.0, 2.0], len(nodes))
    triangle, place, both = hits(faces, at, near, (40, 50))
    found = Hits(faces, triangle.ravel(), place.reshape(-1, 2))
    out = blend(found, np.concatenate([value, value * 0])).reshape(40, 50)
    y, x = np.mgrid[:40, :48] + 0.5
    assert out[:, :48] == pytest.approx(2 * (x / 4 - 6) - (y / 4 - 5), abs=1e-9)
    assert np.isnan(out[:, 48:]).all()
    assert nearest(faces, at, near, (40, 50)) == pytest.approx(np.where(np.isnan(out), np.nan, 1.0), nan_ok=True)
    assert not both


def test_sparse_light_is_exact_where_it_bends_and_close_elsewhere():
    h, w = 37, 50
    y, x = np.mgrid[:h, :w] / 10.0
    normals = np.dstack([np.where(x > 2.5, 0.3, 0.0) * np.sin(y), 0 * x, 1 + 0 * x]).reshape(-1, 3)
    full = np.column_stack([(1 + 0.05 * x + 0.02 * y + normals[:, 0].reshape(h, w)).ravel()] * 2)
    asked = []

    def light(index):
        asked.append(index)
        return full[index]

    out = adaptive_sampling.evaluate(light, normals, (h, w), adaptive_sampling.SamplingTolerance(4, 1.5e-3, 0.12))
    assert out == pytest.approx(full, rel=2e-3)
    assert len(np.concatenate(asked)) < 0.75 * h * w
    assert len(np.unique(np.concatenate(asked))) == len(np.concatenate(asked))
    asked.clear()
    normals.reshape(h, w, 3)[18, 22] = np.nan  # one sample beside the gel
    adaptive_sampling.evaluate(light, normals, (h, w), adaptive_sampling.SamplingTolerance(4, 1.5e-3, 9.0))
    assert 18 * w + 22 in np.concatenate(asked)


def test_a_dent_is_smooth_at_its_contact_circle_and_found_again_from_its_picture():
    dent = BallDent(3.0, 1.5, (1.0, -0.5))
    r = 1.5 + np.array([-2e-4, -1e-4, 0.0, 1e-4, 2e-4])
    z = dent.at(np.column_stack([1.0 + r, np.full(5, -0.5)]))[:, 2]
    assert np.ptp(z) < 1e-3
    camera = PinholeCamera.from_sensor(sensor())
    rim = dent.at(np.array([1.0, -0.5]) + 1.5 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1.0]]))
    pixels = camera.project(rim)
    middle = (pixels.max(axis=0) + pixels.min(axis=0)) / 2
    size = float((np.ptp(pixels, axis=0) / 2).mean())
    found = BallDent.seen(camera, 3.0, (middle[0], middle[1]), size)
    assert found.contact == pytest.approx(1.5, rel=5e-3)
    assert found.center == pytest.approx((1.0, -0.5), abs=0.02)
