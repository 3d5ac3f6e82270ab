"""Presses of small pads: no locking, and the symmetries that nature has."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.presses import gel, poses, run, scene

from tacgen.geometry.analytic_sdf import BoxSdf, CylinderSdf, Shape, SphereSdf, WedgeSdf

SQUARE = (-3.0, 3.0, -3.0, 3.0)


def test_a_nearly_incompressible_pad_does_not_lock() -> None:
    """nu from .499 to .4999 hardly changes a bonded pad's answer; elements that lock stiffen several times."""
    force = {
        nu: -run(scene(SphereSdf(3.0), poses([(0, 0, -0.6)]), pad=gel(nu=nu)), SQUARE).forces[-1, 2]
        for nu in (0.45, 0.499, 0.4999)
    }
    assert 1.0 < force[0.4999] / force[0.499] < 1.01
    assert 1.01 < force[0.499] / force[0.45] < 1.3


@pytest.mark.parametrize("friction", [0.0, 0.6, 1.7])
@pytest.mark.parametrize("tip", [SphereSdf(0.4), WedgeSdf(np.radians(51), 0.39, 6.2)], ids=["ball", "wedge"])
def test_a_tip_that_barely_touches_presses_barely(tip: Shape, friction: float) -> None:
    """Between the points of a coarse mesh, at first: no force to tell what is left unbalanced by."""
    path = poses([(0.1, 0.1, -0.005), (0.1, 0.1, -0.012), (0.1, 0.1, -0.03), (0.1, 0.1, -0.06)])
    force = -run(scene(tip, path, friction=friction, edge=0.8)).forces[:, 2]
    assert (force[:2] < [1e-3, 1e-2]).all()  # a contact narrower than an element has closer points
    assert (np.diff(force) >= 0).all()


def test_a_turned_scene_gives_the_turned_wrench() -> None:
    """An oblong punch off the middle pressed and slid along x, and the same turned by 90 degrees about z."""
    path = np.array([(0.4, -0.3, -0.3), (0.4, -0.3, -0.5), (0.8, -0.3, -0.5)])
    turned = np.column_stack([-path[:, 1], path[:, 0], path[:, 2]])
    box = BoxSdf(3.0, 1.6, 0.3)
    one = run(scene(box, poses(list(map(tuple, path))), friction=0.5), SQUARE)
    two = run(scene(box, poses(list(map(tuple, turned)), yaw=np.pi / 2), friction=0.5), SQUARE)
    expected = np.column_stack([-one.forces[:, 1], one.forces[:, 0], one.forces[:, 2]])
    size = np.abs(one.forces).max()
    assert one.forces[-1, 0] > 0.1 * size  # the slide is seen
    assert two.forces == pytest.approx(expected, abs=1e-3 * size)


def test_a_mirrored_scene_gives_the_mirrored_wrench() -> None:
    path = np.array([(0.7, 0.2, -0.3), (0.7, 0.2, -0.5), (0.9, 0.4, -0.5)])
    one, two = (
        run(scene(SphereSdf(2.0), poses(list(map(tuple, path * [side, 1, 1]))), friction=0.5), SQUARE)
        for side in (1, -1)
    )
    size = np.abs(one.forces).max()
    assert one.forces[-1, 0] > 0.1 * size
    assert two.forces == pytest.approx(one.forces * [-1, 1, 1], abs=1e-3 * size)


def test_twice_as_stiff_a_gel_pushes_back_twice_as_hard() -> None:
    """Lengths do not change with the modulus: contact, too, scales with it."""
    soft, stiff = (
        run(scene(SphereSdf(3.0), poses([(0, 0, -0.6)]), pad=gel(E=E), friction=0.3), SQUARE) for E in (0.01, 20.0)
    )
    assert stiff.forces / 2000 == pytest.approx(soft.forces, abs=1e-3 * np.abs(soft.forces).max())
    assert stiff.states[-1].x == pytest.approx(soft.states[-1].x, abs=2e-3)


def test_the_barrier_leaves_no_trace_of_its_range() -> None:
    """The indenter is shrunk by the mean gap: without that the force at .05 mm would be some 8 % higher than at .02."""
    made = scene(SphereSdf(3.0), poses([(0, 0, -0.6)]), edge=0.45)
    wide, narrow = (-run(replace(made, dhat=dhat), SQUARE).forces[-1, 2] for dhat in (0.05, 0.02))
    assert wide == pytest.approx(narrow, rel=0.01)


@pytest.mark.slow
def test_a_punch_slid_without_friction_feels_the_mesh_ever_less() -> None:
    """Its rim stands elsewhere in the cells at each place, and their energy is not quite the same: the force along the
    face falls with the third power of the edge or faster, once the rim is about as round as cells are wide."""
    dragged = []
    for edge in (0.6, 0.3):
        path = poses([(0.013 + part * edge, 0.0, -0.2) for part in (0.0, 0.2, 0.4, 0.6, 0.8)])
        made = replace(scene(CylinderSdf(1.4, 0.45), path, pad=gel(9.0, 9.0, 1.5), edge=edge), dhat=0.03)
        force = run(made, (-1.8, 1.8, -1.8, 1.8)).forces
        dragged.append(np.sqrt(np.mean((force[:, 0] / force[:, 2]) ** 2)))
    assert dragged[0] > 8 * dragged[1], dragged
    assert 2e-4 < dragged[1] < 2.5e-3
