"""The checks of a load step of many scenes, its record, and what follows a failure."""

from functools import partial

import numpy as np
import torch
from torch import Tensor

from tacgen.geometry.pose import Pose
from tacgen.mechanics.admission import MAX_BARRIER_STIFFENINGS, MIN_FORCE_SCALE_RATIO, folds_on, rounded
from tacgen.mechanics.failures import Failure, NotConverged
from tacgen.mechanics.load_step import BARRIER_STIFFENING_FACTOR, MAX_DEPTH_INSIDE
from tacgen.mechanics.load_stepping import halved
from tacgen.mechanics.phases import Outcome
from tacgen.mechanics.state import History, State, joined
from tacgen.tensor_engine.batch import Batch
from tacgen.tensor_engine.contact import Contacts, Forces, slip
from tacgen.tensor_engine.contact_newton import at_nodes
from tacgen.tensor_engine.inversion import least_jacobian
from tacgen.tensor_engine.load_step import blocked

Array = np.ndarray


def admit(b: Batch, rows: list[int]) -> list[Outcome]:
    """Whether no point is inside the shrunk indenter and no cell is inverted, or barriers must be stiffer; whether
    forces balance. If so the load step is recorded."""
    t, outcomes, recorded = b.t, list[Outcome](), list[int]()
    figures = b.replays(("admit", b.hexes.laws.two_invariants), partial(_figures, b), rows)
    for k, (row, each) in enumerate(zip(rows, figures, strict=True)):
        course, (gap, J, off, unequal, deep, reach, through) = b.courses[row], each
        course.solves, course.steps = course.solves + 1, course.steps + course.newton_steps
        course.damped += course.newton_folding
        most = b.options.fold_max if course.newton_folding else b.options.residual_max
        touching, inverted = not gap > 0, not J > 0
        if (touching or inverted) and course.solves < MAX_BARRIER_STIFFENINGS:
            t.kappa[row] *= BARRIER_STIFFENING_FACTOR if touching else 1.0
            t.folds[row] *= BARRIER_STIFFENING_FACTOR if inverted else 1.0
            outcomes.append(Outcome.stiffer)
        elif off > most or unequal > most or touching:
            failed = {"residual": off, "balance": unequal, "least_gap": gap}
            course.failure = NotConverged(Failure.unbalanced, **failed)
            outcomes.append(Outcome.failure)
        elif J <= 0:
            course.failure = NotConverged(Failure.inverted, least_J=J)
            outcomes.append(Outcome.failure)
        elif through:
            course.failure = NotConverged(Failure.snaps if course.newton_folding else Failure.too_far)
            outcomes.append(Outcome.failure)
        elif deep > MAX_DEPTH_INSIDE * reach:
            edge = course.problem.edge
            course.failure = NotConverged(Failure.inside, width=2 * reach, depth=deep, edge=edge)
            outcomes.append(Outcome.failure)
        else:
            recorded.append(k)
            outcomes.append(Outcome.more if len(course.legs) > 1 else Outcome.ended)
    if recorded:
        _record(b, [rows[k] for k in recorded], [figures[k] for k in recorded])
    return outcomes


def _figures(b: Batch, s: Tensor) -> tuple[Tensor, None]:
    """Tells of each scene (s, 7): smallest gap, least J, residual and imbalance of the forces, depth inside the
    indenter, its reach, and whether a point has passed through it."""
    x, contact = b.t.x[s], b.face(s, b.t.offset[s])
    forces = contact.evaluate(x)
    least_J = least_jacobian(b.X[s], x, b.topology, b.exists[s])
    residual, balance = _imbalance(b, s, x, contact, forces)
    inside, through = _depth_inside(b, s, x, contact), blocked(b, s, x)
    columns = forces.gap.flatten(1).amin(1), least_J, residual, balance, inside, b.reach[s], through.to(x.dtype)
    return torch.stack(columns, 1), None


def _imbalance(b: Batch, s: Tensor, x: Tensor, contact: Contacts, forces: Forces) -> tuple[Tensor, Tensor]:
    """Residual at the free nodes and |indenter + base|, both (s,) over the contact force [-]."""
    inner = b.gradient(s, x)[1]
    outer = at_nodes(contact, -forces.force, x.shape[1])
    free = b.free[:, None]
    residual = torch.linalg.norm(((inner + outer) * free).flatten(1), dim=1)
    pushed, reaction = outer.sum(1), (inner * ~free).sum(1)
    force = torch.maximum(torch.linalg.norm(pushed, dim=1), b.t.h_least[s])
    return residual / force, torch.linalg.norm(pushed - reaction, dim=1) / force


def _depth_inside(b: Batch, s: Tensor, x: Tensor, contact: Contacts) -> Tensor:
    """Largest penetration (s,) of the gel into the shrunk indenter at the integration points [mm]; 0 without any."""
    at = (b.corners @ x[:, b.topology.conn]).flatten(1, 2)
    d = contact.shapes.values_at(contact.local(at)).view(len(s), -1, len(b.corners)) + contact.offset[:, None, None]
    return -torch.where(b.exists[s][..., None], d, 0.0).flatten(1).amin(1).clamp(max=0.0)


def _record(b: Batch, rows: list[int], figures: list[list[float]]) -> None:
    """The history that the next load step inherits, and the states at its end."""
    t, s = b.t, b.slots(rows)
    contact, eps = b.face(s, t.offset[s]), b.eps[s][:, None, None]
    forces = contact.evaluate(t.x[s])
    N = forces.N
    u = slip(forces.at, contact.anchor, forces.normal)
    length = torch.linalg.norm(u, dim=-1)
    pulled = forces.at - u * (eps / length.clamp(min=1e-300)).clamp(max=1.0)[..., None]
    moved = contact.local(torch.where((N > 0)[..., None], pulled, forces.at))
    anchor = torch.where((b.friction[s] > 0)[:, None, None, None], moved, t.h_anchor[s])
    least = eps + b.options.step_tol * b.dhat[s][:, None, None]
    sliding = (length > least) & (N > 0)
    friction = forces.force - N[..., None] * forces.normal
    flat = forces.normal.flatten(1, 2) @ contact.rotation
    x, normal = t.x[s], flat.view_as(forces.normal)
    t.put(
        s, h_error=x - t.first_order[s], h_motion=t.motion[s], h_x=x, h_offset=t.offset[s], h_N=N, h_anchor=anchor,
        h_gap=forces.gap, h_kappa=t.kappa[s], h_rotation=t.rotation[s], h_position=t.position[s],
        h_least=torch.maximum(t.h_least[s], MIN_FORCE_SCALE_RATIO * forces.total),
    )  # fmt: skip
    parts = (x, N, forces.normal, normal, friction, sliding, anchor, forces.gap, t.offset[s], t.kappa[s], t.h_least[s])
    parts = tuple(part.to("cpu", non_blocking=True) for part in parts)
    mean = torch.where(forces.total > 0, forces.mean_gap, t.offset[s]).tolist()  # waits for the copies too
    arrays = [part.numpy() for part in parts]
    for k, row in enumerate(rows):
        _recorded(b, row, [part[k] for part in arrays], mean[k], figures[k])


def _recorded(b: Batch, row: int, arrays: list[Array], mean: float, figures: list[float]) -> None:
    """The state of one scene, in its mesh's own numbers."""
    course = b.courses[row]
    place, before, problem = course.place, course.history, course.problem
    assert before is not None
    x, *on_face = arrays[0][place.nodes], *(part[place.facets] for part in arrays[1:8])
    N, world, normal, friction, sliding, anchor, gap = on_face
    offset, kappa, least_force = (float(part) for part in arrays[8:])
    leg, (least_gap, least_J, residual, balance, *_) = course.legs[0], figures
    after = History(
        Pose.of(leg.b), x, offset, N, normal, anchor, gap, kappa, least_force, None, {},
        folds_on(before, course.damped),
    )  # fmt: skip
    rubbed = problem.friction > 0
    state = State(
        course.index, leg.b, x, N, world, friction if rubbed else None, sliding if rubbed else None, course.steps, 1,
        offset, mean, least_gap, residual, balance, least_J, course.damped,
        rounded=rounded(problem, before, after), unique=not after.folded, after=after,
    )  # fmt: skip
    course.state = state if course.state is None else joined(course.state, state)
    course.history, course.legs = after, course.legs[1:]


def halve(b: Batch, rows: list[int]) -> list[Outcome]:
    """Failed load steps as two halves each, unless one has been halved as often as its failure allows."""
    outcomes = []
    for row in rows:
        course = b.courses[row]
        assert course.failure is not None
        halves = halved(course.legs[0], course.failure.failure, b.options) if course.may_halve else ()
        course.usable, course.legs = False, (*halves, *course.legs[1:])
        outcomes.append(Outcome.more if halves else Outcome.failure)
    return outcomes


def rest(b: Batch, row: int, history: History) -> None:
    """The row of a scene whose gel is untouched."""
    t, course, pose = b.t, b.courses[row], history.pose
    course.history, course.usable, course.left = history, False, False
    t.h_x[row], t.h_error[row], t.h_motion[row] = b.X[row], 0.0, 0.0
    t.h_offset[row], t.h_kappa[row], t.h_least[row] = history.offset, history.kappa, history.least_force
    faces = torch.as_tensor(course.place.facets, device=b.X.device)
    for rows, part in ((t.h_N, history.normal_force), (t.h_gap, history.gap), (t.h_anchor, history.anchor)):
        rows[row] = 0.0
        rows[row, faces] = torch.as_tensor(part, device=rows.device)
    for rows, part in ((t.h_rotation, pose.rotation), (t.h_position, pose.position)):
        rows[row] = torch.as_tensor(part.copy(), device=rows.device)
