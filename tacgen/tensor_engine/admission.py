"""The checks of a load step of many scenes, its record, and what follows a failure."""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from tacgen.fem.elements import eighths
from tacgen.geometry.pose import Pose, between
from tacgen.mechanics.admission import NEGLIGIBLE, STIFFENINGS, rounded
from tacgen.mechanics.failures import Failure, NotConverged
from tacgen.mechanics.load_step import INSIDE, STIFFER
from tacgen.mechanics.load_stepping import FOLD_HALVINGS, TOO_FAR
from tacgen.mechanics.phases import Outcome
from tacgen.mechanics.state import History, State, joined
from tacgen.mechanics.tunnelling import FINEST
from tacgen.tensor_engine.batch import Batch
from tacgen.tensor_engine.contact import Contacts, Forces, slip
from tacgen.tensor_engine.contact_newton import at_nodes
from tacgen.tensor_engine.indices import constant, listed
from tacgen.tensor_engine.inversion import least_jacobian

Array = np.ndarray


def admit(b: Batch, s: Tensor) -> list[Outcome]:
    """Whether no point is inside the shrunk indenter and no cell is inverted, or barriers must be stiffer; whether
    forces balance. If so the load step is recorded."""
    t, most = b.t, b.options.residual_max
    x, contact = t.x[s], b.face(s, t.offset[s])
    forces = contact.evaluate(x)
    least_gap = forces.gap.flatten(1).amin(1)
    least_J = least_jacobian(b.X[s], x, b.topology, b.exists[s])
    residual, balance = _imbalance(b, s, x, contact, forces)
    most_inside = INSIDE * (b.half_wall[s] - contact.offset)
    inside = _depth_inside(b, s, x, contact, most_inside)
    figures = torch.stack([least_gap, least_J, residual, balance, inside, most_inside], 1)
    outcomes, recorded = [], []
    for k, (row, each) in enumerate(zip(listed(s), figures.tolist(), strict=True)):
        course, (gap, J, off, unequal, deep, most_deep) = b.courses[row], each
        course.solves, course.steps = course.solves + 1, course.steps + course.newton_steps
        course.damped += course.newton_damped
        touching, inverted = not gap > 0, not J > 0
        if (touching or inverted) and course.solves < STIFFENINGS:
            t.kappa[row] *= STIFFER if touching else 1.0
            t.folds[row] *= STIFFER if inverted else 1.0
            outcomes.append(Outcome.stiffer)
        elif off > most or unequal > most or touching:
            failed = {"residual": off, "balance": unequal, "least_gap": gap}
            course.failure = NotConverged(Failure.unbalanced, **failed)
            outcomes.append(Outcome.failure)
        elif J <= 0:
            course.failure = NotConverged(Failure.inverted, least_J=J)
            outcomes.append(Outcome.failure)
        elif deep > most_deep:
            problem = course.problem
            width = 2 * problem.contact.shape.reach
            course.failure = NotConverged(Failure.inside, width=width, depth=deep, edge=problem.edge)
            outcomes.append(Outcome.failure)
        else:
            recorded.append(k)
            outcomes.append(Outcome.more if len(course.legs) > 1 else Outcome.ended)
    if recorded:
        which = b.slots(recorded)
        _record(b, s[which], contact.rows(which), forces.rows(which), figures[which].tolist())
    return outcomes


def _imbalance(b: Batch, s: Tensor, x: Tensor, contact: Contacts, forces: Forces) -> tuple[Tensor, Tensor]:
    """Residual at the free nodes and |indenter + base|, both (s,) over the contact force [-]."""
    inner = b.gradient(s, x)
    outer = at_nodes(contact, -forces.force, x.shape[1])
    free = b.free[:, None]
    residual = torch.linalg.norm(((inner + outer) * free).flatten(1), dim=1)
    pushed, reaction = outer.sum(1), (inner * ~free).sum(1)
    force = torch.maximum(torch.linalg.norm(pushed, dim=1), b.t.h_least[s])
    return residual / force, torch.linalg.norm(pushed - reaction, dim=1) / force


def _depth_inside(b: Batch, s: Tensor, x: Tensor, contact: Contacts, most: Tensor) -> Tensor:
    """Depth (s,) of a point of each gel's body inside the shrunk indenter [mm], for `most` (s,); see
    mechanics.tunnelling.depth_inside."""
    cells, there, deepest = x[:, b.topology.conn], b.exists[s], torch.zeros_like(most)
    split, offset = constant(eighths(8), x), contact.offset[:, None]
    while cells.shape[1]:
        middle = cells.mean(2)
        r = torch.linalg.norm(cells - middle[:, :, None], dim=-1).amax(-1)
        depth = torch.where(there, -offset - contact.shapes.values_at(contact.local(middle)), -torch.inf)
        deepest = torch.maximum(deepest, depth.amax(1))
        finer = (depth + r > most[:, None]) & (r > FINEST * most[:, None]) & (deepest <= most)[:, None]
        there, which = finer.to(torch.uint8).topk(int(finer.sum(1).max()), dim=1)
        kept = cells.gather(1, which[..., None, None].expand(-1, -1, 8, 3))
        cells, there = (split @ kept[:, :, None]).flatten(1, 2), there.bool().repeat_interleave(8, 1)
    return deepest


def _record(b: Batch, s: Tensor, contact: Contacts, forces: Forces, figures: list[list[float]]) -> None:
    """The history that the next load step inherits, and the states at its end."""
    t, eps, N = b.t, b.eps[s][:, None, None], forces.N
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
        s, h_error=x - t.first_order[s], h_motion=t.motion[s], h_x=x, h_offset=t.offset[s], h_N=N, h_normal=normal,
        h_anchor=anchor, h_gap=forces.gap, h_kappa=t.kappa[s], h_rotation=t.rotation[s], h_position=t.position[s],
        h_least=torch.maximum(t.h_least[s], NEGLIGIBLE * forces.total),
    )  # fmt: skip
    parts = (x, N, forces.normal, normal, friction, sliding, anchor, forces.gap, t.offset[s], t.kappa[s], t.h_least[s])
    parts = tuple(part.to("cpu", non_blocking=True) for part in parts)
    mean = torch.where(forces.total > 0, forces.mean_gap, t.offset[s]).tolist()  # waits for the copies too
    arrays = [part.numpy() for part in parts]
    for k, row in enumerate(listed(s)):
        _recorded(b, row, [part[k] for part in arrays], mean[k], figures[k])


def _recorded(b: Batch, row: int, arrays: list[Array], mean: float, figures: list[float]) -> None:
    """The state of one scene, in its mesh's own numbers."""
    course = b.courses[row]
    place, before, problem = course.place, course.history, course.problem
    assert before is not None
    x, *on_face = arrays[0][place.nodes], *(part[place.facets] for part in arrays[1:8])
    N, world, normal, friction, sliding, anchor, gap = on_face
    offset, kappa, least_force = (float(part) for part in arrays[8:])
    leg, (least_gap, least_J, residual, balance, _, _) = course.legs[0], figures
    after = History(
        Pose.of(leg.b), x, offset, N, normal, anchor, gap, kappa, least_force, None, before.x, {}, None, None
    )
    rubbed = problem.friction > 0
    state = State(
        course.index, leg.b, x, N, world, friction if rubbed else None, sliding if rubbed else None, course.steps, 1,
        offset, mean, least_gap, residual, balance, least_J, course.damped,
        rounded=rounded(problem, before, after), after=after,
    )  # fmt: skip
    course.error = course.predicted
    course.state = state if course.state is None else joined(course.state, state)
    course.history, course.legs = after, course.legs[1:]


def halve(b: Batch, s: Tensor) -> list[Outcome]:
    """Failed load steps as two halves each, unless one has been halved as often as its failure allows."""
    outcomes = []
    for row in listed(s):
        course = b.courses[row]
        assert course.failure is not None
        course.usable, failure, leg = False, course.failure.failure, course.legs[0]
        farther = failure == Failure.too_far
        most = FOLD_HALVINGS if failure == Failure.folds else b.options.halvings
        if (leg.far == TOO_FAR if farther else leg.halved >= most) or failure == Failure.effort:
            outcomes.append(Outcome.failure)
            continue
        middle, halved, far = between(leg.a, leg.b, leg.turn, 0.5), leg.halved + (not farther), leg.far + farther
        half = leg._replace(turn=leg.turn / 2, duration=leg.duration / 2, halved=halved, far=far, budget=False)
        course.legs = (half._replace(b=middle), half._replace(a=middle), *course.legs[1:])
        outcomes.append(Outcome.more)
    return outcomes


def rest(b: Batch, s: Tensor, poses: Array) -> None:
    """The untouched gels below indenters at poses (s, 4, 4)."""
    t = b.t
    for row, pose in zip(listed(s), poses, strict=True):
        course = b.courses[row]
        history = course.problem.rest(Pose.of(pose))
        course.history = replace(history, internal={})
        course.usable = course.error = course.left = False
        place = course.place
        single = {"h_offset": history.offset, "h_kappa": history.kappa, "h_least": history.least_force}
        for name, value in single.items():
            getattr(t, name)[row] = value
        face = {"h_N": history.normal_force, "h_gap": history.gap, "h_normal": history.normal}
        for name, part in {**face, "h_anchor": history.anchor}.items():
            getattr(t, name)[row] = 0.0
            getattr(t, name)[row, b.slots(place.facets.tolist())] = torch.as_tensor(part, device=s.device)
        t.h_x[row] = b.X[row]
        t.h_rotation[row] = torch.as_tensor(history.pose.rotation.copy(), device=s.device)
        t.h_position[row] = torch.as_tensor(history.pose.position.copy(), device=s.device)
        t.h_error[row], t.h_motion[row] = 0.0, 0.0
