"""Patterns that meshes share: each scene's own mesh lies in one, unchanged."""

import numpy as np
import pytest
from helpers import presses
from helpers.needs import needs

needs("torch")

from benchmarks.gpu import scene_of
from tacgen.geometry.analytic_sdf import SphereSdf
from tacgen.mechanics import mesh
from tacgen.tensor_engine import grids
from tacgen.tensor_engine.dissection import _entries, dissected
from tacgen.tensor_engine.grids import GridPattern
from tacgen.tensor_engine.planning import Planned
from tensor_engine.batches import embedded


@pytest.mark.parametrize("index", [0, 2, 5, 10])  # DIGIT's outline has an arc
def test_an_embedded_mesh_is_the_scenes_own(index):
    scene = scene_of(index, "draft")
    own, (pattern, found) = mesh.of(scene), embedded(scene)
    assert (found.points[found.nodes] == own.points).all()
    renamed = np.full(pattern.size, -1)
    renamed[found.nodes] = np.arange(len(found.nodes))
    assert (renamed[pattern.hexes[found.cells]] == own.cells).all()
    assert (renamed[pattern.facets[found.facets]] == own.facets["coated"]).all()


def test_contact_stays_on_the_patch():
    scene = scene_of(10, "draft")
    (pattern, found), (x0, x1, y0, y1) = embedded(scene), mesh.footprint(scene)
    x, y, z = found.points[found.nodes].T
    near = found.nodes[(x > x0 - 1e-9) & (x < x1 + 1e-9) & (y > y0 - 1e-9) & (y < y1 + 1e-9) & (z == 0)]
    assert near.size
    assert np.isin(near, pattern.patch).all()


def test_void_cells_are_boxes_too():
    pattern, found = embedded(scene_of(0, "draft"))
    corner, *others = found.points[pattern.hexes[:, [0, 1, 3, 4]]].transpose(1, 0, 2)
    volume = np.linalg.det(np.stack([other - corner for other in others], 1))
    assert len(found.cells) < len(volume)
    assert (volume > 0).all()


def test_scenes_of_unlike_sizes_share_a_pattern():
    pad = presses.gel()
    paths = [[(x, y, -0.4)] for x, y in ((0.0, 0.0), (0.9, -1.3), (-2.1, 0.4))]
    scenes = [
        presses.scene(SphereSdf(r), presses.poses(p), pad=pad) for r, p in zip((1.6, 2.0, 1.8), paths, strict=True)
    ]
    patterns, places = zip(*map(embedded, scenes), strict=True)
    assert len(set(patterns)) == 1
    assert len({len(each.cells) for each in places}) > 1


def test_a_contact_larger_than_all_patterns_has_none():
    scene = presses.scene(
        SphereSdf(2.0), presses.poses([(-20.0, 0, -0.4), (20.0, 0, -0.4)]), pad=presses.gel(60.0, 12.0)
    )
    assert Planned.of((0, scene)).pattern is None


def test_a_mesh_lies_in_larger_patterns_too():
    scene = scene_of(0, "draft")
    own, larger = mesh.of(scene), GridPattern((26, 30, 5))
    _, found = embedded(scene, larger)
    assert (found.points[found.nodes] == own.points).all()
    with pytest.raises(ValueError, match="too small"):
        embedded(scene, GridPattern((14, 14, 5)))


def test_patterns_are_shared_where_that_saves_time(monkeypatch):
    a, b, c, d = (GridPattern(cells) for cells in ((14, 18, 5), (18, 14, 5), (30, 30, 5), (14, 18, 7)))
    both = GridPattern((18, 18, 5))
    monkeypatch.setattr(grids, "REFERENCE_CELLS", 17_500)

    def shared(**scenes):
        return grids.merged({{"a": a, "b": b, "c": c, "d": d}[name]: count for name, count in scenes.items()})

    assert shared(a=99, b=99, c=9, d=1) == {a: both, b: both, c: c, d: d}  # other layers have other cells
    assert shared(a=1, b=1, c=3) == {a: c, b: c, c: c}  # two scenes are few
    assert shared(a=999, b=999) == {a: a, b: b}
    e = GridPattern((18, 18, 5))
    assert grids.merged({a: 1, b: 1, e: 999}) == {a: e, b: e, e: e}  # what holds both is there
    monkeypatch.setattr(grids, "REFERENCE_CELLS", 1)
    assert shared(a=1, b=1) == {a: a, b: b}


@pytest.mark.parametrize(("quartered", "groups"), [(0, 1), (12, 2), (99, 3)])
def test_every_free_node_is_eliminated_once_and_acts_on_later_ones(quartered, groups):
    pattern = GridPattern((18, 11, 3))
    tree = dissected(pattern, quartered=quartered, most_groups=groups)
    owns = np.concatenate([group.own[group.own >= 0] for group in tree.groups])
    assert sorted([*owns, *tree.patch]) == np.flatnonzero(pattern.free).tolist()
    for level in tree.levels:
        fronts = np.concatenate([group.fronts for group in level.groups])
        assert sorted(fronts) == list(range(len(fronts)))
        assert len(level.groups) <= groups
    for group in tree.groups:
        for own, bound in zip(group.own, group.bound, strict=True):
            own, bound = own[own >= 0], bound[bound >= 0]
            assert (np.diff(tree.rank[bound]) > 0).all()
            assert not own.size or tree.rank[bound].min() > tree.rank[own].max()


def test_two_batches_a_level_save_padding():
    pattern = GridPattern((18, 18, 5))
    one, two = (dissected(pattern, most_groups=most).groups for most in (1, 2))
    filled = [sum(_entries(*map(int, wide)) for group in groups
                  for wide in zip((group.own >= 0).sum(1), (group.bound >= 0).sum(1), strict=True))
              for groups in (one, two)]  # fmt: skip
    assert filled[0] == filled[1]
    assert sum(group.entries for group in two) < 0.8 * sum(group.entries for group in one)
