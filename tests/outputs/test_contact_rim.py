"""The gap beside a contact: Hertz's between the nodes of a coarse mesh, and a finer mesh's face."""

import numpy as np
import pytest
from helpers.presses import gel, poses, run, scene

from tacgen.geometry.analytic_sdf import SphereSdf
from tacgen.geometry.clough_tocher import CloughTocher
from tacgen.outputs import contact_rim

Array = np.ndarray
BALL, CONTACT, EDGE = 4.0, 1.8, 0.6


def hertz(r: Array) -> Array:
    """Gap (n,) [mm] under a ball at radii r (n,) [mm]; Johnson 1985, equation 3.42a."""
    share = CONTACT / np.maximum(r, CONTACT)
    deep = (2 - 1 / share**2) * np.arcsin(share) + np.sqrt(1 - share**2) / share
    return CONTACT**2 / BALL * (deep / np.pi - 1) + np.maximum(r, CONTACT) ** 2 / (2 * BALL)


def grid(shift: tuple[float, float] = (0.11, 0.23)) -> Array:
    line = np.arange(-5, 5.01, EDGE)
    return np.stack(np.meshgrid(line, line), -1).reshape(-1, 2) + shift


def test_between_coarse_nodes_the_gap_is_hertzs() -> None:
    at, random = grid(), np.random.default_rng(0)
    radius, angle = random.uniform(0.5, CONTACT + EDGE, 500), random.uniform(0, 2 * np.pi, 500)
    between, r = np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1), np.linalg.norm(at, axis=1)
    found = contact_rim.openings(at, hertz(r), r <= CONTACT, EDGE)
    assert found is not None
    smooth = CloughTocher(at)
    opening, weight = smooth.at(between, smooth.nodal(found)).T
    plain = smooth.at(between, smooth.nodal(hertz(r)[:, None]))[:, 0]
    off, before = (np.sqrt(np.mean((gap - hertz(radius)) ** 2)) for gap in (contact_rim.gaps(opening), plain))
    assert weight.min() > 0.85
    assert off < 2e-3 < 4e-3 < before  # [mm]
    assert (contact_rim.gaps(opening)[radius < 0.9 * CONTACT] == 0).all()


def test_noise_of_the_nodes_is_smoothed() -> None:
    at, random = grid(), np.random.default_rng(0)
    r = np.linalg.norm(at, axis=1)
    off = []
    for gap in (hertz(r), hertz(r) + random.normal(0, 0.005, len(r))):
        found = contact_rim.openings(at, gap, r <= CONTACT, EDGE)
        assert found is not None
        beside = (r > CONTACT) & (r < CONTACT + EDGE)
        off.append(np.sqrt(np.mean((contact_rim.gaps(found[beside, 0]) - hertz(r[beside])) ** 2)))
    assert off[0] < 0.002
    assert off[1] < 0.0045


def test_far_from_the_contact_nothing_is_changed() -> None:
    at, r = grid(), np.linalg.norm(grid(), axis=1)
    found = contact_rim.openings(at, hertz(r), r <= CONTACT, EDGE)
    assert found is not None
    assert (found[r > CONTACT + contact_rim.MAX_OPENING_EDGES * EDGE, 1] == 0).all()


@pytest.mark.parametrize("closed", [np.zeros(289, bool), np.ones(289, bool)])
def test_without_a_rim_there_is_no_opening(closed: Array) -> None:
    assert contact_rim.openings(grid(), np.ones(289), closed, EDGE) is None


def test_the_rim_of_a_coarse_mesh_is_that_of_a_finer_one() -> None:
    """Normals in a ring about the rim of a ball's dent, against those of the same nodes without the indenter."""
    line = np.linspace(-2, 2, 81)
    middle = np.array([0.2, 0.1])
    at = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2) + middle
    ring = np.abs(np.hypot(*(at - middle).T) - 1.4) < 0.5

    def normals(edge: float, *, plain: bool = False) -> Array:
        pressed = run(scene(SphereSdf(4.0), poses([(0.2, 0.1, -0.4)]), pad=gel(6.5, 6.5, 2.5), edge=edge))
        (state,) = pressed.states
        face = pressed.face.moved(state.x) if plain else pressed.face.pressed(pressed.problem, state)
        normals = np.cross(*(face.at(at + by) - face.at(at - by) for by in np.eye(2) * 0.05))
        return (normals / np.linalg.norm(normals, axis=1, keepdims=True))[ring]

    oracle, found, before = normals(0.3), normals(EDGE), normals(EDGE, plain=True)
    off, was = (np.degrees(np.sqrt(((one - oracle) ** 2).sum(1).mean())) for one in (found, before))
    assert off < 0.75 * was
