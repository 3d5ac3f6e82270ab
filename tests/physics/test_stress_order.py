"""Recovered stress: its order of convergence on a manufactured solution, at the nodes and on the faces."""

import numpy as np
import pytest
from helpers.small import Load, Total

from physics.test_elements import ELEMENTS, LAW, block, inside, solve, u
from tacgen.fem.assembly import pattern
from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import elements
from tacgen.fem.stress_recovery import Recovery
from tacgen.outputs.cauchy_stress import VOIGT_PAIRS, voigt

Array = np.ndarray


def exact(X: Array) -> tuple[Array, Array]:
    """First Piola-Kirchhoff and Cauchy stress (..., 3, 3) [MPa] of x = X + u(X)."""
    h = 1e-6
    F = np.eye(3) + np.stack([(u(X + h * axis) - u(X - h * axis)) / (2 * h) for axis in np.eye(3)], -1)
    J, G = np.linalg.det(F)[..., None, None], np.linalg.inv(F).swapaxes(-1, -2)
    I1 = (F**2).sum((-1, -2))[..., None, None]
    P = LAW.mu * J ** (-2 / 3) * (F - I1 / 3 * G) + LAW.kappa / 2 * (J**2 - 1) * G
    return P, P @ F.swapaxes(-1, -2) / J


def errors(n: int, nodes: int) -> tuple[float, float, float]:
    """On an n^3 block with uneven sides: rms error of Cauchy stress at all nodes, at those on the faces, and of the
    elements' own stress at the integration points [MPa]."""
    points, cells = block(n, 0.0, nodes)
    points = points + 0.15 * points * (1 - points)  # graded
    pat = pattern([cells], inside(points))
    e = elements(points, cells)
    body = Elastic.on(pat, e, LAW)
    at = np.einsum("qa,eai->eqi", e.shape, points[cells])
    force = np.zeros_like(points)
    np.add.at(force, cells, np.einsum("eq,eqiJ,eqaJ->eai", e.weights, exact(at)[0], e.gradients))
    x = solve(Total((body, Load(force))), points + u(points), pat)
    recovery = Recovery.on(points, cells, np.zeros(len(cells), int))
    wanted = exact(points)[1]
    found = recovery.outermost(recovery.matrix @ voigt(body.mean_stress(body.evaluate(x))[0]), len(points))
    off = found - np.stack([wanted[:, i, j] for i, j in VOIGT_PAIRS], -1)
    rim = ~inside(points)[:, 0]
    raw = body.cauchy(body.evaluate(x))[0] - exact(at)[1]
    everywhere, faces, own = (float(np.sqrt(np.mean(d**2))) for d in (off, off[rim], raw))
    return everywhere, faces, own


@pytest.mark.parametrize(("kind", "sizes"), [("hex", (4, 6, 9, 13)), ("tet", (2, 3, 4, 6))])
def test_recovered_stress_is_of_second_order_up_to_the_faces(kind: str, sizes: tuple[int, ...]) -> None:
    found = np.array([errors(n, ELEMENTS[kind]) for n in sizes])
    everywhere, faces, _ = -np.polyfit(np.log(sizes), np.log(found), 1)[0]
    assert 1.7 < everywhere < 2.6, found
    assert 1.5 < faces < 2.6, found
    assert found[-1, 0] < found[-1, 2] or kind == "tet", found  # better than the hexes' own
