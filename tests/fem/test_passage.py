"""An indenter that could pass through the gel unseen is seen."""

import numpy as np
import pytest

from tacgen.fem.assembly import pattern
from tacgen.fem.contact import Contact, Faces, Pose
from tacgen.fem.elements import hexes
from tacgen.fem.materials import NeoHooke
from tacgen.fem.passage import blocked, sunk
from tacgen.fem.potentials import Elastic
from tacgen.fem.shapes import Capsule, Cylinder, Shape, Sphere

from .small import block, whole

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
        (Sphere(1.5), at(0, 0), at(0, -1.0), True),
        (Sphere(1.5), at(0, 0), at(0, -1.4), False),  # past the middle, almost
        (Capsule(0.3, 2.0), at(0, 0), at(0, -0.2), True),
        (Capsule(0.3, 2.0), at(0, 0), at(0, -0.9), False),  # clean through
        (Capsule(0.3, 2.0), at(0, 5), at(1, 4), True),  # far above
        (Capsule(0.3, 2.0), at(0, 2), at(0, -2.9), False),
        (Cylinder(1.0, 0.2), at(0, 0), at(0, -0.6), True),
        (Cylinder(1.0, 0.2), at(0, 0), at(0, -0.9), False),  # the middle would leave through the wall
        (Cylinder(0.5, 0.2), at(-1.5, -0.3), at(1.5, -0.3), False),  # swept across
    ],
)
def test_a_step_that_goes_too_far_is_told(shape: Shape, start: Pose, end: Pose, expected: bool) -> None:
    assert goes(shape, start, end) is expected


def test_what_lies_inside_the_gel_is_found() -> None:
    elastic = [Elastic.on(pattern([CELLS], np.ones((len(POINTS), 3), bool)), hexes(POINTS, CELLS), NeoHooke(0.05, 0.5))]
    faces = Faces.on(PATTERN, POINTS, QUADS)
    deep = Contact(faces, Capsule(0.3, 2.0), at(0, -0.8), 0.03, 0.3)
    assert deep.gaps(POINTS)[0].min() > 0  # contact sees nothing of it
    assert 0.15 < sunk(deep, elastic, POINTS) <= 0.3
    assert sunk(deep.moved(at(0, 0.001), 0.0), elastic, POINTS) == 0
