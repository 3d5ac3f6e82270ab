"""How the wrench of a rigid indenter on the gel changes with its pose: the implicit function theorem at an equilibrium.

With r(x, q) = 0 at the equilibrium, dx/dq = -(dr/dx)^-1 dr/dq. A rigid motion of the indenter moves the contact points
by `motion`, so that dr/dq is the contact's tangent D times it; dr/dx is the Schur complement S of the bulk plus D: one
dense solve for all six motions.
"""

from dataclasses import replace

import numpy as np

from tacgen.mechanics.coupled import ContactForces, CoupledContact
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.state import History

Array = np.ndarray


def _forces(problem: Problem, before: History, at: History, substeps: int) -> ContactForces:
    """Contact forces with the anchors set back by the drag of one load step, so that sliding points keep sliding."""
    contact = replace(problem.contact.moved(at.pose, at.offset), kappa=at.kappa)
    dragged = np.where(before.normal_force[..., None] > 0, at.anchor - before.anchor, 0.0)
    anchor, slip = at.pose.world(at.anchor - dragged / substeps), problem.options.slip * contact.dhat
    return CoupledContact(contact, problem.friction, anchor, slip).evaluate(at.x)


def stiffness(problem: Problem, before: History, at: History, substeps: int, centre: Array) -> Array:
    """d(force, torque about `centre`)/d(shift, turn about it) of the wrench on the gel (6, 6), in the sensor frame, at
    an equilibrium that `substeps` load steps led to from `before`.

    `centre` (3,) [mm] moves with the indenter. The bulk's tangent is the kept one, which may be a few steps old. Zero
    where nothing touches, or no tangent is at hand.
    """
    forces, condensed = _forces(problem, before, at, substeps), problem.tangent.condensation
    which = np.flatnonzero((forces.N > 0).any(1))
    if not (which.size and condensed.usable and condensed.covers(problem.contact.faces.conn[which])):
        return np.zeros((6, 6))
    faces = problem.contact.faces.only(which)
    faces = replace(faces, conn=condensed.local[faces.conn])
    D, f, arm = forces.tangent[which], forces.force[which], forces.at[which] - centre
    K = condensed.schur.stiffness(D, faces.N, condensed.dofs[faces.conn])
    solve = condensed.schur.solver(K)
    out = np.zeros((6, 6))
    for k in range(6):
        turn = np.eye(6)[k, 3:]
        motion = np.cross(turn, arm) if k >= 3 else np.broadcast_to(np.eye(3)[k], arm.shape)
        turned = np.cross(turn, f)
        pull = np.einsum("fqij,fqj->fqi", D, motion) + turned
        load = faces.scatter(pull, len(condensed.nodes))[condensed.dofs >= 0]
        moved = np.zeros(condensed.dofs.shape)
        moved[condensed.dofs >= 0] = solve(load)
        went = faces.at(moved)
        df = np.einsum("fqij,fqj->fqi", D, motion - went) + turned
        shift = np.eye(6)[k, :3]
        torque = np.cross(arm, df) + np.cross(went - shift, f)
        out[:, k] = np.concatenate([df.sum((0, 1)), torque.sum((0, 1))])
    return out
