"""Read off a solved gel: resultants are kept, frames and signs as documented, smooth surfaces, the rim of contact."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.presses import Run, gel, poses, run, scene
from helpers.small import patch

from tacgen.fem.elements import facet_areas
from tacgen.fem.stress_recovery import VOIGT_INDEX
from tacgen.geometry.analytic_sdf import SphereSdf
from tacgen.geometry.clough_tocher import CloughTocher
from tacgen.geometry.pose import Pose
from tacgen.mechanics.barrier import Faces
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.surface_grid import Sheet
from tacgen.outputs import camera_maps, contact_rim, gel_surface
from tacgen.outputs.cauchy_stress import Stresses, _Face, agreeing
from tacgen.outputs.contact_maps import Maps, tangents
from tacgen.outputs.contact_maps import maps as maps_of
from tacgen.recipe import assets, loading
from tacgen.sensor.model import Sensor

Array = np.ndarray
COEFFICIENT = 0.4
PATH = [(1.5, -1.0, -0.4), (1.5, -1.0, -0.8), (2.3, -1.0, -0.8)]
FOOTPRINT = (-2.0, 5.6, -4.0, 2.0)
PRESSED, SLID = 1, 2


@pytest.fixture(scope="module")
def mini() -> Sensor:
    """Its camera looks at the gel's middle here, where the ball is."""
    sensor = loading.read_sensor(assets.sensor_path("gelsight_mini"))[0]
    return sensor.model_copy(update={"camera": sensor.camera.model_copy(update={"crop_mm": (0.0, 0.0)})})


@pytest.fixture(scope="module")
def camera(mini: Sensor) -> PinholeCamera:
    return PinholeCamera.from_sensor(mini)


@pytest.fixture(scope="module")
def pressed() -> Run:
    """A ball off the middle of a pad of the Mini's size: pressed, then slid along +x."""
    pad = gel(25.25, 20.75, 4.0)
    return run(scene(SphereSdf(4.0), poses(PATH), pad=pad, friction=COEFFICIENT, edge=0.75), FOOTPRINT)


@pytest.fixture(scope="module")
def maps(pressed: Run, camera: PinholeCamera) -> list[Maps]:
    return [maps_of(pressed.problem, pressed.face.moved(s.x), s, camera) for s in pressed.states]


def test_maps_keep_the_resultants(pressed: Run, maps: list[Maps]) -> None:
    for state, force, found in zip(pressed.states, pressed.forces, maps, strict=True):
        size = float(np.linalg.norm(force))
        assert found.force.sum((0, 1)) == pytest.approx(force, abs=1e-9 * size)
        assert (found.pressure * found.area).sum() == pytest.approx(state.normal_force.sum(), rel=1e-9)
        assert state.friction is not None
        sizes, at_points = np.linalg.norm(found.traction, axis=-1), np.linalg.norm(state.friction, axis=-1)
        assert (sizes * found.area).sum() <= at_points.sum() * (1 + 1e-9)
    assert (sizes * found.area).sum() == pytest.approx(at_points.sum(), rel=0.02)  # slid: in one direction
    rubbed = (found.traction * found.area[..., None]).sum((0, 1))
    along = [(state.friction * axis).sum() for axis in tangents(-state.normal)]
    assert along[0] > state.friction[..., 0].sum() > 0.3 * size  # the face is not level
    # the sizes are kept, and so the sum on this coarse mesh is not
    assert rubbed == pytest.approx(along, abs=0.05 * size)


def test_torque_is_about_the_origin() -> None:
    """Without friction every force on a ball passes through its middle, so the torque is that of the force there."""
    found = run(scene(SphereSdf(2.5), poses([(1.0, -0.6, -0.4)]), pad=gel(10, 10, 2)))
    force, torque = gel_surface.wrench(found.problem, found.states[-1])
    assert torque == pytest.approx(np.cross([1.0, -0.6, 2.5 - 0.4], force), abs=1e-9)
    assert torque[0] == pytest.approx(-0.6 * force[2], abs=0.05 * -force[2])
    assert torque[1] == pytest.approx(-1.0 * force[2], abs=0.05 * -force[2])
    assert abs(torque[1]) > 0.05


def test_a_dent_follows_the_ball(pressed: Run, maps: list[Maps], mini: Sensor, camera: PinholeCamera) -> None:
    z = camera_maps.View(Sheet.over(mini.gel, 0.1), pressed.face.moved(pressed.states[PRESSED].x), camera).height()
    assert z.min() == pytest.approx(-0.8, abs=0.03)
    assert 0 < z.max() < 0.1  # the rim bulges
    rows, columns = np.nonzero(maps[PRESSED].contact)
    origins, rays = camera.rays(np.column_stack([columns, rows]) + 0.5)
    at = origins + rays * ((z[rows, columns] - origins[:, 2]) / rays[:, 2])[:, None]
    gap = pressed.scene.shape.distance(Pose.of(pressed.scene.poses[PRESSED]).local(at))[0]
    assert np.abs(gap).max() < 0.06
    assert np.abs(gap).mean() < 0.025


def test_a_surface_reproduces_its_nodes_and_linear_fields(pressed: Run) -> None:
    grid, surface = pressed.problem.mesh, pressed.face
    rng = np.random.default_rng(0)
    inner = rng.uniform([-12, -10], [12, 10], (200, 2))
    now = surface.moved(pressed.states[SLID].x)
    assert now.at(now.rest[:, :2]) == pytest.approx(now.now, abs=1e-9)
    assert (now.now == pressed.states[SLID].x[now.nodes]).all()
    A, b = np.array([[1.1, 0.2, 0.0], [-0.1, 0.9, 0.0], [0.05, -0.03, 1.0]]), np.array([0.3, -0.1, 0.2])
    flat = np.column_stack([inner, np.zeros(200)])
    assert surface.moved(grid.points @ A.T + b).at(inner) == pytest.approx(flat @ A.T + b, abs=1e-6)
    assert surface.at(inner) == pytest.approx(flat, abs=1e-12)
    assert surface.at(np.zeros((0, 2))).shape == (0, 3)
    assert np.isnan(surface.at(np.array([[40.0, 0.0]]))).any()


def test_a_surface_is_smooth_across_its_cells(pressed: Run) -> None:
    """Slopes on either side of a cell's edge agree, unlike those of bilinear cells."""
    now = pressed.face.moved(pressed.states[PRESSED].x)
    x = np.unique(now.rest[:, 0])
    edges = x[(x > -0.5) & (x < 3.5)]
    h = 1e-4

    def slopes(side: int) -> Array:
        near, far = (now.at(np.column_stack([edges + side * k * h, np.full_like(edges, -0.9)]))[:, 2] for k in (1, 2))
        return np.asarray((far - near) / (side * h))

    assert np.abs(slopes(1)).max() > 0.3
    assert slopes(1) == pytest.approx(slopes(-1), abs=5e-3)


@pytest.mark.parametrize("along", [3, 4])
def test_area_vectors_do_not_depend_on_the_points_of_contact(along: int) -> None:
    points, faces, pat = patch(4, 5.0)
    others = Faces.on(pat, points, faces.conn, along)
    assert np.array_equal(_Face(others, points).rest, _Face(faces, points).rest)


def test_the_stress_of_a_press_balances_its_force(pressed: Run) -> None:
    """sigma n over the deformed face against the contact's own force; nominal stress times area, by Nanson."""
    made = Stresses(pressed.problem)
    for state, force in zip(pressed.states, pressed.forces, strict=True):
        stress = made.at(state.x)
        quality = made.quality(stress, state)
        assert 0 < quality["force_error"] < 0.03
        assert 0.03 < quality["traction_error"] < 0.3  # cells of .75 mm under a contact of 1.7 mm radius
        assert 0.0 < quality["pressure_oscillation"] < 0.25
        faces = pressed.problem.contact.faces
        area, normal = facet_areas(state.x, faces.conn)
        nodal = faces.scatter(area[..., None] * normal, len(state.x))
        pull = np.einsum("nij,nj->i", stress.node[:, VOIGT_INDEX], nodal)
        assert np.linalg.norm(pull - force) == pytest.approx(quality["force_error"] * np.linalg.norm(force))
        assert pull[2] < 0  # tension is positive: the indenter pushes down


def test_a_checkerboard_of_pressure_is_reported_and_does_not_reach_the_nodes(pressed: Run) -> None:
    made, state = Stresses(pressed.problem), pressed.states[PRESSED]
    calm = made.at(state.x)
    centres = pressed.problem.mesh.points[pressed.problem.mesh.cells].mean(1)
    step = [np.unique(centres[:, k].round(6), return_inverse=True)[1] for k in range(3)]
    rms = float(np.sqrt(np.mean(calm.element[:, :3].mean(1) ** 2)))
    board = np.outer(3 * rms * (-1.0) ** sum(step), [1, 1, 1, 0, 0, 0])
    rows = made.recovery.matrix @ (calm.element + board)
    assert rows == pytest.approx(calm.rows, abs=1e-9 * rms)
    loud = replace(calm, element=calm.element + board, rows=rows)
    assert made.quality(calm, state)["pressure_oscillation"] < 0.25
    assert made.quality(loud, state)["pressure_oscillation"] > 1.0


def test_traction_is_forced_on_stress_by_the_least_change() -> None:
    rng = np.random.default_rng(0)
    stress, traction, n = rng.normal(size=(5, 6)), rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    found = agreeing(stress, n, traction)
    assert np.einsum("nij,nj->ni", found[:, VOIGT_INDEX], n) == pytest.approx(traction)
    across = np.eye(3) - n[:, :, None] * n[:, None]
    assert across @ (found - stress)[:, VOIGT_INDEX] @ across == pytest.approx(np.zeros((5, 3, 3)), abs=1e-12)
    assert agreeing(found, n, traction) == pytest.approx(found)


def test_gap_and_normals_of_the_dent(pressed: Run, maps: list[Maps], mini: Sensor, camera: PinholeCamera) -> None:
    """Under the ball the gap is about none and the normals are the ball's own; elsewhere they are those of a ball over
    a nearly level face."""
    state = pressed.states[PRESSED]
    view = camera_maps.View(Sheet.over(mini.gel, 0.1), pressed.face.moved(state.x), camera)
    gap, normals, z = view.gap(pressed.scene.shape, state.pose), view.normals(), view.height()
    assert np.linalg.norm(normals, axis=-1) == pytest.approx(np.ones(camera.shape))
    rows, columns = np.indices(camera.shape)
    origins, rays = camera.rays(np.stack([columns, rows], -1).reshape(-1, 2) + 0.5)
    at = (origins + rays * ((z.ravel() - origins[:, 2]) / rays[:, 2])[:, None]).reshape(*camera.shape, 3)
    middle = np.array([*PATH[PRESSED][:2], PATH[PRESSED][2] + 4.0])
    touched = maps[PRESSED].contact
    assert np.abs(gap[touched]).max() < 0.06
    assert gap == pytest.approx(np.linalg.norm(at - middle, axis=-1) - 4.0, abs=2e-3)
    inward = (middle - at) / np.linalg.norm(middle - at, axis=-1, keepdims=True)  # of the ball is outward of the gel
    inner = touched & (np.linalg.norm(at[..., :2] - middle[:2], axis=-1) < 1.2)
    assert inner.sum() > 500
    assert np.degrees(np.arccos((normals * inward).sum(-1)[inner])).max() < 4
    right = (at[..., 0] > middle[0] + 0.8) & inner
    assert (normals[right][:, 0] < -0.1).all()  # right of the ball the dent rises to the right
    flat = camera_maps.View(Sheet.over(mini.gel, 0.2), pressed.face, camera).normals()
    assert flat == pytest.approx(np.broadcast_to([0.0, 0.0, 1.0], flat.shape), abs=1e-12)


def test_a_face_in_contact_is_the_balls_own(pressed: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """A ball's dent is alike to all sides: what its slope varies by around a circle is the mesh's ripple."""
    state, shape, angles = pressed.states[PRESSED], pressed.scene.shape, np.linspace(0, 2 * np.pi, 128, endpoint=False)
    out, middle, step = np.stack([np.cos(angles), np.sin(angles)], -1), np.array(PATH[PRESSED][:2]), 0.02

    def ripple(face: gel_surface.GelSurface, radius: float) -> float:
        """Of the slope outward [deg], by its spectrum over the angle."""
        rise = face.at(middle + (radius + step) * out) - face.at(middle + (radius - step) * out)
        slope = np.degrees(np.arctan2(rise[:, 2], (rise[:, :2] * out).sum(1)))
        return float(np.sqrt(2 * (np.abs(np.fft.rfft(slope)[1:] / len(angles)) ** 2).sum()))

    smooth, plain = pressed.face.pressed(pressed.problem, state), pressed.face.moved(state.x)
    assert ripple(smooth, 0.8) < 0.15 < 0.4 < ripple(plain, 0.8)
    assert ripple(smooth, 1.9) < 0.8 * ripple(plain, 1.9)  # at the rim
    at = smooth.at(middle + np.random.default_rng(0).uniform(-0.8, 0.8, (200, 2)))
    assert np.abs(shape.distance(Pose.of(state.pose).local(at))[0]).max() < 2e-3
    assert (smooth.now == plain.now).all()
    monkeypatch.setattr(gel_surface, "MIN_RADIUS_EDGES", 10)  # what the mesh does not resolve is left as it is solved
    assert np.array_equal(pressed.face.pressed(pressed.problem, state).at(middle + out), plain.at(middle + out))


def test_sliding_cells_have_all_the_friction_there_can_be(maps: list[Maps]) -> None:
    """|t| = friction x pressure where all points slide, as nearly as friction knows the normal forces (advance.LAG)."""
    found = maps[SLID]
    full = (found.sliding > 1 - 1e-9) & (found.pressure > 0)
    assert full.sum() > 500
    off = np.abs(np.linalg.norm(found.traction, axis=-1) - COEFFICIENT * found.pressure)[full]
    assert off.max() < 1e-3 * COEFFICIENT * found.pressure.max()


def test_a_face_tells_where_it_is_touched(pressed: Run) -> None:
    """By the ball, within its contact and not far from it; at rest nowhere."""
    state, middle = pressed.states[PRESSED], np.array(PATH[PRESSED][:2])
    face = pressed.face.pressed(pressed.problem, state)
    radius = np.sqrt(pressed.problem.contact.faces.areas[state.normal_force > 0].sum() / np.pi)
    angles = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    around = np.stack([np.cos(angles), np.sin(angles)], -1)
    shares = [face.touched(middle + share * radius * around).mean() for share in (0.5, 0.8, 1.0, 1.2, 1.5)]
    assert shares[0] == pytest.approx(1, abs=0.02)
    assert shares[-1] == pytest.approx(0, abs=0.02)
    assert (np.diff(shares) <= 1e-9).all()
    assert 0.2 < shares[2] < 0.8
    assert not pressed.face.touched(middle + 0.5 * radius * around).any()


BALL, CONTACT, EDGE = 4.0, 1.8, 0.6


def hertz(r: Array) -> Array:
    """Gap (n,) [mm] under a ball at radii r (n,) [mm]; Johnson 1985, equation 3.42a."""
    share = CONTACT / np.maximum(r, CONTACT)
    deep = (2 - 1 / share**2) * np.arcsin(share) + np.sqrt(1 - share**2) / share
    return CONTACT**2 / BALL * (deep / np.pi - 1) + np.maximum(r, CONTACT) ** 2 / (2 * BALL)


def grid(shift: tuple[float, float] = (0.11, 0.23)) -> Array:
    line = np.arange(-5, 5.01, EDGE)
    return np.stack(np.meshgrid(line, line), -1).reshape(-1, 2) + shift


def test_between_coarse_nodes_the_gap_is_hertzs() -> None:
    at, random = grid(), np.random.default_rng(0)
    radius, angle = random.uniform(0.5, CONTACT + EDGE, 500), random.uniform(0, 2 * np.pi, 500)
    between, r = np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1), np.linalg.norm(at, axis=1)
    found = contact_rim.openings(at, hertz(r), r <= CONTACT, EDGE)
    assert found is not None
    smooth = CloughTocher(at)
    opening, weight = smooth.at(between, smooth.nodal(found)).T
    plain = smooth.at(between, smooth.nodal(hertz(r)[:, None]))[:, 0]
    off, before = (np.sqrt(np.mean((gap - hertz(radius)) ** 2)) for gap in (contact_rim.gaps(opening), plain))
    assert weight.min() > 0.85
    assert off < 2e-3 < 4e-3 < before  # [mm]
    assert (contact_rim.gaps(opening)[radius < 0.9 * CONTACT] == 0).all()


def test_noise_of_the_nodes_is_smoothed() -> None:
    at, random = grid(), np.random.default_rng(0)
    r = np.linalg.norm(at, axis=1)
    off = []
    for gap in (hertz(r), hertz(r) + random.normal(0, 0.005, len(r))):
        found = contact_rim.openings(at, gap, r <= CONTACT, EDGE)
        assert found is not None
        beside = (r > CONTACT) & (r < CONTACT + EDGE)
        off.append(np.sqrt(np.mean((contact_rim.gaps(found[beside, 0]) - hertz(r[beside])) ** 2)))
    assert off[0] < 0.002
    assert off[1] < 0.0045


def test_far_from_the_contact_nothing_is_changed() -> None:
    at, r = grid(), np.linalg.norm(grid(), axis=1)
    found = contact_rim.openings(at, hertz(r), r <= CONTACT, EDGE)
    assert found is not None
    assert (found[r > CONTACT + contact_rim.MAX_OPENING_EDGES * EDGE, 1] == 0).all()


@pytest.mark.parametrize("closed", [np.zeros(289, bool), np.ones(289, bool)])
def test_without_a_rim_there_is_no_opening(closed: Array) -> None:
    assert contact_rim.openings(grid(), np.ones(289), closed, EDGE) is None


def test_the_rim_of_a_coarse_mesh_is_that_of_a_finer_one() -> None:
    """Normals in a ring about the rim of a ball's dent, against those of the same nodes without the indenter."""
    line = np.linspace(-2, 2, 81)
    middle = np.array([0.2, 0.1])
    at = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2) + middle
    ring = np.abs(np.hypot(*(at - middle).T) - 1.4) < 0.5

    def normals(edge: float, *, plain: bool = False) -> Array:
        pressed = run(scene(SphereSdf(4.0), poses([(0.2, 0.1, -0.4)]), pad=gel(6.5, 6.5, 2.5), edge=edge))
        (state,) = pressed.states
        face = pressed.face.moved(state.x) if plain else pressed.face.pressed(pressed.problem, state)
        normals = np.cross(*(face.at(at + by) - face.at(at - by) for by in np.eye(2) * 0.05))
        return (normals / np.linalg.norm(normals, axis=1, keepdims=True))[ring]

    oracle, found, before = normals(0.3), normals(EDGE), normals(EDGE, plain=True)
    off, was = (np.degrees(np.sqrt(((one - oracle) ** 2).sum(1).mean())) for one in (found, before))
    assert off < 0.75 * was
