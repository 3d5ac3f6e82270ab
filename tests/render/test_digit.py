"""DIGIT: a round end, a dome, and all that must follow them: mesh, first touch, maps, limits."""

import numpy as np
import pytest
from helpers import small_recipe
from helpers.presses import Run, run

from benchmarks import photographs
from tacgen.base.errors import UserError
from tacgen.fem.elements import elements, facet_areas
from tacgen.fem.mesh_quality import scaled_jacobian
from tacgen.geometry.gel import GelBody
from tacgen.geometry.pose import Pose
from tacgen.mechanics import mesh
from tacgen.recipe import assets, loading, scene_of_row, trajectory_checks
from tacgen.recipe.row import Row
from tacgen.sensor.model import Sensor

Array = np.ndarray
TABLE = photographs.reference() / "geometry"
OFF = ("start={x_mm: 4, y_mm: 0}",)
FINE = {(): 2.6046, OFF: 2.6799}  # [N] on meshes of 0.2 mm edge (about 18 000 nodes), dhat 0.02 mm


def row_of(sets: tuple[str, ...]) -> Row:
    return small_recipe.row("press: {depth_mm: 1, frames: 4}", "sensor=digit", "quality=default", *sets)


def solved(sets: tuple[str, ...]) -> Run:
    return run(scene_of_row.build(row_of(sets)))


@pytest.fixture(scope="module")
def digit() -> Sensor:
    return loading.read_sensor(assets.sensor_path("digit"))[0]


@pytest.fixture(scope="module")
def pressed() -> Run:
    """Off the crown."""
    return solved(OFF)


def test_the_dome_is_the_probed_one(digit: Sensor) -> None:
    table = TABLE / "digit_surface_probe.csv"
    if not table.exists():
        pytest.skip(f"{table} is not here")
    x, y, depth = np.loadtxt(table, delimiter=",", comments="#")[:, :3].T
    drop = np.array([digit.gel.drop_mm(a, b) for a, b in zip(x - x.max() / 2, y - y.max() / 2, strict=True)])
    off = depth - drop - np.median(depth - drop)
    assert np.abs(off).max() < 0.02
    assert np.ptp(depth) > 1.0


def test_the_outline_has_one_round_end(digit: Sensor) -> None:
    gel = scene_of_row.gel_of(digit)
    r, half = 18.35 / 2, 25.05 / 2
    assert gel.contains(np.array([0.0, 9.1, 9.1, 6.5]), np.array([-12.5, 12.5, -3.4, -9.8])).all()
    assert not gel.contains(np.array([0.0, 9.1, 9.1, 6.6, 0]), np.array([-12.6, 12.6, -6, -9.9, 12.6])).any()
    x, y = np.random.default_rng(0).uniform([-10, -13], [10, 13], (500, 2)).T
    inside = gel.contains(x, y)
    assert [trajectory_checks.on_pad(digit.gel, a, b) for a, b in zip(x, y, strict=True)] == inside.tolist()
    grid = mesh.build(gel, (-12, 12, -14, 14), 0.4)
    area = facet_areas(grid.points, grid.facets["bonded"])[0].sum()
    assert area == pytest.approx(18.35 * (2 * half - r) + np.pi * r**2 / 2, rel=5e-3)


@pytest.mark.slow
def test_columns_are_squeezed_under_the_dome_and_no_cell_is_bad(pressed: Run) -> None:
    grid, gel = pressed.problem.mesh, pressed.scene.gel
    assert len(grid.points) < 8000
    x = grid.points
    face = x[np.unique(grid.facets["coated"])]
    assert face[:, 2] == pytest.approx(gel.top(*face[:, :2].T), abs=1e-12)
    assert face[:, 2].min() < -1.2
    assert x[np.unique(grid.facets["bonded"]), 2] == pytest.approx(-4.06)
    assert elements(x, grid.cells).weights.min() > 0
    assert scaled_jacobian(x, grid.cells).min() > 0.9


def test_layers_share_the_squeeze() -> None:
    flat = scene_of_row.gel_of(loading.read_sensor(assets.sensor_path("ninedtact"))[0])
    gel = GelBody(flat.width, flat.height, layers=flat.layers, radii=(40.0, 90.0))
    grid = mesh.build(gel, (-2, 2, -2, 2), 0.6)
    shared = np.intersect1d(grid.cells[grid.layer == 0], grid.cells[grid.layer == 1])
    top = gel.top(*grid.points[shared, :2].T)
    assert grid.points[shared, 2] == pytest.approx(-2.8 + (2.8 + top) * 2.5 / 2.8)
    assert not np.signbit(flat.top(np.zeros(2), np.array([-3.0, 3.0]))).any()  # a flat face stays at z = 0, bit by bit


@pytest.mark.slow
@pytest.mark.parametrize("sets", FINE)
def test_force_of_a_press_at_default_quality(sets: tuple[str, ...], pressed: Run) -> None:
    found = pressed if sets == OFF else solved(sets)
    assert -found.forces[-1, 2] == pytest.approx(FINE[sets], rel=0.015)
    if sets == OFF:
        assert found.forces[-1, 0] < -0.02 * -found.forces[-1, 2]  # the slope there pushes the gel back to the middle
    else:
        assert np.abs(found.forces[-1, :2]).max() < 1e-3


@pytest.mark.parametrize(
    ("sets", "z"),
    [
        ((), 0.0),
        (OFF, -(4.0**2) / (2 * 32.05 + 8)),  # parabola on parabola; the ball's is a circle
        (("start={x_mm: 0, y_mm: -8, clearance_mm: 0.3}",), 0.3 - 8.0**2 / (2 * 72.31 + 8)),
        (("start={x_mm: 4}", "indenter={shape: cylinder, radius_mm: 2}"), -(2.2**2) / 64.1 + 0.0005),
        (("start={x_mm: 4}", "indenter={shape: cone, half_angle_deg: 30, tip_radius_mm: 0.05}"), -(4.0**2) / 64.2),
    ],
)
def test_depth_counts_from_where_the_dome_is_met(sets: tuple[str, ...], z: float) -> None:
    row = row_of(sets)
    made = scene_of_row.build(row)
    clearance = row.recipe.start.clearance_mm
    assert made.start[2, 3] == pytest.approx(z, abs=1e-3)
    assert made.poses[-1][2, 3] == pytest.approx(made.start[2, 3] - clearance - 1.0)
    x, y = np.meshgrid(np.linspace(-9, 9, 721), np.linspace(-9, 9, 721))
    face = np.column_stack([x.ravel(), y.ravel(), made.gel.top(x, y).ravel() + clearance])
    gap = made.shape.distance(Pose.of(made.start).local(face))[0].min()
    assert -1e-5 < gap < 5e-4  # this grid misses the place a little


@pytest.mark.parametrize(
    ("sets", "says"),
    [
        (("start={x_mm: 8}", "trajectory[0].press.depth_mm=3.3"), "must be less than the gel is thick, 3.06156 mm"),
        (("start={x_mm: 8, y_mm: -9}",), "the indenter would start beside the pad"),
        (("sensor.gel.dome.radius_x_mm=10",), "gel.dome: leaves -0.287 mm of gel at the pad's corner"),
        (("sensor.gel.corner_radius_mm=1",), "gel.corner_radius_mm: must be 0 beside an outline with"),
        (("outputs=[rgb, markers]",), "outputs: asks for markers, and the sensor digit has none"),
    ],
)
def test_what_a_dome_forbids(sets: tuple[str, ...], says: str) -> None:
    with pytest.raises(UserError) as caught:
        row_of(sets)
    assert any(says in line for line in caught.value.lines), caught.value.lines
