"""Forces of a table are met where rigid bodies had them at other depths, what cannot be is told, and grasps follow."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tacgen import mechanics
from tacgen.batch import pipeline
from tacgen.bundle import bundle, frame_notes
from tacgen.bundle.bundle import Bundle, read
from tacgen.bundle.check import check
from tacgen.geometry.pose import about
from tacgen.mechanics import mesh
from tacgen.mechanics.frames import normal_force
from tacgen.recipe import plan, scene_of_row

Array = np.ndarray
HEAD = """
tacgen: 1
name: matched
sensor: gelsight_mini
outputs: [force]
"""
PRESS = f"""{HEAD}
indenter: {{shape: sphere, radius_mm: 4}}
contact: {{friction: 0.5}}
quality: {{edge_mm: 0.8, dhat_mm: 0.05}}
"""
WAY = [(0.0, 0.1), (0.0, -0.2), (0.0, -0.4), (0.3, -0.6), (0.6, -0.3), (0.6, 0.1)]  # x, z of the rows [mm]
MASS, WEIGHT = 0.05, 0.05 * 9.80665  # [kg], [N]


def press(folder: Path, way: list[tuple[float, float]], forces: Array | None = None) -> plan.Plan:
    """A replay of these x and z; with forces to meet, where there are any."""
    titles, match = "time_s,x_mm,y_mm,z_mm,qw,qx,qy,qz", ""
    rows = [f"{t},{x!r},0,{z!r},1,0,0,0" for t, (x, z) in enumerate(way)]
    if forces is not None:
        titles, match = f"{titles},force_x_n,force_y_n,force_z_n", ", match: force, filter_rows: 1"
        rows = [f"{row},0,0,{-force!r}" for row, force in zip(rows, forces.tolist(), strict=True)]
    (folder / "way.csv").write_text("\n".join([titles, *rows]))
    (folder / "press.yaml").write_text(f"{PRESS}trajectory: [replay: {{file: way.csv{match}}}]\n")
    return plan.load(folder / "press.yaml")


@pytest.fixture(scope="module")
def truth(tmp_path_factory: pytest.TempPathFactory) -> Array:
    """Normal forces [N] of the plain replay."""
    scene = scene_of_row.build(press(tmp_path_factory.mktemp("truth"), WAY).rows[0])
    found = mechanics.states(scene, mechanics.Problem.of(scene, mesh.of(scene)))
    return np.array([normal_force(state) for state in found])


@pytest.mark.parametrize("off", [0.2, -0.3])
def test_forces_are_met_and_the_corrections_are_what_the_table_is_off_by(
    off: float, truth: Array, tmp_path: Path
) -> None:
    made = press(tmp_path, [(x, z + off) for x, z in WAY], truth)
    assert pipeline.run_scene(made.rows[0], tmp_path / "out").status == "ok"
    found = read(tmp_path / "out/scene-00000.h5")
    assert found["/frames/match/reached_force"] == pytest.approx(truth, rel=0.01)
    assert found["/frames/match/asked_force"] == pytest.approx(truth)
    assert -found["/frames/force"][:, 2] == pytest.approx(found["/frames/match/reached_force"], abs=1e-12)
    correction, touching = found["/frames/match/correction_mm"], truth > 0
    assert correction[touching] == pytest.approx(-off, abs=2e-3)
    assert correction[~touching] == pytest.approx(max(-off - 0.1, 0.0))  # to first touch, or not at all
    assert found["/frames/match/met"].all()
    assert check(tmp_path / "out") == []


@pytest.mark.slow
def test_a_row_that_cannot_be_reached_says_why_and_the_scene_goes_on(tmp_path: Path) -> None:
    forces = np.array([0.5, 200.0, 0.4, np.nan, 1.0, 0.3])
    way = [(0.0, -0.2), (0.0, -0.5), (0.0, 5.0), (0.2, 4.9), (60.0, -0.2), (0.0, -30.0)]
    assert pipeline.run_scene(press(tmp_path, way, forces).rows[0], tmp_path / "out").status == "ok"
    found = read(tmp_path / "out/scene-00000.h5")
    reached, said = found["/frames/match/reached_force"], frame_notes.of(found)
    assert reached[[0, 2, 5]] == pytest.approx(forces[[0, 2, 5]], rel=0.01)
    assert [bool(note) for note in said] == (~found["/frames/match/met"]).tolist() == [0, 1, 0, 1, 1, 0]
    assert said[1].startswith("200 N asked for, and 80% of the gel's thickness gives ")
    assert reached[1] == pytest.approx(float(said[1].split()[-2]), rel=0.01)
    assert said[3].startswith("the table has no force here")
    correction = found["/frames/match/correction_mm"]
    assert correction[3] == pytest.approx(correction[2], abs=1e-9)
    assert said[4].startswith("nothing of the indenter is over the gel")
    assert reached[4] == 0
    (note,) = check(tmp_path / "out")
    assert (note.level, "3 of 6 frames are not as the table asks" in note.message) == ("note", True)


def test_a_bundle_whose_force_is_not_the_asked_one_is_found_out(tmp_path: Path, truth: Array) -> None:
    pipeline.run_scene(press(tmp_path, WAY[:3], truth[:3]).rows[0], tmp_path / "out")
    path = tmp_path / "out/scene-00000.h5"
    first = read(path)
    for name, value, said in (
        ("asked_force", 0.7, "the force is not the one that the table asks for: off by"),
        ("met", False, "no note says why it is not met"),
    ):
        changed = tmp_path / f"{name}.h5"
        with bundle.Writer(changed, _attributes(first), first.frames) as writer:
            for key in first.shapes:
                if not key.startswith(("/frames/", "/fields/")):
                    writer.put(key, first[key])
            for k in range(first.frames):
                values = {key: first[key][k] for key in first.shapes if key.startswith("/frames/")}
                writer.append(values | {f"/frames/match/{name}": np.array(value)})
            writer.finish()
        assert said in "\n".join(finding.message for finding in check(changed))


def _attributes(found: Bundle) -> dict[str, object]:
    made = {"tacgen_format", "tacgen_version", "units", "frames_planned", "status", "reason", "digest", "complete"}
    plain = {key: value for key, value in found.attrs.items() if key not in made}
    structured = ("recipe", "sensor_document", "mesh", "values", "notes")
    return {key: json.loads(value) if key in structured else value for key, value in plain.items()}


# -- grasps --

AXES = np.eye(3)
# of each row: height [mm], rotation vector [rad], grip [N], width [mm]
X, Y, STILL = AXES[0], AXES[1], np.zeros(3)
ROWS = [
    *((0, STILL, "0", "12"), (0, STILL, "1", ""), (0, STILL, "2", ""), (3, STILL, "2", "")),
    *((6, 0.7 * X, "2", ""), (6, 1.4 * X, "2", ""), (6, 0.8 * Y, "2", ""), (6, 1.4 * Y, "2", "")),
    *((0, STILL, "2", ""), (0, STILL, "0", "14"), (30, 0.5 * Y, "0", "14")),
]


@pytest.fixture(scope="module")
def followed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Bundle]]:
    """Both bundles of a ball that a gripper takes, lifts, turns, puts down and leaves, in a world turned by 30 degrees;
    the object's poses in the table are as if it was glued to the gripper."""
    folder = tmp_path_factory.mktemp("followed")
    world, place, lines = about(AXES[2], np.pi / 6), np.array([300.0, 100.0, 20.0]), []
    for t, (height, turn, grip, width) in enumerate(ROWS):
        R = world @ about(turn, 1.0)
        at = place + (5.0 + height) * AXES[2]
        turned = Rotation.from_matrix(R).as_quat(scalar_first=True)
        poses = [",".join(map(repr, map(float, (*p, *turned)))) for p in (at, at - 5 * R[:, 2])]
        lines.append(f"{t},{poses[0]},{grip},{width},{poses[1]}")
    titles = [f"{name}x_mm,{name}y_mm,{name}z_mm,{name}qw,{name}qx,{name}qy,{name}qz" for name in ("", "object_")]
    (folder / "grip.csv").write_text("\n".join([f"time_s,{titles[0]},grip_n,width_mm,{titles[1]}", *lines]))
    (folder / "grip.yaml").write_text(
        f"""{HEAD}
indenter: {{shape: sphere, radius_mm: 5}}
grasp: {{mass_kg: {MASS}}}
contact: {{friction: 0.6}}
quality: {{edge_mm: 1.0, dhat_mm: 0.1}}
trajectory: [replay: {{file: grip.csv, match: grip}}]
"""
    )
    result = pipeline.run_scene(plan.load(folder / "grip.yaml").rows[0], folder / "out")
    assert result.status == "ok", result.reason
    return folder / "out", [read(folder / f"out/scene-00000-{side}.h5") for side in "LR"]


@pytest.mark.slow
def test_fingers_bear_the_weight_whatever_way_the_gripper_is_turned(followed: tuple[Path, list[Bundle]]) -> None:
    out, fingers = followed
    held = fingers[0]["/frames/grasp/mode"] == 1
    assert held.tolist() == [False] * 3 + [True] * 5 + [False] * 3
    turns = [b["/frames/grasp/sensor"][:, :3, :3] for b in fingers]
    total = sum(-(turn @ b["/frames/force"][..., None])[..., 0] for turn, b in zip(turns, fingers, strict=True))
    assert total[held] == pytest.approx(np.tile([0, 0, WEIGHT], (5, 1)), abs=0.02 * WEIGHT)
    assert fingers[0]["/frames/match/borne"][held] == pytest.approx(WEIGHT, rel=0.02)
    assert check(out) == []


@pytest.mark.slow
def test_the_grip_is_the_tables_within_its_expected_error(followed: tuple[Path, list[Bundle]]) -> None:
    for b in followed[1]:
        asked, gripped = b["/frames/match/asked_force"], np.array([float(grip) > 0 for *_, grip, _ in ROWS])
        assert asked == pytest.approx([float(grip) for *_, grip, _ in ROWS])
        error = b["/frames/quality/expected_force_error"][gripped]
        off = np.abs(b["/frames/match/reached_force"] / np.where(gripped, asked, 1) - 1)[gripped]
        assert (off < np.minimum(error, 0.01)).all()
        assert b["/frames/match/met"].all()


@pytest.mark.slow
def test_what_the_gels_yield_is_the_correction_and_what_is_let_go_stays(followed: tuple[Path, list[Bundle]]) -> None:
    left, right = followed[1]
    for b in (left, right):
        shift, sensor = b["/frames/match/shift"], b["/frames/grasp/sensor"][:, :3, :3]
        assert shift[:, 2] == pytest.approx(b["/frames/match/correction_mm"])
        fell = (sensor @ shift[..., None])[..., 0]
        assert (fell[3:8, 2] < -0.02).all()  # it hangs lower than if it was glued, whichever way is down
        assert np.abs(fell[:3]).max() < 0.01
        assert b["/frames/match/turn_deg"][:9] == pytest.approx(0, abs=1)
    put, left_there, away = left["/frames/grasp/object"][8:, :3, 3]
    assert left_there == pytest.approx(put, abs=0.05)
    assert away == pytest.approx(left_there, abs=1e-6)  # the gripper goes without it
    assert left["/frames/grasp/width_mm"][9:] == pytest.approx(14)
