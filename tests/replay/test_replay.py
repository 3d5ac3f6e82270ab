"""`tacgen replay`: a log goes through selection, recipe, run and comparison, and its forces' error is found."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.command import refused, told
from helpers.small_recipe import BALL
from scipy.spatial.transform import Rotation

from tacgen import replay
from tacgen.base.errors import UserError
from tacgen.batch import pipeline
from tacgen.bundle.bundle import read
from tacgen.geometry import mesh_file, mesh_import
from tacgen.recipe import plan, scene_of_row
from tacgen.recipe.indenters import Box, Mesh
from tacgen.recipe.trajectory import Placement
from tacgen.replay import comparison, selection
from tacgen.replay.contact_log import ContactLog, Conventions

Array = np.ndarray
QUALITY = "quality: {edge_mm: 1.0, dhat_mm: 0.1}\noutputs: [force, traction]\ncontact: {friction: 0.5}\n"
MOVES = """trajectory:
  - press: {depth_mm: 0.5, frames: 2}
  - slide: {x_mm: 0.4, y_mm: 0.2, frames: 2}
"""
MOUNT = Placement(position_mm=(3.0, -2.0, 24.0), quaternion=(0.5, 0.5, 0.5, 0.5))
ERROR = 1.2  # of the simulator's forces over tacgen's, in the logs below [-]


def matrices(positions: Array, turns: Rotation) -> Array:
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, :3, 3], poses[:, :3, :3] = positions, turns.as_matrix()
    return poses


def matrix(placed: Placement) -> Array:
    return matrices(np.array([placed.position_mm]), Rotation.from_quat([placed.quaternion], scalar_first=True))[0]


class World:
    """A ball pressed and slid by tacgen, as a simulator with a moving sensor would have recorded it."""

    def __init__(self, folder: Path) -> None:
        (folder / "moves.yaml").write_text(BALL + QUALITY + MOVES + "uncertainty: {mesh: true}\n")
        bundle = read(pipeline.run_scene(plan.load(folder / "moves.yaml").rows[0], folder / "moves").path)
        self.force, self.std = bundle["/frames/force"], bundle["/frames/uncertainty/force"]
        self.pose = bundle["/frames/pose"]
        away = np.tile(np.eye(4), (3, 1, 1))
        away[:, :3, 3] = [[0, 0, 30], [0, 0, 5], [0, 0, 0.4]]  # the ball comes down to the gel, the last row near it
        relative = np.concatenate([away, self.pose])
        self.count = len(relative)
        rng = np.random.default_rng(4)
        self.sensor = matrices(rng.normal(size=(self.count, 3)) * 200, Rotation.random(self.count, rng=rng))
        centre = np.eye(4)
        centre[2, 3] = 4.0
        self.face = self.sensor @ matrix(MOUNT)
        self.ball = self.face @ relative @ centre
        self.torque = bundle["/frames/torque"]
        self.world_force, torque = (
            np.einsum("nij,nj->ni", self.face[:, :3, :3], np.concatenate([np.zeros((3, 3)), ERROR * load]))
            for load in (self.force, self.torque)
        )
        self.world_torque = torque + np.cross(self.face[:, :3, 3] - self.sensor[:, :3, 3], self.world_force)

    def save(self, path: Path) -> Path:
        """The log, in m and with quaternions x y z w."""
        np.savez(
            path,
            time=0.1 * np.arange(self.count),
            object_position=self.ball[:, :3, 3] / 1000,
            object_quaternion=Rotation.from_matrix(self.ball[:, :3, :3]).as_quat(),
            sensor_position=self.sensor[:, :3, 3] / 1000,
            sensor_quaternion=Rotation.from_matrix(self.sensor[:, :3, :3]).as_quat(),
            force=self.world_force,
            torque=self.world_torque / 1000,
        )
        return path

    def first_rows(self, start: float = 0.0, name: str = "log", *, force: bool = False) -> ContactLog:
        """Two rows, from a time on, with the simulator's forces or without."""
        steps = np.arange(2)
        forces = self.world_force[:2] if force else None
        return ContactLog(name, steps, start + 0.1 * steps, self.ball[:2], self.sensor[:2], forces, True)


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> World:
    return World(tmp_path_factory.mktemp("world"))


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    """A recipe as a user of another simulator writes it."""
    path = tmp_path / "base.yaml"
    mount = json.dumps(MOUNT.model_dump(mode="json"))
    path.write_text(f"{BALL}{QUALITY}trajectory:\n  - replay: {{file: log.npz, sensor_pose: {mount}}}\n")
    return path


def words(log: Path, recipe: Path, out: Path, *more: str) -> tuple[object, ...]:
    return ("replay", log, "--recipe", recipe, "-o", out, "--quaternion", "xyzw", "--units", "m", *more)


@pytest.mark.slow
def test_the_error_of_a_simulator_is_found_to_rounding(world: World, recipe: Path, tmp_path: Path) -> None:
    """Sensor and ball move in the world, and the simulator's forces are 1.2 times tacgen's."""
    log, out = world.save(tmp_path / "log.npz"), tmp_path / "out"
    (found,) = json.loads(told(*words(log, recipe, out, "--json")))["logs"]
    assert (found["frames"], found["in_contact"]) == (5, 4)
    assert found["normal"]["ours_n"] == pytest.approx(-world.force[:, 2].min(), rel=1e-3)
    assert found["normal"]["theirs_n"] / found["normal"]["ours_n"] == pytest.approx(ERROR, rel=1e-3)
    assert found["normal"]["relative"] == pytest.approx(ERROR - 1, abs=2e-3)
    assert found["tangential"]["relative"] == pytest.approx(ERROR - 1, abs=2e-3)
    size = np.linalg.norm(world.torque, axis=1).max()
    assert found["torque"]["ours_nmm"] == pytest.approx(size, rel=1e-3)
    assert found["torque"]["relative"] == pytest.approx(ERROR - 1, abs=2e-3)
    with (out / "forces.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["row"]) for row in rows] == [2, 3, 4, 5, 6]
    for column, wanted in (("force", world.force), ("simulator", ERROR * world.force), ("std", world.std)):
        read_back = [[float(row[f"{column}_{axis}_n"]) for axis in "xyz"] for row in rows[1:]]
        assert np.array(read_back) == pytest.approx(wanted, abs=2e-3), column
    turned = [[float(row[f"simulator_torque_{axis}_nmm"]) for axis in "xyz"] for row in rows[1:]]
    assert np.array(turned) == pytest.approx(ERROR * world.torque, abs=2e-3 * size)
    assert (out / "forces.png").stat().st_size > 10_000
    assert "torque about the sensor's origin [N mm]" in (out / "forces.txt").read_text()
    assert "normal force [N]" in (out / "forces.txt").read_text()
    told(*words(log, recipe, out))  # the second time the bundle is kept
    told("validate", out / "recipe.yaml")


def test_rows_are_chosen(world: World, recipe: Path, tmp_path: Path) -> None:
    log, how = world.save(tmp_path / "log.npz"), Conventions("tacgen", "xyzw", "m")

    def rows(folder: str, **choice: float) -> list[int]:
        chosen = replay.Choice(**choice)
        return replay.prepare([log], str(recipe), tmp_path / folder, how, chosen).logs[0].row.tolist()

    assert rows("one") == [2, 3, 4, 5, 6]
    assert rows("two", every=2) == [2, 4, 6]
    assert rows("three", near_mm=6) == [1, 2, 3, 4, 5, 6]
    assert rows("four", first=4, last=5) == [4, 5]
    with pytest.raises(UserError, match="log: has 7 rows, and none of those that --rows names"):
        rows("five", first=9)


def test_an_object_that_is_lifted_between_contacts_is_not_dragged_through_them() -> None:
    """Thinned out, each contact still ends with the row that left it, also where the next row is far away."""
    gaps = np.array([9, 0.5, -1, -2, -1, 0.4, 9, 9, 9, -1, -2, -1, 9, 9, 0.9, 9.0])
    found = selection.runs(gaps <= 1, gaps <= 0, 1)
    assert found.tolist() == [1, 2, 3, 4, 5, 8, 9, 10, 11, 12, 14]
    assert selection.runs(gaps <= 1, gaps <= 0, 3).tolist() == [1, 4, 5, 8, 11, 12, 14]
    assert selection.runs(gaps <= 1, gaps <= 0, 99).tolist() == [1, 5, 8, 12, 14]
    assert selection.runs(np.full(3, True), np.full(3, True), 2).tolist() == [0, 2]


def test_a_log_without_contact_is_told_in_a_line(world: World, recipe: Path, tmp_path: Path) -> None:
    log = world.save(tmp_path / "log.npz")
    assert refused(*words(log, recipe, tmp_path / "out", "--rows", ":1")).splitlines() == [
        "log: no contact: closest approach 5 mm, in row 1: check units, sensor_pose and indenter_pose"
    ]
    wrong = ("--set", "trajectory[0].replay.sensor_pose.position_mm=[3, -2, -24]")
    said = refused(*words(log, recipe, tmp_path / "out", *wrong))
    assert "log: no contact, though its simulator has up to" in said


def test_several_logs_are_scenes(world: World, recipe: Path, tmp_path: Path) -> None:
    logs = [world.save(tmp_path / f"{name}.npz") for name in ("a", "b")]
    how = Conventions("tacgen", "xyzw", "m")
    made = replay.prepare(logs, str(recipe), tmp_path / "out", how, replay.Choice())
    assert [log.name for log in made.logs] == ["a", "b"]
    planned = plan.load(made.recipe)
    assert planned.frames.tolist() == [5, 5]
    assert [row.values for row in planned.rows] == [{"trajectory[0].replay.file": f"log-0000{k}.csv"} for k in range(2)]
    assert planned.rows[0].recipe.uncertainty is not None


def test_recipes_that_no_log_fits(world: World, recipe: Path, tmp_path: Path) -> None:
    log = world.save(tmp_path / "log.npz")
    varied = "vary={method: random, samples: 2, over: {contact.friction: {uniform: [0, 1]}}}"
    box = "indenter={shape: box, size_x_mm: 4, size_y_mm: 4}"
    for option, value, says in (
        ("--set", varied, "vary: a log is of one sensor"),
        ("--set", box, "indenter: where is the box in the recorded body?"),
        ("--set", "trajectory[0].replay.sensor_pose.position_mm=[1]", "sensor_pose.position_mm"),
        ("--rows", "3-4", "--rows 3-4: must be FIRST:LAST"),
        ("--near-mm", "0", "--near-mm 0: must be more than 0"),
    ):
        assert says in refused(*words(log, recipe, tmp_path / "out", option, value))


def test_a_mesh_is_where_its_file_was_recorded(tmp_path: Path) -> None:
    """Its indenter has the axis up that pointed away from the gel, and stands where the simulator had it."""
    file, aside = tmp_path / "thing.stl", trimesh.transformations.translation_matrix((0.01, 0.05, 0.002))
    trimesh.creation.box((0.02, 0.008, 0.006), aside).export(file)
    shape = Mesh(file=str(file), scale=1000)
    for axis, name in ((np.array([0, -1, 0]), "-y"), (np.array([1, 0, 0]), "+x")):
        turn, _ = Rotation.align_vectors([[0, 0, 1]], [axis])  # the body's axis points away from the gel
        turns = (Rotation.from_rotvec([0.1, 0.2, 0.3]) * turn).as_matrix()[None]
        body = selection.body_of(shape, None, turns)
        assert body.indenter.up == name
        placed = mesh_import.placed(mesh_file.read(file), up=name, scale=1000.0).vertices
        inner = matrix(body.pose)
        there = placed @ inner[:3, :3].T + inner[:3, 3]
        assert np.sort(there, 0) == pytest.approx(np.sort(mesh_file.read(file).vertices * 1000, 0))
        assert body.distance(placed.mean(0)[None]) == pytest.approx(-3.0)
        assert body.lowest(np.eye(4)) == pytest.approx(0.0)


def test_nearness_never_leaves_a_touching_row_out() -> None:
    """A point between those at which distances are looked at."""
    gel = scene_of_row.gel_of(plan.load(Path("recipes/quickstart.yaml")).rows[0].sensor)
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, 3] = [[0.5, 0.5, -0.05], [0.5, 0.5, 2.0], [30.0, 0.0, -1.0]]  # in it, above it, beside it
    thin = Box(size_x_mm=0.1, size_y_mm=0.1, fillet_mm=0.05)
    body = selection.body_of(thin, Placement(), poses[:, :3, :3])
    gaps = selection.gaps(body, gel, poses, 0.1)
    assert (gaps <= 0.1 + selection.MAX_FACE_POINT_DISTANCE_MM).tolist() == [True, False, False]
    assert selection.least(body, gel, gaps[0], poses[0]) == pytest.approx(-0.05, abs=0.01)
    assert selection.least(body, gel, gaps[1], poses[1]) == pytest.approx(2.0)


def test_the_text_says_where_the_largest_force_is_and_how_far_off(world: World) -> None:
    log = world.first_rows(name="press", force=True)
    ours, std = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, -2.0]]), np.full((2, 3), 0.05)
    found = comparison.Compared(log, "scene-00000", "", ours, 0 * ours, std, 1.5 * ours)
    lines = [" ".join(line.split()) for line in comparison.text([found]).splitlines()]
    assert lines[2] == "press 2 2 2 +- 0.05 3 +50.0 % 0.791 50.0 %"
    assert lines[5] == "press < 0.001 < 0.001 - < 0.001 -"
    assert lines[-1] == "1 0.1 0.000 0.000 -2.000 0.050 0.050 0.050 0.000 0.000 -3.000 0.000 0.000 -1.000"
    smooth = replace(found, log=replace(log, friction=False))
    assert "theirs_n" not in smooth.summary()["tangential"]  # of normal forces alone


def test_a_log_without_forces_has_tacgens_alone(world: World, tmp_path: Path) -> None:
    ours = world.force[:2]
    found = comparison.Compared(world.first_rows(), "scene-00000", "", ours, 0 * ours, None, None)
    assert "theirs_n" not in found.summary()["normal"]
    (first, *_) = csv.DictReader(comparison.table([found]).splitlines())
    assert first["simulator_z_n"] == first["error_z_n"] == first["std_z_n"] == ""
    assert float(first["force_z_n"]) == pytest.approx(world.force[0, 2], rel=1e-5)
    comparison.write([found], tmp_path)


def test_times_in_seconds_since_1970_stay_distinct(world: World) -> None:
    ours = world.force[:2]
    found = comparison.Compared(world.first_rows(1.7e9), "scene-00000", "", ours, 0 * ours, None, None)
    times = [row["time_s"] for row in csv.DictReader(comparison.table([found]).splitlines())]
    assert times == ["1700000000", "1700000000.1"]
    assert comparison.text([found]).splitlines()[-1].split()[:2] == ["1", "1700000000.1"]
