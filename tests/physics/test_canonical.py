"""The three canonical modes of TaCauchy, press, slide and twist of a flat punch on a GelSight Mini, in a bundle's maps.

Bundles hold the traction on the gel. A pressed punch makes the gel flow outward beneath it, so its friction on the gel
points inward, and the gel's on the punch outward: TaCauchy draws the latter, and so do these tests, by a minus sign.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from tacgen.batch import pipeline
from tacgen.bundle import bundle
from tacgen.recipe import assets, plan

Array = np.ndarray
RADIUS, FRICTION, MM_PER_PX = 3.0, 0.5, 0.0634
PRESSED, DRAGGED, SLID, PRESSED_AGAIN, TWISTED = 0, 1, 3, 6, 9  # frames of the recipe


@dataclass(frozen=True)
class Maps:
    """Pressure p and traction on the punch (tx, ty) at x, y from its axis [mm], and indices that have no unit."""

    x: Array
    y: Array
    p: Array
    tx: Array
    ty: Array

    @property
    def size(self) -> Array:
        return np.hypot(self.tx, self.ty)

    def lean(self, along: Array) -> float:
        """How far the pressure's centroid is off the axis, in radii."""
        return float((self.p * along).sum() / self.p.sum() / RADIUS)

    def radial(self, where: Array | float = 1.0) -> float:
        """1 where traction points away from the axis, -1 towards it."""
        arm = np.hypot(self.x, self.y) * self.size * where
        return float(((self.tx * self.x + self.ty * self.y) * where).sum() / arm.sum())

    def swirl(self) -> float:
        """1 where traction turns from x to y around the axis."""
        return float((self.x * self.ty - self.y * self.tx).sum() / (np.hypot(self.x, self.y) * self.size).sum())

    def along_x(self) -> float:
        """1 where all traction points along x."""
        return float(self.tx.sum() / self.size.sum())

    def spread(self, where: Array) -> float:
        """Positive where traction opens to both sides of the way, y = 0."""
        return float((self.ty * self.y * where).sum() / (self.size * np.hypot(self.x, self.y) * where).sum())


@pytest.fixture(scope="module")
def modes(tmp_path_factory: pytest.TempPathFactory) -> list[Maps]:
    folder: Path = tmp_path_factory.mktemp("canonical")
    row = plan.load(assets.recipe_path("canonical_modes")).rows[0]
    camera = row.sensor.camera.model_copy(update={"crop_mm": (0.0, 0.0)})  # the shipped one is fitted off the middle
    row = replace(row, sensor=row.sensor.model_copy(update={"camera": camera}))
    frames = bundle.read(pipeline.run_scene(row, folder).path)
    pressure, traction, pose = (frames[f"/frames/{name}"] for name in ("pressure", "traction", "pose"))
    h, w = pressure.shape[1:]
    y, x = (np.mgrid[:h, :w] - np.array([h - 1, w - 1])[:, None, None] / 2) * MM_PER_PX
    return [
        Maps(x - T[0, 3], y - T[1, 3], np.nan_to_num(p), *-np.nan_to_num(np.moveaxis(t, -1, 0)))
        for p, t, T in zip(pressure, traction, pose, strict=True)
    ]


@pytest.mark.slow
def test_press_is_symmetric_and_drags_outward(modes: list[Maps]) -> None:
    for frame in (PRESSED, PRESSED_AGAIN):
        m = modes[frame]
        assert abs(m.lean(m.x)) < 0.02
        assert abs(m.lean(m.y)) < 0.02
        for turned in (m.p[:, ::-1], m.p[::-1]):
            assert np.abs(m.p - turned).sum() < 0.05 * m.p.sum()  # .018
        assert m.radial() > 0.95
        assert abs(m.swirl()) < 0.03
        assert np.hypot(m.tx.sum(), m.ty.sum()) < 0.03 * m.size.sum()
        rim, middle = (np.abs(np.hypot(m.x, m.y) - r) < 0.3 for r in (2.4, 0.3))
        assert 1.2 < m.p[rim].mean() / m.p[middle].mean() < 2.0  # a punch bears on its rim
        assert m.size[rim].mean() > 4 * m.size[middle].mean()


@pytest.mark.slow
def test_slide_tilts_forward_is_opposed_and_spreads_in_front(modes: list[Maps]) -> None:
    first, last = modes[DRAGGED], modes[SLID]
    front, rear = first.x > 0.5, first.x < -0.5
    assert 0.01 < first.lean(first.x) < last.lean(last.x) < 0.15
    assert abs(last.lean(last.y)) < 0.02
    assert 1.1 < last.p[last.x > 0.5].sum() / last.p[last.x < -0.5].sum() < 2
    assert 2.2 < last.x.flat[last.p.argmax()] < 3.2  # the peak is at the leading rim
    assert -1 <= last.along_x() < -0.97  # all of it opposes the slide
    assert -0.95 < first.along_x() < -0.7
    assert last.size.sum() / last.p.sum() == pytest.approx(FRICTION, rel=0.03)
    # while some still sticks, the press's spread is left in front, more than behind; it fades in full slip
    assert first.spread(front) > 0.2
    assert first.spread(front) > 1.3 * first.spread(rear)
    assert abs(last.spread(last.x > 0.5)) < 0.1


@pytest.mark.slow
def test_twist_is_symmetric_and_swirls(modes: list[Maps]) -> None:
    swirls = [modes[frame].swirl() for frame in range(PRESSED_AGAIN, TWISTED + 1)]
    assert (np.diff(swirls) < 0).all()  # ever more against the turn, which goes from x to y
    m = modes[TWISTED]
    assert -1 <= swirls[-1] < -0.9
    assert abs(m.lean(m.x)) < 0.02
    assert abs(m.lean(m.y)) < 0.02
    assert np.hypot(m.tx.sum(), m.ty.sum()) < 0.03 * m.size.sum()
    full = FRICTION * (m.p * np.hypot(m.x, m.y)).sum()
    assert 0.8 < -(m.x * m.ty - m.y * m.tx).sum() / full < 1.0  # its moment, of that of full slip
