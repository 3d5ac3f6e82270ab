"""Joint states through models: poses, surfaces and contact forces, against MuJoCo and against what is known by hand."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from helpers.command import tacgen_
from helpers.needs import needs

from tacgen.base.errors import UserError
from tacgen.geometry import mesh_file, mesh_import
from tacgen.recipe import indenters
from tacgen.touch import kinematics, surfaces
from tacgen.touch.kinematics import States
from tacgen.touch.sources import open_source

mujoco = needs("mujoco")

PARTS = {
    "ball": '<geom type="sphere" size="0.01" pos="0.001 0.002 0.003"/>',
    "rod": '<geom type="cylinder" size="0.01 0.02" pos="0.001 0 0" quat="0.5 0.5 0.5 0.5"/>',
    "pill": '<geom type="capsule" size="0.01 0.02" quat="1 2 3 4"/>',
    "block": '<geom type="box" size="0.01 0.015 0.02" pos="0 0.003 0" quat="1 0.2 0 0"/>',
    "egg": '<geom type="ellipsoid" size="0.01 0.015 0.02"/>',
    "bolt": '<geom type="mesh" mesh="bolt"/>',
    "two": '<geom type="cylinder" size="0.012 0.02"/><geom type="box" size="0.006 0.007 0.02" pos="0 0 0.02"/>',
}
# a block of 0.1 kg on a table, pressed by a plate with 2 N
PRESS = """<mujoco><option timestep="0.001"/><worldbody>
  <geom name="table" type="plane" size="1 1 1"/>
  <body name="block" pos="0 0 0.01"><freejoint name="block"/><geom type="box" size="0.01 0.01 0.01" mass="0.1"/></body>
  <body name="arm" pos="0 0 0.03" gravcomp="1"><joint name="down" type="slide" axis="0 0 -1" damping="1"/>
    <body name="plate" gravcomp="1"><geom type="box" size="0.01 0.01 0.002" mass="0.1"/></body></body>
</worldbody><actuator><motor name="down" joint="down"/></actuator></mujoco>"""


def model_of(tmp_path: Path, parts: str) -> kinematics.Kinematics:
    bolt = Path(__file__).parents[2] / "objects/hex_bolt/hex_bolt.stl"
    (tmp_path / "bolt.stl").write_bytes(bolt.read_bytes())
    body = f'<body name="thing" pos="0.3 0 0.5" quat="1 2 0 1"><freejoint/>{parts}</body>'
    assets = '<asset><mesh name="bolt" file="bolt.stl" scale="0.001 0.001 0.001"/></asset>'
    (tmp_path / "model.xml").write_text(f"<mujoco>{assets}<worldbody>{body}</worldbody></mujoco>")
    return kinematics.opened(tmp_path / "model.xml")


# largest distance of a surface from MuJoCo's geoms [mm]: edges of a rod are rounded, circles of a mesh are polygons
ROUNDED, POLYGON = 0.2 * (np.sqrt(2) - 1), 0.02
FARTHEST = {"ball": 1e-6, "rod": ROUNDED, "pill": 1e-6, "block": 1e-3, "egg": POLYGON, "two": POLYGON}


@pytest.mark.parametrize("name", PARTS)
def test_the_distance_from_a_surface_is_that_from_mujocos_geoms(tmp_path: Path, name: str) -> None:
    """At points around the body, by a ball of 0.1 mm that MuJoCo moves there."""
    surface = model_of(tmp_path, PARTS[name]).thing("thing").surface
    spec = mujoco.MjSpec.from_file(str(tmp_path / "model.xml"))
    probe = spec.worldbody.add_body(name="probe", mocap=True)
    probe.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1e-4, 0, 0])
    m = spec.compile()
    data = mujoco.MjData(m)
    mujoco.mj_forward(m, data)
    where = np.random.default_rng(0).normal(size=(40, 3))
    where *= np.linspace(28, 45, 40)[:, None] / np.linalg.norm(where, axis=1)[:, None]  # in the body's frame [mm]
    world, theirs = data.body("thing").xpos + where @ data.body("thing").xmat.reshape(3, 3).T / 1000, []
    ours = [g for g in range(m.ngeom) if m.geom_bodyid[g] == m.body("thing").id]
    ball = next(g for g in range(m.ngeom) if g not in ours)
    for point in world:
        data.mocap_pos[0] = point
        mujoco.mj_kinematics(m, data)
        theirs.append(1000 * min(mujoco.mj_geomDistance(m, data, ball, g, 1.0, None) for g in ours) + 0.1)
    local = (where - surface.pose[:3, 3]) @ surface.pose[:3, :3]
    if surface.indenter["shape"] == "mesh":
        solid = mesh_import.placed(mesh_file.read(Path(surface.indenter["file"])))
        found = mesh_import.signed_distance(solid, local)
    else:
        indenter = indenters.INDENTER_SHAPES[surface.indenter["shape"]](**surface.indenter)
        found = indenters.analytic(indenter).value(local)
    if name == "bolt":  # with whose convex hull MuJoCo collides
        assert (found - theirs > -0.01).all()
        assert (np.abs(found - theirs) < 0.01).mean() > 0.3
    else:
        np.testing.assert_allclose(found, theirs, rtol=0, atol=FARTHEST[name])


def test_one_geom_is_a_shape_of_recipes_and_several_are_one_file_of_the_same_bytes(tmp_path: Path) -> None:
    ball, rod = (model_of(tmp_path, PARTS[name]).thing("thing").surface for name in ("ball", "rod"))
    assert dict(ball.indenter) == {"shape": "sphere", "radius_mm": 10.0}
    np.testing.assert_allclose(ball.pose[:3, 3], [1, 2, 3 - 10])
    assert rod.indenter["length_mm"] == 40.0
    first, second = (model_of(tmp_path, PARTS["two"]).thing("thing").surface.indenter["file"] for _ in range(2))
    assert first == second
    assert int(mesh_file.read(Path(first)).body.max()) == 1


def test_what_collides_is_the_surface_and_what_is_seen_only_where_nothing_collides(tmp_path: Path) -> None:
    seen = '<geom type="sphere" size="0.03" contype="0" conaffinity="0"/>'
    assert model_of(tmp_path, seen + PARTS["ball"]).thing("thing").surface.indenter["radius_mm"] == 10.0
    assert model_of(tmp_path, seen).thing("thing").surface.indenter["radius_mm"] == 30.0


def test_mass_and_centre_are_those_of_all_parts(tmp_path: Path) -> None:
    inner = '<body name="lid" pos="0 0 0.04"><geom type="box" size="0.01 0.01 0.01" mass="0.1"/></body>'
    thing = model_of(tmp_path, f'<geom type="box" size="0.01 0.01 0.01" mass="0.3"/>{inner}').thing("thing")
    assert thing.mass == pytest.approx(0.4)
    np.testing.assert_allclose(thing.centre, [0, 0, 10], atol=1e-9)


def test_a_robot_on_a_free_base_is_no_object_and_bodies_need_no_names(tmp_path: Path) -> None:
    ball = '<geom size="0.01" mass="0.1"/>'
    leg = f'<body>{ball}<body name="foot" pos="0 0 0.1">{ball}<joint/></body></body>'
    text = f'<body name="dog">{ball}<freejoint/>{leg}</body><body name="cup" pos="1 0 0">{ball}<freejoint/></body>'
    (tmp_path / "dog.xml").write_text(f"<mujoco><worldbody>{text}</worldbody></mujoco>")
    known = kinematics.opened(tmp_path / "dog.xml")
    assert known.free == ["cup"]
    poses = known.poses(known.model.qpos0[None])
    assert list(poses) == ["dog", "foot", "cup"]
    np.testing.assert_allclose([poses["foot"][0, 2, 3], poses["cup"][0, 0, 3]], [100, 1000])


def test_links_of_a_urdf_keep_their_names_and_get_poses(tmp_path: Path) -> None:
    box = '<collision><geometry><box size=".02 .02 .02"/></geometry></collision>'
    inertia = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    (tmp_path / "arm.urdf").write_text(
        f'<robot name="arm"><link name="base"/><link name="arm">{inertia}{box}</link><link name="tip"/>'
        '<joint name="turn" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint>'
        '<joint name="end" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="0.1 0 0"/></joint></robot>'
    )
    known = kinematics.opened(tmp_path / "arm.urdf")
    tip = known.poses(np.array([[0.0], [np.pi / 2]]))["tip"]
    np.testing.assert_allclose(tip[:, :3, 3], [[100, 0, 0], [0, 100, 0]], atol=1e-9)


def test_forces_of_states_with_commands_are_those_of_the_press_and_of_the_weight(tmp_path: Path) -> None:
    (tmp_path / "press.xml").write_text(PRESS)
    known = kinematics.opened(tmp_path / "press.xml")
    data = mujoco.MjData(known.model)
    data.ctrl[:] = 2.0
    mujoco.mj_step(known.model, data, 3000)
    states = States(np.arange(2.0), np.tile(data.qpos, (2, 1)), None, np.array([[2.0], [0.0]]))
    forces = known.forces(states, ["block"])
    np.testing.assert_allclose(forces["plate", "block"][0], [0, 0, 2], atol=0.01)
    np.testing.assert_array_equal(forces["arm", "block"], forces["plate", "block"])  # fixed to each other
    assert ("block", "block") not in forces
    assert abs(forces["plate", "block"][1, 2] - 2) > 0.1  # without the motor's force the contact relaxes


def recorded(tmp_path: Path, names: tuple[str, ...], text: str = PRESS) -> Path:
    model = mujoco.MjModel.from_xml_string(PRESS)
    with h5py.File(tmp_path / "demo.hdf5", "w") as file:
        for name in names:
            data, rows = mujoco.MjData(model), []
            for _ in range(40):
                rows.append(np.concatenate([[data.time], data.qpos, data.qvel]))
                data.ctrl[:] = 2.0
                mujoco.mj_step(model, data, 50)
            demo = file.create_group(f"data/{name}")
            demo["states"], demo["actions"] = np.array(rows), np.full((40, 1), 2.0)
            demo.attrs["model_file"] = text
    return tmp_path / "demo.hdf5"


def test_robomimics_states_are_episodes_by_the_model_that_they_carry(tmp_path: Path) -> None:
    source = open_source(recorded(tmp_path, ("demo_10", "demo_2")), columns={"ctrl": "actions", "grip": "actions"})
    assert (source.kind, source.fps, list(source.things)) == ("robomimic", 20.0, ["block"])
    assert [source.episode(k).name for k in range(len(source))] == ["demo_2", "demo_10"]
    episode = source.episode(0)
    assert episode.bodies["plate"][0, 2, 3] == pytest.approx(30.0)
    with h5py.File(source.path) as file:
        down = file["data/demo_2/states"][-1, 8]  # after the time and seven numbers of the block
    assert episode.bodies["plate"][-1, 2, 3] == pytest.approx(30.0 - 1000 * down)
    np.testing.assert_allclose(episode.forces["plate", "block"][-1], [0, 0, 2], atol=0.02)
    assert set(episode.grip.tolist()) == {2.0}
    assert open_source(source.path).episode(0).forces == {}, "without commands no force is known"


def test_a_state_file_of_another_model_and_lost_meshes_are_told(tmp_path: Path) -> None:
    path = recorded(tmp_path, ("demo_0",))
    model_of(tmp_path, PARTS["ball"])
    with pytest.raises(UserError, match=r"demo_0: its states have 16 numbers, and of its model 14: time, 7 positions"):
        open_source(path, model=tmp_path / "model.xml").episode(0)
    lost = PRESS.replace("<worldbody>", '<asset><mesh name="m" file="/far/away/cup.stl"/></asset><worldbody>')
    with pytest.raises(UserError, match=r"demo_0: its model names /far/away/cup.stl, which is not below"):
        open_source(recorded(tmp_path, ("demo_0",), lost)).episode(0)


def test_meshes_are_found_beside_the_file_by_the_end_of_their_path(tmp_path: Path) -> None:
    (tmp_path / "assets").mkdir()
    bolt = Path(__file__).parents[2] / "objects/hex_bolt/hex_bolt.stl"
    (tmp_path / "assets/bolt.stl").write_bytes(bolt.read_bytes())
    mesh = '<asset><mesh name="m" file="/home/x/assets/bolt.stl" scale=".001 .001 .001"/></asset><worldbody>'
    text = PRESS.replace("<worldbody>", mesh).replace('type="box" size="0.01 0.01 0.01"', 'type="mesh" mesh="m"')
    assert open_source(recorded(tmp_path, ("demo_0",), text)).things["block"].surface.indenter["shape"] == "mesh"


def test_joints_without_columns_are_told_by_name(tmp_path: Path) -> None:
    from touch.test_in_formats import STATE, lerobot

    needs("pyarrow")
    (tmp_path / "press.xml").write_text(PRESS)
    columns = {"bodies": {"block": "observation.state[7:14]"}}
    source = open_source(lerobot(tmp_path / "set", [STATE]), model=tmp_path / "press.xml", columns=columns)
    with pytest.raises(UserError, match="no column is named as joint down: name it under joints"):
        source.episode(0)
    columns["joints"] = {"down": "0.001 * observation.state[0]"}
    source = open_source(lerobot(tmp_path / "two", [STATE]), model=tmp_path / "press.xml", columns=columns)
    assert source.episode(0).bodies["plate"][0, 2, 3] == pytest.approx(30.0)
    with pytest.raises(UserError, match="has no joint up; there are: block, down"):
        open_source(tmp_path / "two", model=tmp_path / "press.xml", columns={"joints": {"up": "action"}}).episode(0)


def test_maniskills_robot_stands_at_its_base_and_moves_by_its_joints(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(
        '<mujoco><worldbody><body name="arm"><joint axis="0 0 1"/><geom size="0.01" pos="0.2 0 0"/>'
        '<body name="tip" pos="0.2 0 0"/></body></worldbody></mujoco>'
    )
    angle = np.linspace(0, np.pi / 2, 10)
    base, still = np.tile([1.0, 0, 0, 0, 0, 0, 1], (10, 1)), np.zeros((10, 6))  # half a turn about z
    with h5py.File(tmp_path / "trajectory.h5", "w") as file:
        states = file.create_group("traj_0/env_states")
        states["articulations/arm"] = np.hstack([base, still, angle[:, None], np.zeros((10, 1))])
        states["articulations/cabinet"] = np.hstack([base, still, np.zeros((10, 6))])
        states["actors/cup"] = np.hstack([base, still])
    cup = "cup={shape: sphere, radius_mm: 20}"
    episode = open_source(tmp_path / "trajectory.h5", model=tmp_path / "arm.xml", objects=[cup]).episode(0)
    np.testing.assert_allclose(episode.bodies["tip"][[0, -1], :3, 3], [[800, 0, 0], [1000, -200, 0]], atol=1e-9)


def test_episodes_whose_models_differ_in_what_is_touched_are_refused(tmp_path: Path) -> None:
    path = recorded(tmp_path, ("demo_0", "demo_1"))
    with h5py.File(path, "a") as file:
        file["data/demo_1"].attrs["model_file"] = PRESS.replace('size="0.01 0.01 0.01"', 'size="0.01 0.01 0.011"')
    with pytest.raises(UserError, match=r"demo_1: its block is of another size or shape than in the first episode"):
        open_source(path).episode(1)


@pytest.mark.parametrize(
    ("thing", "body", "said"),
    [
        ("spoon", "plate", "has no such body; there are: block, arm, plate, mark"),
        ("mark", "plate", "object mark: has no geometry: give --object mark=MESH"),
        ("block", "finger", "demo_0: has no body finger for --sensor left (it has: arm, block, mark, plate)"),
    ],
)
def test_what_a_model_lacks_is_told_in_one_line(thing: str, body: str, said: str, tmp_path: Path) -> None:
    path = recorded(tmp_path, ("demo_0",), PRESS.replace("</worldbody>", '<body name="mark"/></worldbody>'))
    words = "--object", thing, "--sensor", f"left=gelsight_mini@{body}", "-o", tmp_path / "out/felt.hdf5"
    done = tacgen_("touch", path, *words)
    assert (done.exit_code, len(done.output.splitlines())) == (2, 1), done.output
    assert said in done.output
    assert [each.name for each in tmp_path.iterdir()] == ["demo.hdf5"]


def test_a_part_of_mujoco_that_no_recipe_has_is_a_closed_mesh() -> None:
    open_box = np.array([[0, 0, 0], [20, 0, 0], [0, 20, 0], [0, 0, 20]], float)
    part = surfaces.RigidPart("mesh", np.ones(3), np.eye(4), open_box, np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3]]))
    surface = surfaces.of_solids("open", [part])
    assert len(mesh_file.read(Path(surface.indenter["file"])).triangles) == 4  # its convex hull closes it
