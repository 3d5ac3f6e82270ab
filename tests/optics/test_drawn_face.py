"""A face before a camera: computed once, and where it folds over itself the part that is asked for."""

import numpy as np
import pytest
from helpers.tiny import sensor

from tacgen.geometry.rasterize import blend
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.drawn_face import DrawnFace
from tacgen.optics.surface_grid import Sheet, Untouched

TINY = sensor()
CAMERA, SHEET = PinholeCamera.from_sensor(TINY), Sheet.over(TINY.gel, 0.2)


class Wave:
    """A face that leans over sideways by `lean` [mm] where it is lowest, and counts how often it is asked."""

    def __init__(self, lean: float) -> None:
        self.lean, self.asked = lean, 0

    def at(self, xy):
        self.asked += 1
        dent = np.exp(-(xy[:, 0] ** 2))
        return np.column_stack([xy[:, 0] + self.lean * dent, xy[:, 1], -dent])


def test_a_face_is_evaluated_when_it_is_asked_for_and_once():
    face = Wave(0.0)
    drawn = DrawnFace(SHEET, face, CAMERA, 2)
    assert face.asked == 0
    for _ in range(2):
        assert drawn.behind(np.column_stack([drawn.nodes, drawn.facing])).shape == (64, 80, 6)
    assert face.asked == 1


def test_a_part_of_a_sheet_shows_what_the_whole_does():
    part = Sheet.over(TINY.gel, 0.2, (-4.9, 5.0, -4.2, 4.1))
    assert 0.4 * len(SHEET.rest) < len(part.rest) < 0.8 * len(SHEET.rest)
    whole, some = (DrawnFace(sheet, Wave(1.0), CAMERA) for sheet in (SHEET, part))
    for ask in (lambda face: face.nodes, lambda face: face.facing, lambda face: face.sheet.rest):
        assert np.array_equal(whole.behind(ask(whole)), some.behind(ask(some)))


@pytest.mark.parametrize(("lean", "folded"), [(0.0, False), (1.0, False), (2.0, True)])
def test_only_a_face_that_tilts_over_is_folded(lean: float, folded: bool):
    drawn = DrawnFace(SHEET, Wave(lean), CAMERA)
    assert drawn.folded is folded
    nearest, outermost = (drawn.behind(drawn.nodes[:, 2:], outer)[..., 0] for outer in (False, True))
    assert bool(np.nanmax(outermost - nearest) > 0.1) is folded
    assert np.nanmin(outermost - nearest) >= 0


def test_normals_behind_samples_have_length_1():
    narrow = CAMERA.__class__(CAMERA.stack, CAMERA.center, CAMERA.focal_px / 2, CAMERA.shape)  # sees beside the gel
    drawn = DrawnFace(SHEET, Wave(1.0), narrow, 2)
    whole = drawn.behind(drawn.nodes).reshape(-1, 3)
    assert 0 < np.isnan(whole).sum() < whole.size / 2 * 1.9
    normal = blend(drawn.hits, drawn.facing, unit=True)
    plain = drawn.behind(drawn.facing).reshape(-1, 3)
    assert normal == pytest.approx(plain / np.linalg.norm(plain, axis=1, keepdims=True), abs=1e-15, nan_ok=True)


def test_an_untouched_dome_is_not_folded():
    assert not DrawnFace(SHEET, Untouched(pad=TINY.gel.pad), CAMERA).folded
