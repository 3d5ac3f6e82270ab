"""The look-up table of light: what it must reproduce exactly, and what it may not do."""

import numpy as np
import pytest

from tacgen.optics import taxim_table

LAMP = np.array([[4.0, -9.0, -1.0, 4.0, 9.0, -1.0, 0.5]])  # a strip along y at x = 4 mm, 1 mm below the face


def face(seed: int, shape: tuple[int, int] = (60, 80)) -> taxim_table.Face:
    slope = np.random.default_rng(seed).uniform(-0.6, 0.6, (*shape, 2))
    return taxim_table.Face(np.zeros(shape), slope)


def light(one: taxim_table.Face) -> np.ndarray:
    """Linear in the slope, and more of it to the right."""
    x = taxim_table.quadratic_basis(one.height.shape)[..., 1]
    return np.stack([(1 + 0.5 * x) * (one.slope @ w) for w in ((0.3, 0.1), (-0.2, 0.4), (0.0, 0.5))], axis=-1)


@pytest.mark.slow
def test_it_learns_light_that_follows_slope_and_place():
    faces = [face(seed) for seed in range(6)]
    made = taxim_table.TaximTable.fitted(faces, [light(one) for one in faces], LAMP, 0.1)
    other = face(99)
    expected = light(other)
    off = np.sqrt(np.mean((made.added(other, LAMP, 0.1) - expected) ** 2))
    assert off < 0.05 * np.sqrt(np.mean(expected**2))


def test_slopes_never_seen_are_filled_from_the_nearest_ones():
    faces = [face(seed) for seed in range(6)]
    made = taxim_table.TaximTable.fitted(faces, [light(one) for one in faces], LAMP, 0.1)
    steep = taxim_table.Face(np.zeros((4, 4)), np.full((4, 4, 2), 0.95))
    assert np.isfinite(made.added(steep, LAMP, 0.1)).all()


@pytest.mark.parametrize("shape", [(4, 4), (3, 9), (9, 3), (8, 8)])
def test_pictures_of_few_pixels_have_their_part_of_the_light(shape: tuple[int, int]):
    flat = taxim_table.Face(np.zeros(shape), np.zeros((*shape, 2)))
    terms = np.zeros((taxim_table.SLOPE_BINS, taxim_table.SLOPE_BINS, 6, 3))
    terms[..., 0, :] = 0.25
    table = taxim_table.TaximTable(terms, np.array([[1.0, 1.0, 1.0]]))
    assert table.added(flat, LAMP, 0.1) == pytest.approx(0.25)


def test_lamps_are_mixed_by_their_light():
    rng = np.random.default_rng(1)
    alone = [
        taxim_table.TaximTable(
            rng.normal(size=(taxim_table.SLOPE_BINS, taxim_table.SLOPE_BINS, 6, 3)), rng.uniform(size=(1, 3))
        )
        for _ in range(2)
    ]
    kept = [taxim_table.TaximTable.unpacked(one.packed) for one in alone]
    rgb = np.array([[1.0, 0.0, 2.0], [0.0, 3.0, 1.0]])
    both = taxim_table.TaximTable.mixed(kept, rgb)
    assert both.terms == pytest.approx(sum(one.terms * part for one, part in zip(alone, rgb, strict=True)))
    assert both.shade == pytest.approx(np.array([one.shade[0] * part for one, part in zip(alone, rgb, strict=True)]))


def test_what_a_lamp_is_hidden_from_is_darker():
    height = np.zeros((40, 80))
    height[:, 50:53] = -2.0
    shade = taxim_table.TaximTable(
        np.zeros((taxim_table.SLOPE_BINS, taxim_table.SLOPE_BINS, 6, 3)), np.array([[0.5, 0.2, 0.0]])
    )
    found = shade.added(taxim_table.Face(height, np.zeros((40, 80, 2))), LAMP, 0.1)
    assert found[20, 46] == pytest.approx([-0.5, -0.2, 0.0])
    assert (found[:, 60:] == 0).all()
