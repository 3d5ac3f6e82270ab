"""Maps of known forces: all of it arrives, nothing turns negative, the rim is sharp; where samples lie in mm."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import small_recipe
from helpers.small import patch

import tacgen
from tacgen.batch import pipeline
from tacgen.mechanics import Problem, State
from tacgen.mechanics.barrier import Faces
from tacgen.optics.camera import PinholeCamera, Stack
from tacgen.outputs import contact_maps
from tacgen.outputs.gel_surface import GelSurface

Array = np.ndarray
RADIUS, FRICTION = 1.9, 0.4
CAMERA = PinholeCamera(Stack((30.0, 4.0), (1.0, 1.41)), (0.0, 0.0), 600.0, (120, 120))  # .055 mm a pixel
BESIDE = replace(CAMERA, center=(CAMERA.mm_per_px * 60, 0.0))  # sees the right half
KINDS = pytest.mark.parametrize("kind", [4, 3, 6])


def hertz(at: Array) -> Array:
    """Pressure (...) of a ball [MPa] at points (..., 3)."""
    return np.asarray(0.1 * np.sqrt(np.maximum(1 - (at[..., 0] ** 2 + at[..., 1] ** 2) / RADIUS**2, 0.0)))


def touching(faces: Faces) -> Problem:
    """As much of a problem as maps need."""
    return SimpleNamespace(contact=SimpleNamespace(faces=faces), friction=FRICTION)  # type: ignore[return-value]


def pressed(
    points: Array, faces: Faces, uneven: Array | float = 1.0, surface: GelSurface | None = None
) -> tuple[contact_maps.Maps, State]:
    """A level face under a ball that slides along (.6, .8), and its maps; `uneven` (q,) is times the pressure."""
    force = hertz(faces.at(points)) * faces.areas * uneven
    rub = FRICTION * force[..., None] * np.array([0.6, 0.8, 0.0])
    down = np.broadcast_to([0.0, 0.0, -1.0], rub.shape)
    state = State(0, np.eye(4), points, force, down, rub, force > 0, 1, 1, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0)
    return contact_maps.maps(touching(faces), surface or GelSurface(points, faces.conn), state, CAMERA), state


def error(found: contact_maps.Maps) -> float:
    """Of the pressure, in the mean square over the image."""
    rows, columns = np.indices(CAMERA.shape) + 0.5
    origins, rays = CAMERA.rays(np.stack([columns, rows], -1).reshape(-1, 2))
    true = hertz(origins - rays * (origins[:, 2:] / rays[:, 2:])).reshape(CAMERA.shape)
    return float(np.linalg.norm(found.pressure - true) / np.linalg.norm(true))


@pytest.mark.parametrize("kind", [4, 3])
def test_sharing_by_the_pressure_sharpens_the_rim(kind: int, monkeypatch: pytest.MonkeyPatch) -> None:
    points, faces, _ = patch(12, 5.0, kind)
    errors = []
    for times in (0, contact_maps.SHARPENING_STEPS[kind]):
        monkeypatch.setitem(contact_maps.SHARPENING_STEPS, kind, times)
        errors.append(error(pressed(points, faces)[0]))
    assert errors[1] < 0.7 * errors[0], errors
    assert 0.03 < errors[1] < 0.09, errors


def test_pressures_that_alternate_on_quadratic_facets_leave_no_grain() -> None:
    """Higher by 6 % near the middles of edges, lower by 12 % near the corners: of the same force and moments."""
    points, faces, _ = patch(12, 5.0, 6)
    even = pressed(points, faces)[0].pressure
    uneven = 1 + 0.08 * np.array([1, 1, 1, -1, -1, -1]) / (6 * faces.areas[0] / faces.areas[0].sum())
    found = pressed(points, faces, uneven=uneven)[0].pressure
    middle = even > 0.5 * even.max()
    assert np.abs(found - even)[middle].max() < 0.03 * even.max()
    assert error(pressed(points, faces)[0]) < 0.06


def test_the_pressure_map_converges() -> None:
    """At an order of about 1: the slope of Hertz' pressure is infinite at the rim."""
    errors = [error(pressed(*patch(n, 5.0)[:2])[0]) for n in (6, 12, 24)]
    assert np.log2(errors[0] / errors[2]) / 2 == pytest.approx(0.95, abs=0.25), errors


@pytest.mark.parametrize(("kind", "along"), [(4, 2), (4, 3), (4, 4), (3, 2), (6, 2)])
def test_all_of_the_force_is_in_the_map(kind: int, along: int) -> None:
    """With any number of contact points along a side."""
    points, faces, pat = patch(10, 5.0, kind)
    faces = Faces.on(pat, points, faces.conn, along)
    found, state = pressed(points, faces)
    assert found.pressure.min() == 0
    assert (found.pressure * found.area).sum() == pytest.approx(state.normal_force.sum(), rel=1e-12)
    assert found.force.sum((0, 1)) == pytest.approx(state.traction_force.sum((0, 1)), rel=1e-12)
    assert found.traction == pytest.approx(FRICTION * found.pressure[..., None] * [0.6, 0.8])
    assert found.pressure[found.contact].min() > 0
    assert (found.area * found.contact).sum() == pytest.approx(np.pi * RADIUS**2, rel=0.08)


def test_what_is_out_of_view_is_not_in_the_map() -> None:
    """A camera that looks at the right half gives half of the force, and its own pixels no more than they had."""
    points, faces, _ = patch(12, 5.0)
    whole, state = pressed(points, faces)
    found = contact_maps.maps(touching(faces), GelSurface(points, faces.conn), state, BESIDE)
    assert (found.pressure * found.area).sum() == pytest.approx(state.normal_force.sum() / 2, rel=0.03)
    assert found.pressure[:, :60] == pytest.approx(whole.pressure[:, 60:], abs=0.02 * whole.pressure.max())


@KINDS
def test_gel_that_is_hidden_has_its_force_in_the_force_map_where_it_is_and_not_in_the_pressure(kind: int) -> None:
    """The face folds like an S along x: between two edges of the fold it lies three times behind the picture."""
    points, faces, _ = patch(16, 5.0, kind)
    x, fold = points.copy(), 2 * points[:, 0]
    x[:, 0] -= 0.8 * np.sin(fold) * (np.abs(fold) < np.pi)
    x[:, 2] += 0.4 * (1 + np.cos(fold)) * (np.abs(fold) < np.pi)
    found, state = pressed(x, faces, surface=GelSurface(points, faces.conn).moved(x))
    total, at = state.traction_force.sum((0, 1)), faces.at(x)
    assert found.force.sum((0, 1)) == pytest.approx(total, rel=1e-12)
    seen = (found.pressure * found.area).sum() / state.normal_force.sum()
    assert 0.3 < seen < 0.8
    assert found.unseen == pytest.approx(1 - seen, rel=1e-9)
    columns = np.arange(120) + 0.5
    middle = found.force[..., 2].sum(0) @ columns / total[2]
    pixels = CAMERA.project(at.reshape(-1, 3))
    assert middle == pytest.approx(pixels[:, 0] @ state.normal_force.ravel() / state.normal_force.sum(), abs=1.0)


@KINDS
@pytest.mark.parametrize("scale", [1.0, 1e-30])
def test_resultants_of_maps_are_compared_with_the_forces(kind: int, scale: float) -> None:
    """Of a level face under an indenter whose normals lean by 60 deg to either side, as of a tip that the mesh does not
    resolve: the normal forces cancel but for half of them, and the map has all of them along z."""
    points, faces, _ = patch(12, 5.0, kind)
    _, level = pressed(points, faces)
    level = replace(level, normal_force=scale * level.normal_force, friction=scale * level.friction)
    side = np.sign(faces.at(points)[..., :1])
    lean = replace(level, normal=side * [np.sqrt(0.75), 0, 0] + [0, 0, -0.5], friction=0 * level.friction)
    surface = GelSurface(points, faces.conn)

    def errors(state: State, camera: PinholeCamera = CAMERA) -> list[float]:
        view = contact_maps.Shares(touching(faces), surface, state, camera)
        return list(contact_maps.resultant_errors(view, surface, state, contact_maps.spread(view, state)).values())

    assert errors(level) == pytest.approx([0, 0], abs=1e-9)
    assert errors(lean) == pytest.approx([1, 0], abs=1e-9)
    assert errors(replace(level, normal_force=0 * level.normal_force, friction=0 * level.friction)) == [0, 0]
    half = [0.5 / np.hypot(1, FRICTION), 0.5 * FRICTION / np.hypot(1, FRICTION)]
    assert errors(level, BESIDE) == pytest.approx(half, rel=0.03)


@KINDS
@pytest.mark.parametrize("stuck", [0.2, 1.0])
def test_friction_in_any_direction_of_points_that_slide_or_stick_obeys_coulombs_law(kind: int, stuck: float) -> None:
    points, faces, _ = patch(6, 5.0, kind)
    _, state = pressed(points, faces)
    random = np.random.default_rng(3)
    sliding, angle = random.random(state.normal_force.shape) < 0.4, random.uniform(0, 1.5, state.normal_force.shape)
    size = FRICTION * state.normal_force * np.where(sliding, 1.0, stuck)
    rub = size[..., None] * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    partly = replace(state, sliding=sliding, friction=rub)
    found = contact_maps.maps(touching(faces), GelSurface(points, faces.conn), partly, CAMERA)
    assert found.pressure.min() >= 0
    assert found.sliding.min() >= 0
    assert found.sliding.max() <= 1 + 1e-12
    excess = np.linalg.norm(found.traction, axis=-1) - FRICTION * found.pressure
    assert excess.max() < 1e-3 * FRICTION * found.pressure.max()


def test_slip_is_where_most_of_the_pressure_slides() -> None:
    contact, sliding = np.array([[True, True, False]]), np.array([[0.4, 0.6, 0.9]])
    blank = np.zeros((1, 3))
    assert contact_maps.Maps(blank, blank, contact, sliding, blank, blank).slip.tolist() == [[False, True, False]]


def test_a_face_has_its_own_x_and_y_even_where_it_looks_along_the_sensors_x() -> None:
    normals = np.array([[0, 0, 1.0], [0.6, 0, 0.8], [1, 0, 0], [-1, 0, 0]])
    x, y = contact_maps.tangents(normals)
    for k, n in enumerate(normals):
        assert np.stack([x[k], y[k], n]) @ np.stack([x[k], y[k], n]).T == pytest.approx(np.eye(3), abs=1e-12)
    assert x[0] == pytest.approx([1, 0, 0])
    assert y[0] == pytest.approx([0, 1, 0])


BALL = 2.5, -1.5  # x, y [mm]
LEANS = "sensor_overrides={camera.tilt_deg: [7, -5], camera.roll_deg: 15}"


@pytest.mark.parametrize("more", [("sensor=gelsight_mini",), ("sensor=digit",), ("sensor=gelsight_mini", LEANS)])
def test_a_ball_presses_where_its_map_says(tmp_path: Path, more: tuple[str, ...]) -> None:
    sets = (f"start={{x_mm: {BALL[0]}, y_mm: {BALL[1]}}}", "outputs=[traction, force_map, height]", *more)
    frames = tacgen.read(pipeline.run_scene(small_recipe.row(small_recipe.PRESS, *sets), tmp_path).path)
    dome = frames.sensor.gel.dome
    # a ball of 4 mm touches a dome where their normals meet
    bends = (1.0, 1.0) if dome is None else (r / (r + 4) for r in (dome.radius_x_mm, dome.radius_y_mm))
    touches = [at * bend for at, bend in zip(BALL, bends, strict=True)]
    weight = frames.pressure[-1].astype(float) * frames.area[-1]
    x, y = frames.x_mm, frames.y_mm
    assert x.shape == y.shape == weight.shape
    assert np.nansum(weight * x) / weight.sum() == pytest.approx(touches[0], abs=0.08)
    assert np.nansum(weight * y) / weight.sum() == pytest.approx(touches[1], abs=0.08)
    points = np.stack([x, y, frames["/reference/height"]], -1)
    gel = ~np.isnan(points).any(-1)
    assert np.array_equal(np.isnan(x), np.isnan(y))
    assert np.array_equal(np.isnan(x), np.isnan(frames["/reference/height"]))
    rows, columns = np.indices(x.shape) + 0.5
    there = PinholeCamera.from_sensor(frames.sensor).project(points[gel])
    assert np.abs(there - np.stack([columns, rows], -1)[gel]).max() < 0.05, "the camera sees them there [px]"


def test_positions_are_there_with_maps_alone(tmp_path: Path) -> None:
    frames = tacgen.read(pipeline.run_scene(small_recipe.row(), tmp_path).path)
    assert "/reference/x_mm" not in frames.bundle
    with pytest.raises(AttributeError, match="not among the outputs of this scene"):
        _ = frames.x_mm
