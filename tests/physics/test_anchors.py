"""Answers that are known in closed form: Hertz, a bonded layer, partial slip, a twisted punch.

Lengths are ten to a hundred times those of a sensor, for the tolerances of the solver and the slip over which friction
builds up are lengths, and would show; nothing else knows of a scale.
"""

import numpy as np
import pytest
from helpers import blocks
from helpers.presses import Run, gel, poses, scene

from tacgen.geometry.analytic_sdf import CylinderSdf, SphereSdf

Array = np.ndarray
E = 0.15
R, A = 200.0, 10.0  # ball and, for a half space, contact radius
DEPTH = A**2 / R
FRICTION = 0.5
DRAG = 0.17  # some 60 % of full slip
PUNCH = 0.2  # how deep the punch is pressed before it is turned


def dimitriadis(nu: float, chi: float) -> float:
    """Force of a ball on a bonded layer over that on a half space, chi = sqrt(R depth)/thickness: Dimitriadis, Horkay,
    Maresca, Kachar & Chadwick (2002), Biophys. J. 82, 2798, Eqs. 12-13; to fourth order, for chi well below 1."""
    alpha = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1 - nu)
    beta = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1 - nu)
    c = chi / np.pi
    third = alpha**3 + 4 * np.pi**2 / 15 * beta
    fourth = alpha**3 + 3 * np.pi**2 / 5 * beta
    return 1 - 2 * alpha * c + 4 * alpha**2 * c**2 - 8 * third * c**3 + 16 * alpha * fourth * c**4


def pressed(nu: float, thickness: float, edge: float) -> Run:
    """A quarter of a ball's press, without friction, by DEPTH."""
    x = blocks.ticks(1.4 * A, 60 * A, edge)
    grid = blocks.block(x, x, -blocks.ticks(A, thickness, edge)[::-1])
    pad = gel(120 * A, 120 * A, thickness, E, nu)
    return blocks.run(scene(SphereSdf(R), poses([(0, 0, -DEPTH)]), pad=pad, edge=edge), grid, (0, 1))


@pytest.mark.slow
@pytest.mark.parametrize(("nu", "edge"), [(0.3, A / 8), (0.48, A / 6)])
def test_hertz(nu: float, edge: float) -> None:
    """Force and peak pressure within 2 % on a block 60 contact radii thick and wide; its base still gives 1 to 2 %."""
    found = pressed(nu, 60 * A, edge)
    stiffness = E / (1 - nu**2)
    force = 4 / 3 * stiffness * np.sqrt(R) * DEPTH**1.5 * dimitriadis(nu, 1 / 60)
    peak = (6 * force * stiffness**2 / (np.pi**3 * R**2)) ** (1 / 3)
    state, faces = found.states[-1], found.problem.contact.faces
    nodes = len(state.x)
    pressure = faces.scatter(state.normal_force[..., None], nodes) / faces.scatter(faces.areas[..., None], nodes).clip(
        1e-9
    )
    assert -4 * found.forces[-1, 2] == pytest.approx(force, rel=0.02)
    assert pressure.max() == pytest.approx(peak, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("nu", "chi"), [(0.3, 0.2), (0.4999, 0.1), (0.4999, 0.2)])
def test_a_bonded_layer(nu: float, chi: float) -> None:
    """Within 3 %. At chi = .3 the series itself is 3 % low: Garcia & Garcia (2018) have larger terms from chi^2 on."""
    force = 4 / 3 * E / (1 - nu**2) * np.sqrt(R) * DEPTH**1.5 * dimitriadis(nu, chi)
    found = -4 * pressed(nu, A / chi, A / 6).forces[-1, 2]
    assert found == pytest.approx(force, rel=0.03)
    assert dimitriadis(nu, chi) > 1.1  # and not that of the half space


@pytest.fixture(scope="module")
def dragged() -> Run:
    """Half a ball pressed and then moved along x by less than makes it slip all over; nothing couples at nu = .5."""
    x = blocks.ticks(1.5 * A, 60 * A, A / 6, both=True)
    grid = blocks.block(x, blocks.ticks(1.5 * A, 60 * A, A / 6), -blocks.ticks(A, 60 * A, A / 6)[::-1])
    pad = gel(120 * A, 120 * A, 60 * A, E, 0.4999)
    path = poses([(0, 0, -DEPTH), (DRAG / 2, 0, -DEPTH), (DRAG, 0, -DEPTH)])
    return blocks.run(scene(SphereSdf(R), path, pad=pad, friction=FRICTION, edge=A / 6), grid, (1,))


@pytest.mark.slow
def test_partial_slip_sticks_in_a_circle(dragged: Run) -> None:
    """Cattaneo (1938), Mindlin (1949): c/a = (1 - Q/(friction P))^(1/3), the stuck radius within 5 %; Johnson, 7.2."""
    state, force = dragged.states[-1], dragged.forces[-1]
    assert state.sliding is not None
    areas, touching = dragged.problem.contact.faces.areas, state.normal_force > 0
    stuck = np.sqrt(areas[touching & ~state.sliding].sum() / areas[touching].sum())
    share = force[0] / (FRICTION * -force[2])
    assert 0.3 < share < 0.8
    assert stuck == pytest.approx((1 - share) ** (1 / 3), rel=0.05)
    at = dragged.problem.contact.faces.at(state.x) - [DRAG, 0, 0]
    radius = np.hypot(at[..., 0], at[..., 1])
    assert not state.sliding[radius < 0.85 * stuck * A].any()
    assert state.sliding[touching & (radius > 1.15 * stuck * A)].all()


@pytest.mark.slow
def test_partial_slip_resists_as_it_should(dragged: Run) -> None:
    """Q = friction P (1 - (1 - drag/full)^(3/2)), full = friction depth (2 - nu)/(2 (1 - nu)), within 5 %."""
    full = FRICTION * DEPTH * 1.5
    for drag, force in zip((DRAG / 2, DRAG), dragged.forces[1:], strict=True):
        assert force[0] / (FRICTION * -force[2]) == pytest.approx(1 - (1 - drag / full) ** 1.5, rel=0.05)


RINGS = A * np.array([0, 0.3, 0.55, 0.75, 0.88, 0.95, 0.98, 1, 1.02, 1.06, 1.15, 1.35, 1.75, 2.5, 4.2, 8])
LEVELS = A * np.array([0, 0.05, 0.12, 0.25, 0.45, 0.75, 1.2, 2, 3, 4])


@pytest.mark.slow
def test_a_stuck_punch_is_turned() -> None:
    """Reissner & Sagoci (1944): T = 16/3 mu a^3 angle, within 3 %; the base, 4 a below, adds 0.1 %."""
    angle, mu = np.radians(1), E / (2 * 1.48)
    x = np.concatenate([-RINGS[:0:-1], RINGS])
    grid = blocks.rounded(blocks.block(x, x, -LEVELS[::-1]), A)
    path = np.concatenate([poses([(0, 0, -PUNCH)], yaw=turn) for turn in (0, angle)])
    pad = gel(16 * A, 16 * A, 4 * A, E, 0.48)
    found = blocks.run(scene(CylinderSdf(A, 0.1), path, pad=pad, friction=5.0, edge=A / 8), grid)
    faces, state = found.problem.contact.faces, found.states[-1]
    torque = np.cross(faces.at(state.x), state.traction_force).sum((0, 1))[2]
    assert torque == pytest.approx(16 / 3 * mu * A**3 * angle * (1 + 0.0957 / 4**3), rel=0.03)
    assert np.abs(found.forces[-1, :2]).max() < 1e-3 * -found.forces[-1, 2]
