"""The checks of a load step of many scenes, and its record; see Numerics."""

from dataclasses import replace
from functools import partial

import torch
from torch import Tensor

from tacgen.geometry.pose import Pose
from tacgen.mechanics.measures import MIN_FORCE_SCALE_RATIO, dragged, imbalance
from tacgen.mechanics.numerics import BARRIER_STIFFENING_FACTOR, Checked, Reached
from tacgen.mechanics.state import History
from tacgen.tensor_engine import timed
from tacgen.tensor_engine.batch import Batch
from tacgen.tensor_engine.contact import Contacts, Forces
from tacgen.tensor_engine.contact_newton import at_nodes
from tacgen.tensor_engine.inversion import least_jacobian
from tacgen.tensor_engine.load_step import blocked


def check(b: Batch, rows: list[int]) -> list[Checked]:
    """The figures of equilibria."""
    told = b.replays(("admit", b.hexes.two_invariants), partial(_figures, b), rows)
    return [Checked._make([*figures, bool(through)]) for *figures, through in told]


def stiffen(b: Batch, row: int, contact: bool, folding: bool) -> None:
    """Stiffer barriers of the contact or against inversion."""
    for stiffness, stiffer in ((b.t.kappa, contact), (b.t.folds, folding)):
        stiffness[row] *= BARRIER_STIFFENING_FACTOR if stiffer else 1.0


def _figures(b: Batch, s: Tensor) -> tuple[Tensor, None]:
    """Tells what Checked has (s, 6)."""
    x, contact = b.t.x[s], b.face(s, b.t.offset[s])
    forces = contact.evaluate(x)
    least_J = least_jacobian(b.X[s], x, b.topology, b.exists[s])
    residual, balance = _imbalance(b, s, x, contact, forces)
    inside, through = _depth_inside(b, s, x, contact), blocked(b, s, x)
    columns = forces.gap.flatten(1).amin(1), least_J, residual, balance, inside, through.to(x.dtype)
    return torch.stack(columns, 1), None


def _imbalance(b: Batch, s: Tensor, x: Tensor, contact: Contacts, forces: Forces) -> tuple[Tensor, Tensor]:
    """Residual at the free nodes and |indenter + base|, both (s,) over the contact force [-]."""
    inner = b.elastic(s, x)[1]
    outer = at_nodes(contact, -forces.force, x.shape[1])
    force = torch.maximum(torch.linalg.norm(outer.sum(1), dim=1), b.t.h_least[s])
    if (inertia := b.inertia(s)) is not None:
        outer = outer + inertia.gradient(x)
    return imbalance(inner, outer, ~b.free[None, :, None], force)


def _depth_inside(b: Batch, s: Tensor, x: Tensor, contact: Contacts) -> Tensor:
    """Largest penetration (s,) of the gel into the shrunk indenter at the integration points [mm]; 0 without any."""
    at = (b.corners @ x[:, b.topology.conn]).flatten(1, 2)
    d = contact.shapes.values_at(contact.local(at)).view(len(s), -1, len(b.corners)) + contact.offset[:, None, None]
    return -torch.where(b.exists[s][..., None], d, 0.0).flatten(1).amin(1).clamp(max=0.0)


def record(b: Batch, rows: list[int]) -> list[Reached]:
    """The history that the next load step inherits, in each scene's own numbers."""
    t, s = b.t, b.slots(rows)
    contact, eps = b.face(s, t.offset[s]), b.eps[s][:, None, None]
    forces = contact.evaluate(t.x[s])
    N = forces.N
    end = b.end(s)[:, None, None]
    pulled, sliding = dragged(contact.anchor, forces.at, forces.normal, N, eps, end)
    rubbed = (b.friction[s] > 0)[:, None, None, None]
    anchor = torch.where(rubbed, contact.local(pulled), t.h_anchor[s])
    friction = forces.force - N[..., None] * forces.normal
    flat = forces.normal.flatten(1, 2) @ contact.rotation
    x, normals = t.x[s], flat.view_as(forces.normal)
    timed.keep(b, rows, s)
    t.put(
        s, h_error=x - t.first_order[s], h_motion=t.motion[s], h_x=x, h_offset=t.offset[s], h_N=N, h_anchor=anchor,
        h_gap=forces.gap, h_kappa=t.kappa[s], h_rotation=t.rotation[s], h_position=t.position[s],
        h_least=torch.maximum(t.h_least[s], MIN_FORCE_SCALE_RATIO * forces.total),
    )  # fmt: skip
    mean = torch.where(forces.total > 0, forces.mean_gap, t.offset[s])
    numbers = torch.stack([t.offset[s], t.kappa[s], t.h_least[s], mean], 1)
    on_face = N, forces.normal, normals, friction, sliding, anchor, forces.gap
    sought = any(b.problem(row).differentiable for row in rows)
    predicted = (t.h_error[s], t.ahead[s], t.motion[s]) if sought else ()
    copies = [part.to("cpu", non_blocking=True) for part in (x, *on_face, *predicted)]
    told = numbers.tolist()  # waits for the copies too
    reached = []
    for k, row in enumerate(rows):
        place = b.scenes[row].place
        nodes, *points = (part[k].numpy() for part in copies)
        N, outward, normal, friction, sliding, anchor, gap = (part[place.facets] for part in points[: len(on_face)])
        (offset, kappa, least, mean_gap), pose = told[k], Pose.of(b.courses[row].legs[0].b)
        after = History(pose, nodes[place.nodes], offset, N, normal, anchor, gap, kappa, least)
        if sought and b.courses[row].predicted:
            error, ahead, motion = points[len(on_face) :]
            far = error[place.nodes], motion[place.facets]
            after = replace(after, predictor_error=far, predicted=ahead[place.nodes])
        reached.append(Reached(after, outward, friction, sliding, mean_gap))
    return reached


def forget(b: Batch, row: int) -> None:
    """The kept tangent no longer serves: a load step failed."""
    b.scenes[row].usable = False


def rest(b: Batch, row: int, history: History) -> None:
    """The row of a scene whose gel is untouched."""
    t, scene, pose = b.t, b.scenes[row], history.pose
    scene.usable, scene.left = False, False
    t.h_x[row], t.h_error[row], t.h_motion[row] = b.X[row], 0.0, 0.0
    t.h_offset[row], t.h_kappa[row], t.h_least[row] = history.offset, history.kappa, history.least_force
    faces = torch.as_tensor(scene.place.facets, device=b.X.device)
    for rows, part in ((t.h_N, history.normal_force), (t.h_gap, history.gap), (t.h_anchor, history.anchor)):
        rows[row] = 0.0
        rows[row, faces] = torch.as_tensor(part, device=rows.device)
    for rows, part in ((t.h_rotation, pose.rotation), (t.h_position, pose.position)):
        rows[row] = torch.as_tensor(part.copy(), device=rows.device)
