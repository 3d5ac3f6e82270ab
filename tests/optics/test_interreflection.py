"""What bounces onto a face that has turned."""

import numpy as np
import pytest
from helpers.tiny import sensor

from tacgen.optics import interreflection, strip_light
from tacgen.optics.interreflection import NORMAL_TERMS, Glow, Radiosity
from tacgen.sensor.model import Solid


@pytest.mark.parametrize("turn", [(0.3, -0.3), (-0.5, 0.2), (0.0, 0.0)])
def test_a_turned_face_gets_what_it_would_gather(turn):
    made = sensor()
    bounce = Radiosity(made)
    lit = np.where(bounce._at[:, 0] > 0, 1.0, 0.2)  # brighter on the right
    level = bounce._normals[: bounce._coat]
    side = level[:, :2] + turn
    turned = np.ascontiguousarray(np.column_stack([side, -np.sqrt(1 - (side**2).sum(axis=1))]))
    exact = bounce._gather(bounce._patches, len(lit), normals=turned) @ lit
    flat = bounce._gather(bounce._patches, len(lit), normals=np.ascontiguousarray(level)) @ lit
    terms = np.repeat((bounce._form_factor_terms @ lit).T[:, :, None], 3, axis=2).astype(np.float32)
    found = Glow(terms, level[:, :2]).at(turned)
    assert terms.shape[1:] == (NORMAL_TERMS, 3)
    off = np.linalg.norm(found[:, 0] - exact) / np.linalg.norm(exact)
    assert off < 0.04
    assert not any(turn) or off < 0.3 * np.linalg.norm(flat - exact) / np.linalg.norm(exact)


def test_the_light_of_a_normal_is_its_polynomial():
    rng = np.random.default_rng(0)
    terms, level = rng.normal(size=(50, NORMAL_TERMS, 3)).astype(np.float32), rng.uniform(-0.3, 0.3, (50, 2))
    normal, index = rng.uniform(-1, 1, (50, 3)), rng.choice(50, 20, replace=False)
    normal[index[3]] = np.nan  # beside the pad
    x, y = np.clip(normal[:, :2] - level, -0.9, 0.9).T[..., None]
    one, by_x, by_y, by_xx, by_yy = np.moveaxis(terms, 1, 0)
    expected = one + x * by_x + y * by_y + x**2 * by_xx + y**2 * by_yy
    assert (expected < 0).any()
    expected = np.nan_to_num(np.maximum(expected, 0))
    assert Glow(terms, level).at(normal) == pytest.approx(expected, rel=1e-12)
    assert Glow(terms, level).at(normal, index) == pytest.approx(expected[index], rel=1e-12)


class Dome:
    """A spherical cap of 3 mm, on a pad whose box is larger."""

    def at(self, xy):
        r2 = (np.asarray(xy) ** 2).sum(axis=1)
        z = np.sqrt(np.maximum(6.0**2 - r2, 0)) - 6.0
        return np.column_stack([xy, np.where(r2 < 4.6**2, z, np.nan)])


def test_patches_beyond_a_solids_outline_do_no_harm():
    """They shrink to nothing at its rim, next to patches of full size: those gave more than all around can."""
    made = sensor()
    solid = Solid(file="dome.stl", source="test")
    made = made.model_copy(update={"gel": made.gel.model_copy(update={"solid": solid})})
    bounce = Radiosity(made, Dome())
    assert bounce._form_factors.sum(axis=1).max() <= 1 + 1e-9
    added = bounce.added(made, strip_light.points(made.leds, 4, 2))
    here = np.abs(added).max(axis=(1, 2, 3))
    assert here.max() < 30 * np.median(here[np.linalg.norm(bounce._at[: len(here), :2], axis=1) < 3])


def test_beside_a_patch_that_an_led_all_but_touches_no_spot_is_dark():
    coarse = np.full((9, 11, 2), 1.0)
    coarse[4, 5] = 60.0
    found = interreflection.finer(coarse)
    assert found.min() >= 1.0 - 1e-9
    assert found.max() <= 60.0 + 1e-9
    y, x = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 11), indexing="ij")
    smooth = interreflection.finer(np.exp(x - y**2)[..., None])[..., 0]  # and what is smooth stays the spline's
    fine_y, fine_x = np.meshgrid(np.linspace(-1, 1, 36), np.linspace(-1, 1, 44), indexing="ij")
    assert smooth[8:-8, 8:-8] == pytest.approx(np.exp(fine_x - fine_y**2)[8:-8, 8:-8], rel=0.01)
