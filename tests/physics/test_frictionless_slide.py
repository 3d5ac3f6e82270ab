"""A rigid indenter slides over a plane without friction: its tangential force is 0 and its normal force constant.

The published check of a contact simulator's normals. A mesh breaks the plane's symmetry, so both hold up to an error
that decreases with the edge; docs/cookbook/other_simulators.md has it for three edges.
"""

import numpy as np
import pytest
from helpers.presses import poses, run, scene

from tacgen.geometry.analytic_sdf import CylinderSdf, Shape, SphereSdf

Array = np.ndarray
BALL, PUNCH = SphereSdf(3.0), CylinderSdf(2.0, 0.5)


def errors(shape: Shape, edge: float, frames: int = 7) -> tuple[float, float]:
    """Largest tangential force, and range of the normal force, over the normal force [-].

    The slide is oblique to the mesh and some edges long.
    """
    part = np.linspace(0, 1, frames + 1)
    path = [(-1.0 + 2.0 * s, -0.35 + 0.7 * s, -0.5) for s in part]
    force = run(scene(shape, poses(path), edge=edge)).forces
    normal = -force[:, 2]
    assert normal.min() > 0.2
    return float(np.hypot(*force[:, :2].T).max() / normal.mean()), float(np.ptp(normal) / normal.mean())


@pytest.mark.parametrize(("shape", "side", "spread"), [(BALL, 0.006, 0.025), (PUNCH, 0.025, 0.015)])
def test_a_slide_without_friction_has_no_drag_and_a_constant_normal_force(
    shape: Shape, side: float, spread: float
) -> None:
    """Measured at draft: 0.4 and 1.9 % for a ball, 1.9 and 0.8 % for a flat punch with a rim of 0.5 mm."""
    tangential, normal = errors(shape, 0.6)
    assert tangential < side
    assert normal < spread


@pytest.mark.slow
def test_the_error_decreases_with_the_mesh() -> None:
    """Measured from 0.6 to 0.36 mm: by factors of 3.2 and 3.9."""
    coarse, fine = errors(BALL, 0.6, 4), errors(BALL, 0.36, 4)
    assert fine[0] < coarse[0] / 2
    assert fine[1] < coarse[1] / 2
    assert min(fine) > 0
