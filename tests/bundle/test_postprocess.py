"""What follows from a bundle: invariants, energy, stick and slip, forces by taxel, and the error of the force."""

from pathlib import Path

import numpy as np
import pytest
from helpers import small_recipe
from helpers.command import told
from helpers.synthetic import write

import tacgen
from tacgen.base.errors import UserError
from tacgen.batch import pipeline
from tacgen.bundle import bundle, postprocess, taxels
from tacgen.bundle.bundle import Bundle, read
from tacgen.bundle.force_error import ERROR_BY_MESH, STD_BY_UNCERTAINTY, force_error
from tacgen.bundle.postprocess import wrench
from tacgen.geometry.pose import about
from tacgen.mechanics.expected_error import expected_force_error
from tacgen.mechanics.face_overlap import Overlap

PUNCH = "indenter={shape: cylinder, radius_mm: 3, fillet_mm: 0.8}", "quality={edge_mm: 1.2, dhat_mm: 0.05}"


def pressed(folder: Path, output: str) -> bundle.Bundle:
    """A punch on its way down in 12 frames."""
    row = small_recipe.row("press: {depth_mm: 0.4, frames: 12}", *PUNCH, f"outputs=[{output}]")
    return bundle.read(pipeline.run_scene(row, folder / output).path)


@pytest.mark.parametrize(
    ("stress", "mises", "principal", "pressure"),
    [
        ([5, 0, 0, 0, 0, 0], 5, [5, 0, 0], -5 / 3),  # tension
        ([-2, -2, -2, 0, 0, 0], 0, [-2, -2, -2], 2),  # hydrostatic
        ([0, 0, 0, 0, 0, 3], 3 * np.sqrt(3), [3, 0, -3], 0),  # shear xy
        ([0, 0, 0, 3, 0, 0], 3 * np.sqrt(3), [3, 0, -3], 0),
        ([1, 1, 4, 0, 2, 0], np.sqrt(21), [5, 1, 0], -2),  # xz
    ],
)
def test_invariants(stress: list[float], mises: float, principal: list[float], pressure: float) -> None:
    s = np.array(stress, "f4")
    assert postprocess.von_mises(s) == pytest.approx(mises, abs=1e-6)
    assert postprocess.principal(s) == pytest.approx(principal, abs=1e-6)
    assert postprocess.hydrostatic(s) == pytest.approx(pressure, abs=1e-6)
    shear = (principal[0] - principal[2]) / 2
    assert postprocess.largest_shear(np.stack([s, s])) == pytest.approx([shear] * 2, abs=1e-6)


@pytest.mark.parametrize(
    ("indenter", "least", "most"),
    [("{shape: sphere, radius_mm: 4.0}", 0, 0.05), ("{shape: cone, half_angle_deg: 20, tip_radius_mm: 0.2}", 0.2, 2)],
)
def test_forces_by_maps_miss_it_as_quality_says(tmp_path: Path, indenter: str, least: float, most: float) -> None:
    """By little where the mesh resolves the indenter; cells of 0.8 mm resolve no tip of 0.2 mm."""
    sets = f"indenter={indenter}", "contact.friction=0.6", "quality={edge_mm: 0.8, dhat_mm: 0.05}"
    moves, asked = "press: {depth_mm: 0.8, frames: 1}, slide: {x_mm: 0.3, frames: 1}", "[traction, force_map, normals]"
    scene = bundle.read(pipeline.run_scene(small_recipe.row(moves, *sets, f"outputs={asked}"), tmp_path).path)
    for frame, force in enumerate(scene["/frames/force"]):
        by = [scene.frame(f"/frames/quality/{name}_resultant", frame) for name in ("pressure", "traction")]
        missing = np.linalg.norm(postprocess.map_force(scene, frame) - force) / np.linalg.norm(force)
        assert least <= max(by) < most
        assert missing <= sum(by) + 0.4 * max(by) + 1e-3, (missing, by)
    assert scene["/frames/quality/force_map_resultant"].max() < 1e-9
    assert scene["/frames/quality/unseen_force"].max() == 0


def test_contact_states(tmp_path: Path) -> None:
    def edit(index: int, arrays: dict[str, np.ndarray]) -> None:
        pressure = arrays["/frames/pressure"]
        pressure[:, :4] = np.array([0.0, 0.001, 0.02, 0.02])
        arrays["/frames/contact"] = pressure > 0.01
        arrays["/frames/slip"] = arrays["/frames/contact"] & (np.arange(16) == 3)

    found = postprocess.contact_state(bundle.read(write(tmp_path / "x.h5", edit=edit)), 2)
    assert found[:, :4].tolist() == [[postprocess.FREE, postprocess.EDGE, postprocess.STICK, postprocess.SLIP]] * 12


def test_energy_is_the_work_of_the_press(tmp_path: Path) -> None:
    """What a frictionless indenter does on its way down, by the trapezium rule, is stored in the gel."""
    found = pressed(tmp_path, "stress")
    depth, force = -found["/frames/pose"][:, 2, 3], -found["/frames/force"][:, 2]
    work = np.trapezoid([0.0, *force], [0.0, *depth])
    energy = postprocess.strain_energy(found, 11)
    assert energy.min() >= 0
    assert energy.sum() == pytest.approx(work, rel=0.02)
    nodes, layers, values = postprocess.stress_by_layer(found, 11)
    assert (layers == 0).all()
    order = nodes.argsort()
    assert (values[order] == found["/fields/nodal_stress"][11]).all()


def test_stress_of_the_face_alone(tmp_path: Path) -> None:
    """The same numbers as `stress` on the coated face, in much less space."""
    whole, face = (pressed(tmp_path, output) for output in ("stress", "surface_stress"))
    nodes = np.unique(whole["/mesh/facets/coated"])
    assert (face["/fields/surface_stress"] == whole["/fields/nodal_stress"][:, nodes]).all()
    assert (face["/fields/surface_displacement"] == whole["/fields/displacement"][:, nodes]).all()
    points, facets = face["/mesh/surface/points"], face["/mesh/surface/facets"]
    assert (points[facets] == whole["/mesh/points"][whole["/mesh/facets/coated"]]).all()
    whole_size, size = (sum(np.prod(b.shapes[f]) for f in b.shapes if f.startswith("/fields/")) for b in (whole, face))
    assert 5 * size < whole_size


def test_energy_needs_the_materials(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="does not hold its sensor"):
        postprocess.strain_energy(bundle.read(write(tmp_path / "x.h5")), 0)


LAYOUTS = {
    "grid": taxels.grid(4, 4, 4.0),
    "one": np.zeros((1, 2)),
    "odd": np.array([[3.0, 1.0], [-2.0, 5.0], [0.1, 0.2]]),
}


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Bundle:
    """A ball pressed beside the middle, and dragged."""
    sets = "outputs=[force, force_map]", "start={x_mm: 4.1, y_mm: -2.0}", "contact.friction=0.6"
    row = small_recipe.row("press: {depth_mm: 0.8, frames: 1}, slide: {x_mm: 0.4, frames: 1}", *sets)
    return read(pipeline.run_scene(row, tmp_path_factory.mktemp("taxels")).path)


@pytest.mark.parametrize("name", LAYOUTS)
def test_taxels_add_up_to_the_wrench(scene: Bundle, name: str) -> None:
    for frame in range(scene.frames):
        found = taxels.forces(scene, frame, LAYOUTS[name])
        assert found.shape == (len(LAYOUTS[name]), 3)
        assert found.sum(0) == pytest.approx(wrench(scene)[frame, :3], rel=1e-5, abs=1e-6)


def test_a_taxel_feels_what_is_above_it(scene: Bundle) -> None:
    """Nearly all of it where the taxels are far apart, and the moments of many small ones are those of the force."""
    far = np.array([[4.1, -2.0], [-6.0, 5.0]])
    assert taxels.forces(scene, 0, far)[0] == pytest.approx(scene.frame("/frames/force", 0), rel=1e-5, abs=1e-6)
    fine = taxels.grid(40, 40, 0.5)
    normal = taxels.forces(scene, 0, fine)[:, 2]
    assert normal @ fine / normal.sum() == pytest.approx([4.1, -2.0], abs=0.15)
    transposed = taxels.grid(2, 3, 2.0, (1.0, 0.0))
    assert transposed.tolist() == [[-1, -1], [1, -1], [3, -1], [-1, 1], [1, 1], [3, 1]]


def test_layouts_are_read_and_what_is_none_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "layout.csv"
    path.write_text("name,y_mm,x_mm\na,1,2\nb,-1,0.5\n")
    assert taxels.read(path).tolist() == [[2, 1], [0.5, -1]]
    for text, says in (
        ("x_mm,y_mm\n", "csv: must hold"),
        ("x,y\n1,2\n", "has no column x_mm, y_mm"),
        ("x_mm,y_mm\n1,nan\n", "csv:2: x_mm and y_mm must be numbers"),
        ("x_mm,y_mm\n1,2\n1,a\n", "csv:3: x_mm and y_mm must be numbers"),
        ("x_mm,y_mm\n1\n", "csv:2: has 1 cells, and the header 2"),
        ("x_mm,y_mm\n0,5,1\n", "csv:2: has 3 cells, and the header 2"),
    ):
        path.write_text(text)
        with pytest.raises(UserError, match=says):
            taxels.read(path)
    with pytest.raises(UserError, match="cannot be read"):
        taxels.read(tmp_path / "none.csv")


def test_wrenches_in_two_frames_do_the_same_work(scene: Bundle) -> None:
    """Whatever rigid motion: that is what makes them one wrench."""
    rng = np.random.default_rng(0)
    still = np.eye(4)
    still[:3, :3], still[:3, 3] = about(np.array([0.6, 0.0, 0.8]), 1.1), (5.0, -3.0, 20.0)
    for pose in (still, scene["/frames/pose"]):
        each = np.broadcast_to(pose, (scene.frames, 4, 4))
        turn, at = each[:, :3, :3], each[:, :3, 3]
        v, w = rng.normal(size=(2, scene.frames, 3))  # of the sensor's origin
        there = v + np.cross(w, at)
        motion = np.hstack([np.einsum("nji,nj->ni", turn, part) for part in (there, w)])
        power = (wrench(scene) * np.hstack([v, w])).sum(1)
        assert (wrench(scene, pose) * motion).sum(1) == pytest.approx(power, rel=1e-9)
        size = np.linalg.norm(scene["/frames/force"], axis=1)
        assert np.linalg.norm(wrench(scene, pose)[:, :3], axis=1) == pytest.approx(size)


@pytest.fixture(scope="module")
def frames() -> tacgen.Frames:
    press = tacgen.Press(depth_mm=0.5, frames=2)
    return tacgen.simulate("gelsight_mini", tacgen.Sphere(radius_mm=4), press, quality={"edge_mm": 1.2, "dhat_mm": 0.1})


def test_a_scene_has_the_error_that_its_mesh_gives(frames: tacgen.Frames, tmp_path: Path) -> None:
    relative = frames["/frames/quality/expected_force_error"]
    width = np.sqrt(2 * 4 * np.array([0.25, 0.5]))
    expected = [expected_force_error(1.2, Overlap(np.pi * w**2, 2 * np.pi * w), 4.0) for w in width]
    assert relative == pytest.approx(expected, rel=0.03)
    assert frames.force_error == pytest.approx(relative * np.linalg.norm(frames.force, axis=1))
    path = frames.save(tmp_path / "scene.h5")
    said = told("show", path)
    assert f"N on the gel, \N{PLUS-MINUS SIGN} about {frames.force_error[1]:.1g} N ({ERROR_BY_MESH})" in said
    page = tmp_path / "view.html"
    told("view", path, "-o", page)
    assert f"\\u00b1 about {frames.force_error[1]:.1g} N" in page.read_text()


def test_the_uncertainty_that_was_asked_for_comes_first() -> None:
    both = {"/frames/uncertainty/force": np.array([[0.3, 0.0, 0.4]]), "/frames/force": np.array([[0.0, 0.0, -1.0]])}
    error = force_error(both | {"/frames/quality/expected_force_error": np.array([0.01])})  # type: ignore[arg-type]
    assert error is not None
    assert error.kind == STD_BY_UNCERTAINTY
    assert error.newton == pytest.approx(0.5)
    assert error.text(0) == "\N{PLUS-MINUS SIGN} about 0.5 N"


def test_an_earlier_bundle_has_none(tmp_path: Path) -> None:
    path = write(tmp_path / "scene.h5")
    assert force_error(read(path)) is None
    assert np.isnan(tacgen.read(path).force_error).all()


def test_validate_tells_it_before_the_run() -> None:
    said = told("validate", "quickstart")
    assert "note: expected error of the force by the mesh: about 1 %, within a factor of 2 (edges of 0.36 mm" in said
    assert "about 4 %" in told("validate", "quickstart", "--set", "quality=draft")
    press = "trajectory=[{press: {force_n: 1, frames: 1}}]"
    assert "expected error" not in told("validate", "quickstart", "--set", press), "the depth is not known yet"
