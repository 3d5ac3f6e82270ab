"""What bounces onto a face that has turned."""

import numpy as np
import pytest
from helpers.tiny import sensor

from tacgen.optics.interreflection import TERMS, Bounce, Glow


@pytest.mark.parametrize("turn", [(0.3, -0.3), (-0.5, 0.2), (0.0, 0.0)])
def test_a_turned_face_gets_what_it_would_gather(turn):
    made = sensor()
    bounce = Bounce(made)
    lit = np.where(bounce._at[:, 0] > 0, 1.0, 0.2)  # brighter on the right
    level = bounce._normals[: bounce._coat]
    side = level[:, :2] + turn
    turned = np.ascontiguousarray(np.column_stack([side, -np.sqrt(1 - (side**2).sum(axis=1))]))
    exact = bounce._gather(made, bounce._patches, len(lit), turned) @ lit
    flat = bounce._gather(made, bounce._patches, len(lit), np.ascontiguousarray(level)) @ lit
    terms = np.repeat((bounce._turned @ lit).T[:, :, None], 3, axis=2)
    found = Glow(terms, level[:, :2]).at(turned)
    assert terms.shape[1:] == (TERMS, 3)
    off = np.linalg.norm(found[:, 0] - exact) / np.linalg.norm(exact)
    assert off < 0.04
    assert not any(turn) or off < 0.3 * np.linalg.norm(flat - exact) / np.linalg.norm(exact)
