"""A load step of many scenes: contact at its pose, the prediction, and where Newton's method begins; see Numerics."""

from dataclasses import replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from tacgen.fem.projection import Projection
from tacgen.mechanics.measures import ahead, onset
from tacgen.mechanics.phases import Outcome
from tacgen.mechanics.predictor import STICKING_SPRING_STIFFNESS
from tacgen.tensor_engine import timed
from tacgen.tensor_engine.batch import Batch, Sizes
from tacgen.tensor_engine.contact_newton import at_nodes
from tacgen.tensor_engine.indices import gathered
from tacgen.tensor_engine.reduction import numbered, solved, with_points
from tacgen.tensor_engine.replay import recording


def place(b: Batch, rows: list[int]) -> list[Outcome]:
    """Contact and bulk at the pose of the next load step, and whether the kept tangents serve its prediction."""
    t, s = b.t, b.slots(rows)
    poses = torch.as_tensor(np.array([b.courses[row].legs[0].b for row in rows]), device=s.device)
    t.put(
        s, rotation=poses[:, :3, :3], position=poses[:, :3, 3], offset=t.h_offset[s], kappa=t.h_kappa[s],
        folds=torch.ones_like(t.folds[s]), motion=torch.zeros_like(t.motion[s]),
    )  # fmt: skip
    timed.prepare(b, rows, s)
    contact = b.face(s, t.offset[s])
    gap = contact.gap(t.h_x[s])
    touching = ((gap < contact.dhat[:, None, None]) | (t.h_N[s] > 0)).any(-1)
    apart = ~touching.any(-1)
    usable = torch.tensor([b.scenes[row].usable for row in rows], device=s.device)
    covered = usable & covers(b, s, touching)
    cover(b, s, touching, ~apart & ~covered)
    names = {0: Outcome.missing, 1: Outcome.ready, 2: Outcome.apart}
    outcomes = [names[k] for k in torch.where(apart, 2, covered.long()).tolist()]
    for k, row in enumerate(rows):
        if b.problem(row).differentiable and outcomes[k] is Outcome.ready:
            outcomes[k] = Outcome.missing
    return outcomes


def covers(b: Batch, s: Tensor, facets: Tensor) -> Tensor:
    """Whether scenes s are condensed to all nodes of marked facets (s, f)."""
    inside = (b.t.local[s][:, b.topology.facets] >= 0).all(-1)
    return (inside | ~facets).all(-1)


def cover(b: Batch, s: Tensor, facets: Tensor, which: Tensor) -> None:
    """Condense the scenes marked in `which` (s,) to the nodes of marked facets (s, f) and of their neighbours; those
    whose contact is not on nodes to which can be condensed have left the batch."""
    if not bool(which.any()):
        return
    s, facets, table = s[which], facets[which], b.topology.facets
    own = _nodes_of(b, facets)
    real = b.areas[s].sum(-1) > 0
    marked = _nodes_of(b, own[:, table].any(-1) & real) & b.patch
    local = torch.where(marked, marked.long().cumsum(1) - 1, -1)
    faces = (local[:, table] >= 0).all(-1) & real
    t = b.t
    t.put(
        s,
        own=3 * marked.sum(1),
        local=local,
        nodes=numbered(marked, t.nodes.shape[1]),
        faces=numbered(faces, t.faces.shape[1]),
    )
    counts = torch.stack([marked.sum(1), (own & ~b.patch).sum(1)], 1).tolist()
    for row, (nodes, outside) in zip(s.tolist(), counts, strict=True):
        scene = b.scenes[row]
        scene.usable, scene.rested, scene.left, scene.nodes = False, False, outside > 0, nodes


def _nodes_of(b: Batch, facets: Tensor) -> Tensor:
    """Nodes (s, n) bool of marked facets (s, f)."""
    out = torch.zeros(len(facets), b.topology.nodes, dtype=torch.bool, device=facets.device)
    row, facet = torch.nonzero(facets, as_tuple=True)
    out[row[:, None], b.topology.facets[facet]] = True
    return out


def take(b: Batch, rows: list[int], at: str, mixed: bool, projection: Projection = Projection.NONE) -> list[bool]:
    """Factorise the tangents at the positions of this name, with pressures at the predicted J if `mixed`; where one is
    not positive definite, with projected tangents of the cells. Which have a factor."""
    sizes = b.sizes(rows)
    work = partial(_taken, b, sizes, at, mixed, projection)
    if projection is Projection.NONE:
        out = b.replays(("factor", sizes.nodes, sizes.fewest, at, mixed, b.hexes.two_invariants), work, rows)
    else:
        out = work(b.slots(rows))[0].tolist()
    for row, fine in zip(rows, out, strict=True):
        b.scenes[row].usable, b.scenes[row].reduced = bool(fine), -1.0
    if projection is not Projection.FULL and not all(out):
        bad = [k for k, fine in enumerate(out) if not fine]
        again = take(b, [rows[k] for k in bad], at, mixed, Projection(projection + 1))
        for k, fine in zip(bad, again, strict=True):
            out[k] = fine
    return out


def _taken(b: Batch, sizes: Sizes, at: str, mixed: bool, projection: Projection, s: Tensor) -> tuple[Tensor, None]:
    """Keeps the factors of tangents. Tells which there are (s,)."""
    x = getattr(b.t, at)[s]
    F, K = b.hexes.rows(s).tangents(x, b.t.J if mixed else None, projection, b.factors.dtype)
    b.barriers(s).evaluate(x).add_tangents(K, projection)
    timed.add_tangents(b, s, K)
    good, S = b.factors.factor(s, K, b.t.nodes[s, : sizes.nodes], sizes.fewest)
    b.keep(s, S=S)
    b.t.put(s, taken=F)
    return good, None


def renew(b: Batch, rows: list[int]) -> list[bool]:
    """Factorise the tangents at the last equilibria; which are positive definite."""
    return take(b, rows, "h_x", False)


def predict(b: Batch, rows: list[int]) -> list[bool]:
    """The prediction: points that touch move with the indenter, the rest of the gel by the tangent; see
    mechanics.predictor."""
    sizes = b.sizes(rows)
    return [bool(good) for good in b.replays(("predict", sizes.nodes), partial(_predict, b, sizes), rows)]


def _predict(b: Batch, sizes: Sizes, s: Tensor) -> tuple[Tensor, None]:
    """Predicts. Tells which are predicted (s,)."""
    t, x, k = b.t, b.t.h_x[s], sizes.unknowns
    contact, face = b.near(s, t.offset[s], sizes.nodes), b.face(s, t.offset[s])
    touching = t.h_N[s] > 0
    at = face.points(x)
    last = replace(face, rotation=t.h_rotation[s], position=t.h_position[s])
    motion = torch.where(touching[..., None], face.world(last.local(at)) - at, 0.0)
    count = contact.conn.shape[1]
    row, faces = torch.arange(len(s), device=s.device)[:, None], t.faces[s, :count].clamp(min=0)
    ties = torch.where(
        contact.areas > 0, STICKING_SPRING_STIFFNESS * t.h_N[s][row, faces] / contact.dhat[:, None, None], 0.0
    )[..., None]
    eye = torch.eye(3, dtype=x.dtype, device=x.device)
    place = torch.arange(k, device=s.device).expand(len(s), -1)
    S, facets = b.wide("S", k, k), (contact.conn, contact.ends, contact.N)
    K = with_points(S, s, place, place, *facets, ties[..., None] * eye)
    pull = at_nodes(contact, ties * motion[row, faces], k // 3).flatten(1)
    u, good = solved(K, pull[..., None].to(S.dtype), symmetric=True)
    good = good & (ties > 0).flatten(1).any(1)
    u = torch.where(good[:, None], u.squeeze(-1).to(x.dtype), 0.0)
    first = x + b.factors.expand(s, u, torch.zeros_like(x)).to(x.dtype)
    second = first + ahead(motion, t.h_motion[s], touching)[:, None, None] * t.h_error[s]
    t.put(s, first_order=first, ahead=second, motion=torch.where(good[:, None, None, None], motion, 0.0))
    return good, None


def choose(b: Batch, rows: list[int]) -> list[bool]:
    """The first of a solution nearby, the prediction and the last positions in which nothing tunnels and no cell is
    inverted, and anchors of new points where they first touch; which scenes have such a place."""
    predicted = [float(b.courses[row].predicted) for row in rows]
    near = [float(b.courses[row].near is not None) for row in rows]
    flags = (predicted, near) if any(near) else (predicted,)
    good = b.replays(("begin", b.hexes.two_invariants, len(flags)), partial(_begin, b), rows, *flags)
    return [bool(fine) for fine in good]


def start(b: Batch, rows: list[int]) -> None:
    """Newton's method at that place, or where the solve with softer barriers ended."""
    b.replays(("start", b.hexes.two_invariants), partial(_start, b), rows)


def _begin(b: Batch, s: Tensor, predicted: Tensor, *near: Tensor) -> tuple[Tensor, None]:
    """Where Newton's method begins. Tells which scenes (s,) have such a place; near: which have a solution nearby, if
    one has."""
    t, guessed = b.t, predicted > 0
    last, ahead = t.h_x[s], t.ahead[s]
    use = guessed & _clear(b, s, ahead)
    good, x = use, torch.where(use[:, None, None], ahead, last)
    if recording() or not bool(use.all()):
        good = use | _clear(b, s, last)
        if b.inert:
            coasting = ~use & _clear(b, s, t.coasting[s])
            good, x = good | coasting, torch.where(coasting[:, None, None], t.coasting[s], x)
    for known in near:
        close = (known > 0) & _clear(b, s, t.begins[s])
        good, x = good | close, torch.where(close[:, None, None], t.begins[s], x)
    t.put(s, x=x)
    _anchor(b, s, torch.where(guessed[:, None, None], ahead, last))
    return good, None


def _start(b: Batch, s: Tensor) -> tuple[None, None]:
    t, x = b.t, b.t.x[s]
    t.put(s, begins=x, energy=b.energy(s, x), J=b.hexes.rows(s).gradient(t.h_x[s])[0])
    return None, None


def _anchor(b: Batch, s: Tensor, x: Tensor) -> None:
    """Anchors in the sensor's frame at the start of a load step predicted to end at x."""
    t, contact = b.t, b.face(s, b.t.offset[s])
    before, offset = t.h_anchor[s], contact.offset[:, None, None]
    touch = onset(before, contact.local(contact.points(x)), t.h_gap[s] - offset, contact.gap(x) - offset)
    t.put(s, anchor=contact.world(torch.where((t.h_N[s] > 0)[..., None], before, touch)))


def _clear(b: Batch, s: Tensor, x: Tensor) -> Tensor:
    """Whether a straight step to x (s, n, 3) tunnels nowhere and inverts no cell."""
    return torch.isfinite(b.energy(s, x)) & ~blocked(b, s, x)


def blocked(b: Batch, s: Tensor, x: Tensor) -> Tensor:
    """Whether a straight step from the last positions to x (s, n, 3) carries a point of the face through the indenter;
    see mechanics.tunnelling.blocked."""
    t, contact = b.t, b.face(s, b.t.offset[s])
    before, turned, position, gap, reach = gathered(s, t.h_x, t.h_rotation, t.h_position, t.h_gap, b.reach)
    return contact.blocked(before, x, turned, position, gap, reach)
