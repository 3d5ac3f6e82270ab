"""The default quality against `reference`; `python -m benchmarks mechanics` has it for every sensor."""

import numpy as np
import pytest

from benchmarks.reference_runs import BALL, answer, kept


@pytest.mark.slow
def test_default_presses_as_the_reference_does() -> None:
    """Force within 1 %; the pressure map is 4 % off in the mean square, nearly all of it at the rim."""
    press = (*BALL, "trajectory=[{press: {depth_mm: 1.0, frames: 1}}]", "contact.friction=0")
    reference, found = kept((*press, "quality=reference")), answer((*press, "quality=default"))
    assert found.force[-1, 2] == pytest.approx(reference.force[-1, 2], rel=0.01)
    assert found.area == pytest.approx(reference.area, rel=0.04)
    off = found.pressure - reference.pressure
    size = np.linalg.norm(reference.pressure)
    assert 0.01 < np.linalg.norm(off) / size < 0.05
    assert np.linalg.norm(off[reference.pressure > 0.6 * reference.pressure.max()]) < 0.03 * size


@pytest.mark.slow
@pytest.mark.usefixtures("own_cache")
def test_quadratic_tets_draw_the_same_map() -> None:
    """What is left is the grain of their points of contact, 4 % in the middle, and the rim."""
    press = (*BALL, "trajectory=[{press: {depth_mm: 1.0, frames: 1}}]", "contact.friction=0")
    reference, found = kept((*press, "quality=reference")), answer((*press, "quality=default", "mesh=tet"))
    assert found.force[-1, 2] == pytest.approx(reference.force[-1, 2], rel=0.01)
    assert found.area == pytest.approx(reference.area, rel=0.04)
    off, size = found.pressure - reference.pressure, np.linalg.norm(reference.pressure)
    assert 0.03 < np.linalg.norm(off) / size < 0.07
