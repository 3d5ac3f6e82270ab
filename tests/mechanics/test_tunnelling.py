"""An indenter that could pass through the gel unseen is seen."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.presses import gel, poses, scene, thin_plate
from helpers.small import block, patch, tetrahedral, whole

from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import elements
from tacgen.fem.materials import NeoHooke
from tacgen.geometry.analytic_sdf import CapsuleSdf, CylinderSdf, Shape, SphereSdf, WedgeSdf
from tacgen.geometry.pose import Pose
from tacgen.mechanics import Problem, mesh, states
from tacgen.mechanics.barrier import Contact, Faces
from tacgen.mechanics.load_step import LoadStep
from tacgen.mechanics.solve_state import Found
from tacgen.mechanics.tunnelling import blocked, depth_inside, overlap

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
    gap = contact.gaps(POINTS)[0]
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


@pytest.mark.parametrize("nodes", [8, 4, 10])
@pytest.mark.parametrize("radius", [0.3, 0.02])
def test_what_lies_inside_the_gel_is_found(nodes: int, radius: float) -> None:
    """A needle within a block, far thinner than its elements or as thick as they are; and one that lies on it."""
    points, cells = block(2) if nodes == 8 else tetrahedral(*block(2), nodes)
    elastic = [Elastic.on(whole(cells, len(points)), elements(points, cells), NeoHooke(0.05, 0.5))]
    middle, above = (Pose(np.eye(3), np.array([0.41, 0.52, z])) for z in (0.47 - radius, 1.001))
    inside = Contact(Faces.on(PATTERN, POINTS, QUADS), CapsuleSdf(radius, 0.3), middle, 0.03, 0.3)
    most = 0.6 * radius
    assert most < depth_inside(inside, elastic, points, most) <= radius
    assert depth_inside(inside.moved(middle, 0.45 * radius), elastic, points, most) < most
    assert depth_inside(inside.moved(above, 0.0), elastic, points, most) == 0


@pytest.mark.parametrize("nodes", [4, 3, 6])
def test_what_cuts_in_between_the_points_of_contact_is_reported(nodes: int) -> None:
    """A blunt wedge over the seam of two rows of cells, clear of all points of contact; and a ball, by its sagitta."""
    points, faces, _ = patch(4, 2.0, nodes)
    wedge = WedgeSdf(np.radians(60), 0.05, 1.0)
    contact = Contact(faces, wedge, Pose(np.eye(3), np.array([0.0, 0.0, -0.04])), 0.03, 0.3)
    if nodes == 4:
        assert contact.gaps(points)[0].min() > 0
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


def test_a_wall_of_three_cells_that_the_gel_encloses_is_found() -> None:
    """The thinnest that is not refused: its spline is less than half as deep as the wall."""
    made = scene(thin_plate(thickness=0.09, cell=0.03), poses([(0, 0, -0.5)]), pad=gel(6, 6, 2.0), edge=0.8)
    problem = Problem.of(replace(made, dhat=0.01), mesh.of(made))
    rest = problem.rest(at(0, 0.1))
    for z, encloses in ((-0.5, True), (0.001, False)):
        step = LoadStep.of(problem, rest, at(0, z), np.inf).anchored()
        assert step.coupled is not None
        assert (step.wrong(Found.coupled(rest.x, step.coupled, 0)) is not None) == encloses


def test_gel_that_springs_back_below_a_lifted_indenter_is_not_taken_for_passed_through() -> None:
    """A bar that has dragged the gel is lifted clear of it; the straight way of some points leads through the bar."""
    made = scene(CapsuleSdf(0.3, 2.0), poses([(0, 0, 0.02)]), pad=gel(4, 4, 1.0), edge=0.5)
    problem = Problem.of(made, mesh.of(made))
    rest, below = problem.rest(at(0, 0.02)), at(0, -0.35)
    x = rest.x - [0, 0.9, 0]
    bar = below.position[2] + 0.3 - np.sqrt(np.maximum(0.3**2 - x[:, 1] ** 2, 0))
    x[:, 2] = np.where(np.abs(x[:, 1]) < 0.3, np.minimum(x[:, 2], bar), x[:, 2])
    dragged = replace(rest, pose=below, x=x, gap=problem.contact.distance.moved(below, 0.0).gaps(x)[0])
    step = LoadStep.of(problem, dragged, Pose.of(made.poses[0]), np.inf).anchored()
    assert step.coupled is not None
    assert blocked(step.contact, below, x, dragged.gap, rest.x)
    assert step.wrong(Found.coupled(rest.x, step.coupled, 0)) is None
