"""An indenter that could pass through the gel unseen is seen."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.presses import gel, poses, scene, thin_plate
from helpers.small import block, patch, whole

from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import elements
from tacgen.fem.materials import NeoHooke
from tacgen.geometry.analytic_sdf import CapsuleSdf, CylinderSdf, Shape, SphereSdf, WedgeSdf
from tacgen.geometry.pose import Pose
from tacgen.mechanics import Problem, mesh, states
from tacgen.mechanics.barrier import Contact, Faces
from tacgen.mechanics.tunnelling import blocked, blocked_along, depth_inside, overlap

Array = np.ndarray
POINTS, CELLS = block(8)
POINTS = POINTS * [4, 4, 1] - [2, 2, 1]  # half a millimetre an edge, face at z = 0
QUADS = CELLS[np.isclose(POINTS[CELLS[:, 4], 2], 0)][:, [4, 5, 6, 7]]
PATTERN = whole(CELLS, len(POINTS))


def at(x: float, z: float) -> Pose:
    return Pose(np.eye(3), np.array([x, 0.0, z]))


def goes(shape: Shape, start: Pose, end: Pose) -> bool:
    """Whether the indenter may go there over a gel that stays."""
    contact = Contact(Faces.on(PATTERN, POINTS, QUADS), shape, start, 0.03, 0.3)
    gap = contact.gap(POINTS)
    return not blocked(contact.moved(end, 0.0), start, POINTS, gap, POINTS)


@pytest.mark.parametrize(
    ("shape", "start", "end", "expected"),
    [
        (SphereSdf(1.5), at(0, 0), at(0, -1.0), True),
        (SphereSdf(1.5), at(0, 0), at(0, -1.4), False),  # past the middle, almost
        (CapsuleSdf(0.3, 2.0), at(0, 0), at(0, -0.2), True),
        (CapsuleSdf(0.3, 2.0), at(0, 0), at(0, -0.9), False),  # clean through
        (CapsuleSdf(0.3, 2.0), at(0, 5), at(1, 4), True),  # far above
        (CapsuleSdf(0.3, 2.0), at(0, 2), at(0, -2.9), False),
        (CylinderSdf(1.0, 0.2), at(0, 0), at(0, -0.6), True),
        (CylinderSdf(1.0, 0.2), at(0, 0), at(0, -0.9), False),  # the middle would leave through the wall
        (CylinderSdf(0.5, 0.2), at(-1.5, -0.3), at(1.5, -0.3), False),  # swept across
    ],
)
def test_a_step_that_goes_too_far_is_reported(shape: Shape, start: Pose, end: Pose, expected: bool) -> None:
    assert goes(shape, start, end) is expected


def test_a_gel_may_go_round_what_it_may_not_pass_through() -> None:
    """The face moves from one side of a ball to the other, straight or below it."""
    left, right, below = ([x, 0.0, z] for x, z in ((-3.0, 0.0), (3.0, 0.0), (0.0, -1.0)))
    contact = Contact(Faces.on(PATTERN, POINTS, QUADS), SphereSdf(0.3), at(0, -0.3), 0.03, 0.3)
    before = POINTS + left
    gap = contact.gap(before)
    straight, round_it = [POINTS + right], [before + below, POINTS + right + below, POINTS + right]
    assert blocked_along(contact, contact.pose, before, gap, straight)
    assert not blocked_along(contact, contact.pose, before, gap, round_it)
    assert blocked_along(contact, contact.pose, before, gap, [before + below, before, *straight])


def test_what_lies_inside_the_gel_is_found() -> None:
    elastic = [Elastic.on(PATTERN, elements(POINTS, CELLS), NeoHooke(0.05, 0.5))]
    faces = Faces.on(PATTERN, POINTS, QUADS)
    deep = Contact(faces, CapsuleSdf(0.3, 2.0), at(0, -0.8), 0.03, 0.3)
    assert deep.gap(POINTS).min() > 0  # contact sees nothing of it
    assert 0.15 < depth_inside(deep, elastic, POINTS) <= 0.3
    assert depth_inside(deep.moved(at(0, 0.001), 0.0), elastic, POINTS) == 0


@pytest.mark.parametrize("nodes", [4, 3, 6])
def test_what_cuts_in_between_the_points_of_contact_is_reported(nodes: int) -> None:
    """A blunt wedge over the seam of two rows of cells, clear of all points of contact; and a ball, by its sagitta."""
    points, faces, _ = patch(4, 2.0, nodes)
    wedge = WedgeSdf(np.radians(60), 0.05, 1.0)
    contact = Contact(faces, wedge, Pose(np.eye(3), np.array([0.0, 0.0, -0.04])), 0.03, 0.3)
    if nodes == 4:
        assert contact.gap(points).min() > 0
    assert overlap(contact, points) == pytest.approx(0.04, abs=1e-9)
    assert overlap(contact.moved(contact.pose, 0.01), points) == pytest.approx(0.03, abs=1e-9)
    bowl = points.copy()
    bowl[:, 2] = 4.0 - np.sqrt(16 - (points[:, :2] ** 2).sum(1))  # nodes on the ball, the middles of cells inside
    found = overlap(Contact(faces, SphereSdf(4.0), Pose(np.eye(3), np.zeros(3)), 0.03, 0.3), bowl)
    sagitta = 2 * 0.25**2 / 8  # two sides of a cell of .5 mm
    assert 0.01 * sagitta < found < 0.05 * sagitta if nodes == 6 else found == pytest.approx(sagitta, rel=0.1)
    assert overlap(contact.moved(Pose(np.eye(3), np.array([0.0, 0.0, 1.0])), 0.0), points) == 0


def test_a_plate_that_is_pressed_to_its_middle_does_not_leave_the_gel_on_its_far_side() -> None:
    """A halved step ends in the middle of the plate, from where points may be pushed out on either side."""
    made = replace(scene(thin_plate(), poses([(0, 0, -0.2)]), pad=gel(6, 6, 2.0), edge=0.8), dhat=0.01)
    few = replace(made, poses=poses([(0, 0, -0.2 * k / 8) for k in range(1, 9)]), segment=np.zeros(8, int))
    at_once, slowly = ([*states(one, Problem.of(one, mesh.of(one)))][-1] for one in (made, few))
    force = -float(slowly.traction_force[..., 2].sum())
    assert force > 0.1
    assert -float(at_once.traction_force[..., 2].sum()) == pytest.approx(force, rel=1e-3)
