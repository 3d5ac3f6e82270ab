"""The method as a transition table: what a kernel may return in each phase of a solve, and which phase comes next.

Nothing is computed here. `solver.solve` calls the kernel of the present phase and looks up what follows; MECHANICS.md
prints the table. Where a cycle of phases closes, it passes one of COUNTED_PHASES, whose kernel ends it after a fixed
number of rounds: so every solve ends.
"""

from enum import StrEnum


class Phase(StrEnum):
    """The kernel that a frame in solution asks for next."""

    begin = "begin"  # the next load step of the frame: contact at its pose, nodes to condense to
    renew = "renew"  # factorise the tangent at the last equilibrium
    predict = "predict"  # move the gel with the indenter by that tangent
    start = "start"  # choose where Newton's method starts, and anchor new points
    step = "step"  # begin a step of the bulk: count it, decide whether the tangent is kept
    factor = "factor"  # assemble and factorise the tangent at the iterate
    load = "load"  # unbalanced forces, condensed to the contact
    contact = "contact"  # one Newton step of the contact on the Schur complement
    damp = "damp"  # no step lowers the energy: more damping, or a new tangent
    search = "search"  # line search along the step of all nodes
    measure = "measure"  # residual, and whether the tangent still contracts
    whole = "whole"  # where contact is not condensed: Newton's method on all unknowns, to its end
    admit = "admit"  # nothing penetrates, inverts or is out of balance
    halve = "halve"  # the load step failed: two halves
    done = "done"  # the frame is solved
    failed = "failed"  # it has no solution


class Outcome(StrEnum):
    """The answer of a kernel, on which the next phase depends."""

    ready = "ready"  # what it computes is there
    missing = "missing"  # there is no tangent that serves
    apart = "apart"  # nothing touches
    indefinite = "indefinite"  # the tangent has no Cholesky factor
    not_condensed = "not condensed"
    more = "more"  # the iteration goes on
    ended = "ended"  # it converged, or has had all its steps
    unstable = "unstable"  # no step of the contact lowers the energy
    higher = "higher"  # no part of the step of all nodes does
    stiffer = "stiffer"  # again from here, with a stiffer barrier
    failure = "failure"  # `Course.failure` says which


P = Phase
PHASE_TRANSITIONS: dict[Phase, dict[Outcome, Phase]] = {
    P.begin: {
        Outcome.ready: P.predict, Outcome.missing: P.renew, Outcome.apart: P.start, Outcome.not_condensed: P.start,
    },
    P.renew: {Outcome.ready: P.predict, Outcome.indefinite: P.start},
    P.predict: {Outcome.ready: P.start},
    P.start: {Outcome.ready: P.step, Outcome.not_condensed: P.whole, Outcome.failure: P.halve},
    P.step: {Outcome.ready: P.load, Outcome.missing: P.factor, Outcome.failure: P.halve},
    P.factor: {Outcome.ready: P.load, Outcome.indefinite: P.halve},
    P.load: {Outcome.ready: P.contact},
    P.contact: {Outcome.more: P.contact, Outcome.ended: P.search, Outcome.unstable: P.damp},
    P.search: {Outcome.ready: P.measure, Outcome.higher: P.damp},
    P.damp: {Outcome.ready: P.contact, Outcome.missing: P.step, Outcome.failure: P.halve},
    P.measure: {Outcome.more: P.step, Outcome.ended: P.admit, Outcome.failure: P.halve},
    P.whole: {Outcome.ended: P.admit, Outcome.failure: P.halve},
    P.admit: {Outcome.more: P.begin, Outcome.ended: P.done, Outcome.stiffer: P.start, Outcome.failure: P.halve},
    P.halve: {Outcome.more: P.begin, Outcome.failure: P.failed},
}  # fmt: skip
FINAL_PHASES = frozenset({P.done, P.failed})
COUNTED_PHASES = {  # phases whose kernel bounds how often it is passed, and by what
    P.step: "SolverOptions.max_newton and max_effort",
    P.contact: "SolverOptions.max_contact",
    P.damp: "MAX_DAMPING",
    P.admit: "MAX_BARRIER_STIFFENINGS, and the load steps that are left",
    P.halve: "SolverOptions.halvings and fold_halvings, MAX_TUNNELLING_HALVINGS",
}


def table() -> str:
    """TRANSITIONS for MECHANICS.md: a row for each phase, with what may come next."""
    rows = ["| phase | what its kernel finds, and the phase that follows |", "|---|---|"]
    for phase, row in PHASE_TRANSITIONS.items():
        then = "; ".join(f"{outcome} -> **{after}**" for outcome, after in row.items())
        rows.append(f"| {phase}{' *' if phase in COUNTED_PHASES else ''} | {then} |")
    return "\n".join(rows)
