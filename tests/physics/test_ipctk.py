"""Contact between meshes beside contact by signed distance: the same forces, none along a flat slide, no tunnelling."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import presses, small_recipe
from helpers.needs import needs
from helpers.presses import Run, gel, poses, scene

from tacgen import pipeline
from tacgen.bundle import bundle
from tacgen.errors import UserError
from tacgen.geometry import surface_nets
from tacgen.geometry.analytic_sdf import BoxSdf, Shape, SphereSdf, TorusSdf
from tacgen.geometry.gel import GelBody
from tacgen.geometry.pose import Pose
from tacgen.outputs.cauchy_stress import Stresses
from tacgen.recipe import plan, scene_of_row

ipctk = needs("ipctk")
Array = np.ndarray
Path3 = list[tuple[float, float, float]]


def run(
    shape: Shape, path: Path3, formulation: str, *, pad: GelBody | None = None, friction: float = 0.0,
    edge: float = 0.6, dhat: float = 0.05, half: float = 4.0,
) -> Run:  # fmt: skip
    """All frames, on a mesh fine within `half` of the middle."""
    made = replace(scene(shape, poses(path), pad=pad, friction=friction, edge=edge), dhat=dhat)
    if formulation == "ipctk":
        made = replace(made, surface=surface_nets.of_shape(shape, half=9, height=4, tolerance=dhat / 10))
    return presses.run(made, (-half, half, -half, half))


def both(shape: Shape, path: Path3, **how: object) -> tuple[Run, Run]:
    one, other = (run(shape, path, f, **how) for f in ("distance", "ipctk"))  # type: ignore[arg-type]
    for state in other.states:
        assert state.min_gap > 0
        assert state.residual < 1e-3
        assert state.balance < 1e-3
    return one, other


@pytest.mark.slow
def test_a_pressed_and_slid_ball_gives_the_same_force() -> None:
    path = [(-0.4, 0.0, -0.6), (-0.2, 0.0, -0.6), (0.0, 0.0, -0.6), (0.0, 0.0, -0.6), (0.0, 0.0, 0.3)]
    one, other = both(SphereSdf(3.0), path, friction=0.4, half=2.4, edge=0.48, dhat=0.04)
    size = np.linalg.norm(one.forces, axis=1)[:, None]
    assert (np.abs(other.forces - one.forces) < 0.01 * size + 1e-12).all()
    assert one.forces[2, 0] > 0.3 * -one.forces[2, 2]
    assert np.abs(other.forces[3] - other.forces[2]).max() < 2e-3 * size[2]  # held: it does not creep
    assert np.abs(other.forces[4]).max() == 0
    assert max(state.iterations for state in other.states) <= 30
    stressed = [Stresses(found.problem) for found in (one, other)]
    errors = [
        s.quality(s.at(run.states[2].x), run.states[2])["force_error"]
        for s, run in zip(stressed, (one, other), strict=True)
    ]
    assert errors[1] == pytest.approx(errors[0], abs=0.01)
    assert 1e-6 < errors[1] < 0.05


@pytest.mark.slow
def test_a_ball_on_a_finer_mesh_gives_the_same_force() -> None:
    one, other = both(SphereSdf(4.0), [(0.1, 0.05, -0.5), (0.1, 0.05, -1.0)], edge=0.4, dhat=0.03)
    assert other.forces[:, 2] == pytest.approx(one.forces[:, 2], rel=0.01)


@pytest.mark.slow
def test_a_round_edged_box_gives_the_same_force() -> None:
    """Where the mesh resolves its edges: at .4 mm the two are 1.7 % apart, and at .3 mm each is 1 % off that itself."""
    path = [(0.0, 0.0, -0.4), (0.3, 0.0, -0.4)]
    one, other = both(BoxSdf(4.0, 4.0, 1.2), path, friction=0.3, edge=0.3, dhat=0.02, half=2.6, pad=gel(9, 9, 2.0))
    size = np.linalg.norm(one.forces, axis=1)[:, None]
    assert (np.abs(other.forces - one.forces) < 0.01 * size).all()


@pytest.mark.parametrize("formulation", ["distance", pytest.param("ipctk", marks=pytest.mark.slow)])
def test_a_flat_slide_without_friction_drags_nothing(formulation: str) -> None:
    """A plate wider than the pad, slid by odd amounts."""
    path = [(0.0, 0.0, -0.1), (0.137, 0.061, -0.1), (0.31, -0.05, -0.1)]
    slid = run(BoxSdf(16.0, 16.0, 0.3), path, formulation, pad=gel(7, 7, 2.0), half=2.0)
    assert (slid.forces[:, 2] < -0.3).all()
    assert np.abs(slid.forces[:, :2]).max() < 1e-3 * np.abs(slid.forces[:, 2]).min()


@pytest.mark.slow
def test_a_thin_ring_does_not_tunnel() -> None:
    """At once from above to where all of it is below the untouched face, and then across."""
    ring = TorusSdf(2.0, 0.3)
    jumped = run(ring, [(0.0, 0.0, -0.9), (1.5, 0.0, -0.9)], "ipctk", pad=gel(10, 10, 3.0), half=4.0)
    for state in jumped.states:
        assert state.min_gap > 0
        at = jumped.problem.contact.faces.at(state.x)
        local = Pose.of(state.pose).local(at)
        under = np.abs(np.hypot(local[..., 0], local[..., 1]) - 2.0) < 0.25
        assert under.sum() > 100
        assert local[under][:, 2].max() < 0.3  # the face stays below the ring's middle
        assert min(part.evaluate(state.x).J.min() for part in jumped.problem.elastic) > 0
        assert state.traction_force.sum((0, 1))[2] < -0.1


CONTACT = "contact={friction: 0.5, formulation: ipctk}"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["letters", "key", "gear"])
def test_sharp_meshes_press_without_penetration(name: str) -> None:
    sets = f"indenter={{shape: mesh, file: {name}}}", "quality={edge_mm: 0.8, dhat_mm: 0.05}", CONTACT
    pressed = presses.run(scene_of_row.build(small_recipe.row("press: {depth_mm: 0.4, frames: 2}", *sets)))
    for state in pressed.states:
        contact = pressed.problem.contact.moved(Pose.of(state.pose), state.offset)
        assert not ipctk.has_intersections(contact.pair.collision, contact._vertices(state.x), ipctk.LBVH())
        assert state.min_gap > 0
        assert state.balance < 1e-3
        assert state.residual < 1e-3
        assert state.traction_force[..., 2].sum() < -1


def test_the_bundle_says_which_formulation(tmp_path: Path) -> None:
    for sets, said in (((), f"ipctk {ipctk.__version__}"), (("contact.formulation=distance",), "distance")):
        row = small_recipe.row("press: {depth_mm: 0.3, frames: 1}", "quality.edge_mm=1.2", CONTACT, *sets)
        done = pipeline.run_scene(row, tmp_path / said.split()[0])
        assert done.status == "ok"
        assert bundle.read(done.path).attrs["contact"] == said


def test_without_the_toolkit_one_line_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "r.yaml").write_text("extends: quickstart\ncontact:\n  formulation: ipctk\n")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UserError) as refused:
        plan.load(tmp_path / "r.yaml")
    assert refused.value.lines[0] == (
        f"{tmp_path / 'r.yaml'}:3:16: contact.formulation: needs the IPC Toolkit, which is not installed:"
        " pip install 'tacgen[ipc]'"
    )
