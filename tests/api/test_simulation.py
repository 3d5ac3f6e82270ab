"""The public names: a contact in ten lines, the same as from a recipe; arguments that are wrong; what is rejected."""

import pickle
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers import synthetic
from helpers.command import told
from helpers.small_recipe import HEAD
from PIL import Image

import tacgen
from tacgen.base.errors import LeftOut
from tacgen.batch import pipeline
from tacgen.bundle import bundle, field_names
from tacgen.outputs import LAYOUT
from tacgen.recipe import plan

COARSE = {"edge_mm": 1.0, "dhat_mm": 0.1}
BALL = tacgen.Sphere(radius_mm=4)


def pressed(**changes: object) -> tacgen.Frames:
    """A ball pressed and slid on a coarse mesh of the GelSight Mini, changed in some arguments."""
    moves = [tacgen.Press(depth_mm=0.4, frames=2), tacgen.Slide(x_mm=0.3, frames=1)]
    given = {"sensor": "gelsight_mini", "indenter": BALL, "movements": moves, "quality": COARSE, "friction": 0.5}
    return tacgen.simulate(**given | changes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def frames() -> tacgen.Frames:
    return pressed(name="small")


def test_frames_are_those_of_the_recipe_byte_for_byte(frames: tacgen.Frames, tmp_path: Path) -> None:
    text = HEAD.replace("[force]", "[force, traction, height, stress]")
    moves = "  - press: {depth_mm: 0.4, frames: 2}\n  - slide: {x_mm: 0.3, frames: 1}\ncontact: {friction: 0.5}\n"
    (tmp_path / "small.yaml").write_text(text + moves)
    (made,) = pipeline.run(plan.load(tmp_path / "small.yaml").rows, tmp_path / "out")
    assert made.path.read_bytes() == frames.save(tmp_path / "kept.h5").read_bytes()
    again = tacgen.read(tmp_path / "kept.h5")
    for name in frames.names:
        assert np.array_equal(again[name], frames[name], equal_nan=True)


def test_arrays_have_the_shapes_and_units_that_the_docstring_says(frames: tacgen.Frames) -> None:
    said = re.findall(r"^        (\w+): (.+?), \(([^)]+)\) \[([^]]+)\]", tacgen.Frames.__doc__ or "", re.M)
    declared = {*tacgen.Frames.__annotations__} - {"rgb"}
    assert {name for name, *_ in said} == declared
    for name, _, shape, units in said:
        known = field_names.SHORT_NAMES.get(name, name)
        path = next(path for path in (known, f"/frames/{known}", f"/fields/{known}") if path in LAYOUT)
        assert (shape.replace(",", ""), units) == (LAYOUT[path].shape, LAYOUT[path].units), name
    assert frames.force.shape == (len(frames), 3) == (3, 3)
    assert frames.pressure.shape == frames.height.shape == (3, 240, 320)
    assert frames.stress.shape == (3, frames.displacement.shape[1], 6)
    assert frames.force[1, 2] < frames.force[0, 2] < 0 < frames.force[2, 0]
    assert frames.segments == ("press", "press", "slide")
    with pytest.raises(ValueError, match="read-only"):
        frames.force[0] = 0


def test_it_shows_itself_in_one_line_and_names_what_it_has(frames: tacgen.Frames) -> None:
    assert repr(frames) == "Frames(scene-00000.h5: 3 frames, sphere, radius 4 mm, on gelsight_mini)"
    assert {"force", "stress", "pressure", "plot"} <= {*dir(frames)}
    assert not {"rgb", "image", "force_std"} & {*dir(frames)}
    assert not hasattr(frames, "rgb")
    with pytest.raises(AttributeError, match="'forces': no such field, did you mean force; there are: force, torque"):
        _ = frames.forces  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match="'rgb': not among the outputs of this scene"):
        _ = frames.image
    with pytest.raises(tacgen.UserError, match="'/mesh/pionts': no such field"):
        frames["/mesh/pionts"]
    assert frames["/mesh/points"].shape == frames.displacement.shape[1:]


def test_the_figure_is_that_of_show(frames: tacgen.Frames, tmp_path: Path) -> None:
    for field in ("", "stress"):
        options = [f"--field={field}"] if field else []
        shown, plotted = tmp_path / f"shown{field}.png", tmp_path / f"plotted{field}.png"
        told("show", frames.bundle.path, *options, "-o", shown)
        frames.plot(field).savefig(plotted, dpi=150)
        assert shown.read_bytes() == plotted.read_bytes()
    with pytest.raises(tacgen.UserError, match="strss: unknown field, did you mean stress"):
        frames.plot("strss")


def test_frames_are_a_film(frames: tacgen.Frames, tmp_path: Path) -> None:
    film = frames.animate(tmp_path / "x.gif")
    with Image.open(film) as image:
        assert image.n_frames == len(frames)
    with pytest.raises(tacgen.UserError, match="is there already"):
        frames.animate(film)
    assert frames.animate(film, overwrite=True) == film


def test_von_mises_of_uniaxial_tension_and_shear(frames: tacgen.Frames, monkeypatch: pytest.MonkeyPatch) -> None:
    assert frames.von_mises.shape == frames.stress.shape[:2]
    tension, shear = np.zeros((1, 2, 6)), np.zeros((1, 2, 6))
    tension[..., 2], shear[..., 4] = 0.3, 0.3
    for stress, expected in ((tension, 0.3), (shear, 0.3 * 3**0.5)):
        monkeypatch.setitem(frames._read, "/fields/nodal_stress", stress)
        assert frames.von_mises == pytest.approx(np.full((1, 2), expected))


def test_frames_are_pickled_with_their_file_and_outlive_those_that_made_them_and_leave_no_folder() -> None:
    found = [pressed(movements=tacgen.Press(depth_mm=d, frames=1), outputs="force") for d in (0.2, 0.4)]
    folders = [each.bundle.path.parent for each in found]
    assert found[1].force[0, 2] < found[0].force[0, 2] < 0
    assert folders[0] != folders[1]
    force, copy = found[0].force, pickle.loads(pickle.dumps(found[0]))
    del found
    assert not any(folder.exists() for folder in folders)
    assert copy.force.tolist() == force.tolist()


def test_a_trimesh_is_the_file_it_was_read_from(tmp_path: Path) -> None:
    shape = trimesh.creation.icosphere(subdivisions=2, radius=3.0)
    shape.export(tmp_path / "ball.stl")
    press = tacgen.Press(depth_mm=0.3, frames=1)
    both = trimesh.load_mesh(tmp_path / "ball.stl"), tmp_path / "ball.stl"
    found = [pressed(indenter=given, movements=press, outputs=["force", "traction"]) for given in both]
    assert found[0].force[0, 2] < -0.05
    for name in found[0].names:
        assert np.array_equal(found[0][name], found[1][name]), name


def test_poses_are_followed(frames: tacgen.Frames) -> None:
    found = pressed(movements=frames.pose, outputs="force")
    assert np.allclose(found.pose, frames.pose, atol=1e-12)
    assert np.allclose(found.force, frames.force, rtol=1e-6, atol=1e-9)


def test_a_gel_of_layers_is_a_sensor() -> None:
    layer = tacgen.NeoHookeLayer(name="silicone", thickness_mm=3, youngs_modulus_mpa=0.2, poissons_ratio=0.49)
    soft = layer.model_copy(update={"youngs_modulus_mpa": 0.1})
    press = tacgen.Press(depth_mm=0.3, frames=1)
    gels = [tacgen.Gel(width_mm=16, height_mm=12, layers=(each,)) for each in (layer, soft)]
    pair = [pressed(sensor=gel, movements=press, outputs=("force", "height")) for gel in gels]
    assert pair[0].force[0, 2] == pytest.approx(2 * pair[1].force[0, 2], rel=1e-3)
    assert pair[0].height.shape == (1, 240, 320)
    assert pair[0].sensor.gel.layers == (layer,)


def test_overrides_and_sensors_are_the_same_change() -> None:
    press = tacgen.Press(depth_mm=0.3, frames=1)
    changed = {"gel.layers[0].youngs_modulus_mpa": 0.25}
    sensor = tacgen.load_sensor("gelsight_mini")
    by_name = pressed(movements=press, outputs="force", sensor_overrides=changed)
    by_object = pressed(sensor=sensor, movements=press, outputs="force", sensor_overrides=changed)
    assert by_name.force.tolist() == by_object.force.tolist()
    assert by_name.sensor.gel.layers[0].youngs_modulus_mpa == 0.25  # type: ignore[union-attr]
    assert repr(sensor) == str(sensor) == "Sensor(gelsight_mini: gel 25.25 x 20.75 x 4 mm, picture 320 x 240 px)"
    assert Path(tacgen.load_sensor("tactip").gel.solid.file).is_file()  # type: ignore[union-attr]


def test_the_force_has_its_expected_error() -> None:
    found = pressed(movements=tacgen.Press(depth_mm=0.4, frames=1), outputs="force", uncertainty=True)
    assert found.force_std.shape == (1, 3)
    assert 0.001 < found.force_std[0, 2] / abs(found.force[0, 2]) < 0.3


def test_what_is_rejected_is_an_exception_with_the_frames_before_it(tmp_path: Path) -> None:
    synthetic.write(tmp_path / "scene-00000.h5", stop=3)
    with pytest.raises(tacgen.SceneRejected, match=r"^frame 3 of 12: Newton's method stalled$") as caught:
        tacgen.read(tmp_path)
    assert len(caught.value.frames) == 3
    assert repr(caught.value.frames).endswith(": rejected: frame 3 of 12: Newton's method stalled)")
    synthetic.write(tmp_path / "scene-00001.h5")
    with pytest.warns(LeftOut, match="left out 1 rejected of 2 scenes"):
        (good,) = tacgen.read_all(tmp_path)
    assert len(good) == 12
    with pytest.raises(tacgen.UserError, match="holds 2 bundles: name one"):
        tacgen.read(tmp_path)


def test_a_contact_that_does_not_converge_is_an_exception(monkeypatch: pytest.MonkeyPatch) -> None:
    from tacgen.mechanics import Failure, NotConverged

    solved = pipeline.mechanics.states

    def stops(*args: object, **options: object) -> object:
        states = solved(*args, **options)  # type: ignore[arg-type]
        yield next(states)
        raise NotConverged(Failure.too_far)

    monkeypatch.setattr(pipeline.mechanics, "states", stops)
    with pytest.raises(tacgen.SceneRejected, match=f"^frame 2 of 3: {Failure.too_far}$") as caught:
        pressed(outputs="force")
    assert caught.value.frames.force.shape == (1, 3)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"sensor": "digitt"}, "simulate: sensor: no sensor is called 'digitt'; did you mean digit?"),
        ({"sensor": 3}, "simulate: sensor: must be a name, a path, a Sensor or a Gel (got int)"),
        ({"indenter": "hex_blt"}, "simulate: indenter.file: no object is called 'hex_blt'; did you mean hex_bolt?"),
        ({"indenter": 3}, "a name, a path or a trimesh (got int)"),
        ({"movements": []}, "simulate: trajectory: must hold at least 1 (got 0)"),
        ({"movements": [3]}, "simulate: movements[0]: must be Press, Slide, Twist"),
        ({"movements": np.eye(4)}, "simulate: movements: poses must be an array (N, 4, 4) (got (4, 4))"),
        ({"movements": 2 * np.ones((1, 4, 4))}, "poses must hold rotations"),
        ({"movements": np.eye(4)[None], "dynamics": tacgen.Dynamics(density_kg_m3=1100)}, "dynamics: needs frame_s"),
        ({"friction": -1}, "simulate: contact.friction: must be at least 0 (got -1)"),
        ({"outputs": ["forces"]}, "did you mean force?"),
        ({"quality": "drft"}, "did you mean draft?"),
        ({"sensor_overrides": {"gel.layrs": 3}}, "layrs"),
    ],
)
def test_mistakes_are_one_line(changes: dict[str, object], says: str) -> None:
    with pytest.raises(tacgen.UserError) as caught:
        pressed(**changes)
    assert not [line for line in caught.value.lines[1:] if not line.startswith("    ")]
    assert says in str(caught.value)


def test_parts_say_what_is_wrong_in_one_line() -> None:
    said = r"^Sphere: radius: unknown key, did you mean radius_mm\?; there are: shape, radius_mm$"
    with pytest.raises(tacgen.UserError, match=said):
        tacgen.Sphere(radius=4)  # type: ignore[call-arg]
    with pytest.raises(tacgen.UserError, match=r"^Slide: x: unknown key, did you mean x_mm\?; there are: "):
        tacgen.Slide(x=4, frames=2)  # type: ignore[call-arg]
    with pytest.raises(tacgen.UserError, match=r"^Press: depth_mm: must be greater than 0 \(got -1\)$"):
        tacgen.Press(depth_mm=-1, frames=2)


def test_a_recipe_is_a_dictionary_a_name_or_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    monkeypatch.setattr("tacgen.batch.run", lambda plan, folder, **options: made.append((plan, folder, options)) or [])
    recipe = {"extends": "quickstart", "outputs": ["force"], "indenter": BALL, "contact": {"friction": np.float32(0.5)}}
    for source in (recipe, "batch", tacgen.recipe.assets.recipe_path("batch")):
        assert tacgen.run(source, tmp_path, sets=["quality=draft"], workers=2) == []
    first, second, third = (plan for plan, *_ in made)
    assert first.rows[0].recipe.indenter == BALL
    assert [row.key for row in second.rows] == [row.key for row in third.rows]
    assert made[0][1:] == (tmp_path, {"workers": 2, "overwrite": False})
    with pytest.raises(tacgen.UserError, match=r"^recipe: contat: unknown key, did you mean contact\?; there are: "):
        tacgen.run({**recipe, "contat": {}}, tmp_path)


def test_run_writes_bundles_that_read_all_reads(tmp_path: Path) -> None:
    press = [{"press": tacgen.Press(depth_mm=0.3, frames=1)}]
    vary = {"method": "grid", "over": {"indenter.radius_mm": {"choice": [3, 5]}}}
    recipe = {"extends": "quickstart", "trajectory": press, "quality": COARSE, "outputs": ["force"], "vary": vary}
    results = tacgen.run(recipe, tmp_path)
    assert [each.status for each in results] == ["ok", "ok"]
    small, large = tacgen.read_all(tmp_path)
    assert large.force[0, 2] < small.force[0, 2] < 0
    assert bundle.read(results[0].path)["/frames/force"].tolist() == small.force.tolist()
