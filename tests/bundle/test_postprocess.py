"""What follows from a bundle: invariants by closed forms, energy by the work done, stick and slip by their maps."""

from pathlib import Path

import numpy as np
import pytest
from helpers import small_recipe
from helpers.synthetic import write

from tacgen.base.errors import UserError
from tacgen.batch import pipeline
from tacgen.bundle import bundle, postprocess

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
def test_forces_by_maps_miss_the_force_as_quality_says(
    tmp_path: Path, indenter: str, least: float, most: float
) -> None:
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
