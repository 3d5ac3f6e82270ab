"""The recipes that train forces: zero is among them, edges suit the mesh, and large forces are planned."""

import numpy as np
import pytest

from tacgen.recipe import assets, plan


@pytest.mark.parametrize(("name", "part"), [("baseline_force", 50), ("unit_forces", 10)])
def test_each_scene_begins_untouched_and_has_no_edge_finer_than_its_mesh(name: str, part: int) -> None:
    for row in plan.load(assets.recipe_path(name), [], (0, part)).rows:
        quality, (first, *_) = row.recipe.resolved(), row.recipe.trajectory
        assert first.kind == "hold"
        assert row.recipe.start.clearance_mm > quality.dhat_mm
        indenter = row.recipe.indenter.model_dump()
        radii = [indenter[key] for key in ("fillet_mm", "tube_radius_mm", "radius_mm") if indenter.get(key)]
        assert min(radii) >= 3 * quality.edge_mm - 1e-9, indenter


def test_a_tenth_of_the_planned_frames_passes_30_n_and_a_third_14() -> None:
    rows = plan.load(assets.recipe_path("baseline_force"), [], (0, 5)).rows
    most = np.array([row.recipe.trajectory[1].press.force_n for row in rows])
    frames = np.concatenate([most[:, None] * np.arange(7) / 6, most[:, None], most[:, None]], axis=1)
    assert (frames > 14).mean() > 1 / 3
    assert (frames > 30).mean() > 0.1
    assert 43 < most.max() <= 45
