"""Flow of what is printed on the coating, against the projection itself and rays marched through the gel."""

from collections.abc import Callable

import numpy as np
from helpers.tiny import sensor
from scipy.interpolate import RegularGridInterpolator

from tacgen.optics.camera import PinholeCamera
from tacgen.optics.drawn_face import DrawnFace
from tacgen.optics.material_flow import Flow, MaterialPoints
from tacgen.optics.surface_grid import Sheet

Array = np.ndarray
FINE = sensor(camera={"mm_per_px": 0.05, "width_px": 160, "height_px": 128})
CAMERA = PinholeCamera.from_sensor(FINE)


class Face:
    """Rest positions to where a formula takes them."""

    def __init__(self, shift: Callable[[Array, Array], tuple[Array | float, Array | float, Array | float]]) -> None:
        self.shift = shift

    def at(self, xy: Array) -> Array:
        x, y = np.asarray(xy, float).T
        dx, dy, z = self.shift(x, y)
        return np.column_stack([x + dx, y + dy, z + 0 * x])


FLAT = Face(lambda x, y: (0.0, 0.0, 0.0))
SHEET = Sheet.over(FINE.gel, 0.1)


def drawn(face: Face, sheet: Sheet = SHEET) -> DrawnFace:
    return DrawnFace(sheet, face, CAMERA)


def test_the_flow_of_a_face_that_nothing_touches_is_zero() -> None:
    assert np.array_equal(Flow(drawn(FLAT)).at(drawn(FLAT)), np.zeros((128, 160, 2)))


def test_the_flow_of_a_sheared_dent_is_that_of_its_points() -> None:
    """Half a millimetre of shear that fades sideways, in a dent: 10 px of flow at the right place, to 0.05 px."""

    def shear(x: Array, y: Array) -> tuple[Array, Array, Array]:
        bump = np.exp(-((x - 0.5) ** 2 + (y + 0.3) ** 2) / 4)
        return 0.5 * bump, -0.2 * bump, -0.6 * bump

    face = Face(shear)
    flow = Flow(drawn(FLAT)).at(drawn(face))
    field = RegularGridInterpolator((np.arange(128) + 0.5, np.arange(160) + 0.5), flow)
    rest = np.random.default_rng(0).uniform(-2.5, 2.5, (400, 2))
    before, after = CAMERA.project(FLAT.at(rest)), CAMERA.project(face.at(rest))
    error = np.linalg.norm(field(before[:, ::-1]) - (after - before), axis=1)
    assert error.max() < 0.05
    assert 9 < np.nanmax(flow[..., 0]) < 14  # mm_per_px, and a dent comes nearer to the camera
    assert np.nanmin(flow[..., 1]) < -3
    # the air alone would be off by more than that
    dry = CAMERA.focal_px * face.at(rest)[:, :2] / (face.at(rest)[:, 2:] + sum(CAMERA.stack.thicknesses))
    assert np.abs(dry + np.array([80, 64]) - after).max() > 1


def test_what_leaves_the_picture_is_nan() -> None:
    moved = Face(lambda x, y: (0.5, 0.0, 0.0))
    flow = Flow(drawn(FLAT)).at(drawn(moved))
    assert np.isnan(flow[:, 150:]).all()
    assert np.isfinite(flow[:, :149]).all()
    rest = np.array([[0.0, 0.0], [3.9, 0.0], [20.0, 0.0]])
    pixels, seen = MaterialPoints(rest, FLAT, CAMERA).at(drawn(moved))
    assert seen.tolist() == [True, False, False]
    assert pixels[1, 0] > 160  # its place is told all the same


def test_what_stands_behind_a_steep_dent_is_hidden() -> None:
    """A narrow, deep dent off the axis hides its outer flank; against rays marched through the gel."""

    def pit(x: Array, y: Array) -> tuple[float, float, Array]:
        return 0.0, 0.0, -2.4 * np.exp(-((x - 3) ** 2 + y**2) / (2 * 0.15**2))

    face = Face(pit)
    rest = np.stack(np.meshgrid(np.linspace(2.2, 3.8, 81), np.linspace(-0.8, 0.8, 81)), -1).reshape(-1, 2)
    pixels, seen = MaterialPoints(rest, FLAT, CAMERA).at(drawn(face, Sheet.over(FINE.gel, 0.02)))
    origin, ray = CAMERA.rays(pixels)
    reach = (face.at(rest)[:, 2] - origin[:, 2]) / ray[:, 2]
    clearance = np.full(len(rest), np.inf)  # of the ray to the point, on its way, below the face
    for before in np.linspace(0.05, 2.5, 400):
        at = origin + ray * np.maximum(reach - before, 0)[:, None]
        clearance = np.minimum(clearance, pit(at[:, 0], at[:, 1])[2] - at[:, 2])
    assert (clearance < -0.03).sum() > 50
    assert not seen[clearance < -0.03].any()
    assert seen[clearance > 0.01].all()
    assert rest[~seen][:, 0].min() > 3.0
