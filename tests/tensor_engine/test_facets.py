"""Rows of scenes in slots, their condensed facets, and sums over the facets of a node; on a GPU where there is one."""

import numpy as np
import pytest
from helpers.needs import needs

torch = needs("torch")

from tacgen.geometry.analytic_sdf import SphereSdf
from tacgen.tensor_engine import condensation, contact_newton, load_step
from tacgen.tensor_engine.batch import Batch
from tacgen.tensor_engine.indices import gathered, put
from tacgen.tensor_engine.reduction import with_points
from tacgen.tensor_engine.replay import Replays
from tensor_engine.batches import batch, path, small

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
R = np.random.default_rng


@pytest.mark.parametrize("which", [None, [True, False, True], [False] * 3])
def test_rows_are_written_where_they_are_marked_and_read_again(which: list[bool] | None) -> None:
    """The first of each row's numbers, of several types, and of more arrays than one launch has."""
    r, slots = R(2), torch.tensor([4, 1, 3], device=DEVICE)
    shapes = [(50, 3), (), (2,)] * 4
    kept = [torch.tensor(r.normal(size=(6, *shape)), device=DEVICE) for shape in shapes]
    kept += [torch.tensor(r.integers(0, 9, size=6), device=DEVICE), torch.zeros(6, 5, device=DEVICE) > 0]
    values = [torch.tensor(r.normal(size=(3, *shape)), device=DEVICE)[:, :44] for shape in shapes[:1]]
    values += [torch.tensor(r.normal(size=(3, *shape)), device=DEVICE) for shape in shapes[1:]]
    values += [torch.tensor([11, 12, 13], device=DEVICE), torch.tensor(r.uniform(size=(3, 5)) > 0.5, device=DEVICE)]
    wanted = [each.clone() for each in kept]
    for row, slot in enumerate(slots.tolist()):
        for rows, value in zip(wanted, values, strict=True):
            if (which is None or which[row]) and value.dim() > 1:
                rows[slot, : value.shape[1]] = value[row]
            elif which is None or which[row]:
                rows[slot] = value[row]
    put(slots, tuple(kept), tuple(values), None if which is None else torch.tensor(which, device=DEVICE))
    assert all(map(torch.equal, kept, wanted))
    assert all(map(torch.equal, gathered(slots, *kept), [rows[slots] for rows in wanted]))


def covered(cells: dict[int, slice]) -> Batch:
    """Scenes that are condensed to the nodes of some facets of the face."""
    b = batch([small(SphereSdf(1.5), path((0, 0, -0.3)))] * len(cells))
    marked = torch.zeros(len(cells), len(b.topology.facets), dtype=torch.bool)
    for row, facets in cells.items():
        marked[row, facets] = True
    load_step.cover(b, b.slots(range(len(cells))), marked, torch.ones(len(cells), dtype=torch.bool))
    return b


def test_facets_in_numbers_of_their_own_and_sums_at_their_nodes() -> None:
    """Of scenes in other slots than their own, condensed to unlike parts of the face."""
    b = covered({0: slice(7, 8), 1: slice(6, 8), 2: slice(12, 13)})
    b.t.anchor[:], b.dhat[:] = torch.tensor(R(1).normal(size=b.t.anchor.shape)), torch.arange(3) + 1.0
    s, nodes = b.slots([2, 0]), max(scene.nodes for scene in b.scenes) + 3
    one = b.near(s, b.t.offset[s], nodes)
    real = one.areas > 0
    assert real.any(2).sum(1).tolist() == [9, 9]
    assert one.dhat.tolist() == [3.0, 1.0]
    force = torch.tensor(R(2).normal(size=one.anchor.shape)) * real[..., None]
    everywhere = torch.tensor(R(5).normal(size=b.X.shape))
    x, sums = b.at_condensed(s, everywhere, nodes), contact_newton.at_nodes(one, force, nodes)
    for row, slot in enumerate(s.tolist()):
        count = int((b.t.nodes[slot] >= 0).sum())
        assert torch.equal(x[row, :count], everywhere[slot, b.t.nodes[slot, :count]])
        assert (x[row, count:] == 0).all()
        wanted = torch.zeros(len(everywhere[0]), 3, dtype=force.dtype)
        for f, facet in enumerate(b.t.faces[slot, : real.shape[1]].tolist()):
            if facet >= 0:
                assert torch.equal(b.t.nodes[slot, one.conn[row, f].long()], b.topology.facets[facet])
                assert torch.equal(one.areas[row, f], b.areas[slot, facet])
                assert torch.equal(one.anchor[row, f], b.t.anchor[slot, facet])
                wanted.index_add_(0, b.topology.facets[facet], b.N.T @ force[row, f])
        assert sums[row, :count].numpy() == pytest.approx(wanted[b.t.nodes[slot, :count]].numpy(), abs=1e-12)
        assert (sums[row, count:] == 0).all()
    face = b.face(s, b.t.offset[s])
    pushed = contact_newton.at_nodes(face, torch.ones_like(face.anchor), b.X.shape[1])
    assert pushed.sum(1).numpy() == pytest.approx(float(face.areas[0].numel()))


@pytest.mark.parametrize(("dtype", "tol"), [(torch.float32, 1e-6), (torch.float64, 1e-13)])
def test_stiffnesses_of_points_are_added_to_the_rows_of_their_unknowns(dtype: torch.dtype, tol: float) -> None:
    b = covered({0: slice(7, 8), 1: slice(6, 8), 2: slice(12, 13)})
    s, nodes = b.slots([2, 0]), max(scene.nodes for scene in b.scenes)
    c = b.near(s, b.t.offset[s], nodes)
    D = torch.tensor(R(3).normal(size=(*c.areas.shape, 3, 3))) * (c.areas > 0)[..., None, None]
    K = torch.tensor(R(4).normal(size=(3, 60, 60)), dtype=dtype)[:, :40, :40]
    place, kept = torch.full((2, 3 * nodes), -1), torch.full((2, 40), -1)
    place[0, 5:42], place[1, 3:43] = torch.arange(37), torch.arange(40).flip(0)
    for row, each in enumerate(place):
        acts = torch.nonzero(each >= 0).squeeze(1)
        kept[row, each[acts]] = acts
    wanted = K[s].double()
    for row in range(2):
        whole = torch.zeros(3 * nodes, 3 * nodes, dtype=D.dtype)
        for conn, at in zip(c.conn[row].long(), D[row], strict=True):
            for N, one in zip(c.N, at, strict=True):
                unknowns = (3 * conn[:, None] + torch.arange(3)).flatten()
                whole[unknowns[:, None], unknowns] += torch.kron(torch.outer(N, N), one)
        own = kept[row] >= 0
        at = kept[row][own]
        wanted[row, own.nonzero(), own.nonzero().T] += whole[at[:, None], at]
    found = with_points(K, s, kept, place, c.conn, c.ends, c.N, D)
    assert found.dtype == dtype
    assert found.double().numpy() == pytest.approx(wanted.numpy(), abs=tol * float(wanted.abs().max()))
    assert (wanted - K[s]).abs().amax((1, 2)).min() > 0.5


def test_what_contact_acts_on() -> None:
    """With a reduction to other unknowns, to these and others, and without one."""
    b = covered({row: slice(6, 8) for row in range(4)})
    b.replays = Replays(torch.device("cpu"), on=True)
    s = b.slots([3, 1, 0])
    sizes = b.sizes(s)._replace(nodes=20)  # room is wider
    assert {scene.nodes for scene in b.scenes} == {20}
    b.t.active[3, 50:54], b.t.active[1], b.t.active[0, :9] = True, True, True
    contact = b.near(s, b.t.offset[s], sizes.nodes)
    N = torch.zeros_like(contact.areas)
    N[:, 1, 2], N[:, 2, 0] = 0.1, 0.2
    b.t.wanted[:] = True
    stale, count = condensation.acted(b, sizes, s, contact, N, torch.tensor([1.0, 1.0, 0.0]).double())
    assert stale.tolist() == [True, False, True]
    assert count.tolist() == b.t.wanted[s].sum(1).tolist() == [22, 60, 18]
    near = contact.conn[0, 1:3].unique().long()
    assert b.t.wanted[0, (3 * near[:, None] + torch.arange(3)).flatten()].all()
