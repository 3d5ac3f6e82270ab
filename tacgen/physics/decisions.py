"""Decisions of a step of the contact: Python on a core, for one scene, and compiled in the kernels of batches (steps).

Functions of numbers by operators and `abs` alone, which both understand, so that limits are arguments.
"""

from enum import IntEnum

from tacgen.physics.types import real

MERIT_ROUNDING = 1e-12  # relative increase of the merit function that is attributed to rounding [-]
ARMIJO_DECREASE = 1e-4  # smallest decrease over that predicted by the slope [-]
MAX_FULL_STEP_RESIDUAL_RATIO = 0.5  # residual over the one before, up to which a coupled step is taken in full [-]
MIN_LINE_SEARCH_FRACTION = 1e-8  # fraction of a step at which a line search has stalled [-]
MIN_COUPLED_FRACTION = 0.1  # smallest fraction of a coupled step; below, the symmetric step is tried [-]


class ContactStatus(IntEnum):
    """Whether the iteration goes on, and how it ended."""

    running = 0
    searching = 1  # no part of the coupled step is good enough: goes on with the symmetric one
    converged = 2
    stopped = 3  # stalled
    circling = 4  # back where it was two steps before, or out of steps
    unstable = 5  # a node reached the radius, or no step decreases the merit function


def shrinks(length: real, dhat: real, gap: real) -> bool:
    """Whether the indenter is shrunk by the mean `gap` before a step: not after one whose longest motion of a node is a
    `length` far from the solution, where it is meaningless, nor without contact, where it is nan."""
    return length <= dhat and gap == gap


def free_part(gap: real, reach: real, way: real, tiny: real) -> real:
    """Part of a point's way [mm] without tunnelling, from a gap to an indenter with this reach [mm]. Distance is
    1-Lipschitz: a point that moves less than its gap cannot enter, and with half the reach in addition it cannot leave
    on the far side. `tiny` [mm] keeps it finite; both sides of the fraction are doubled."""
    return (gap + abs(gap) + reach) / (way + way + tiny)


def armijo(new: real, old: real, predicted: real, rounding: real, decrease: real) -> bool:
    """Whether a function falls from `old` to `new` by enough of the `predicted` change, which is negative; an increase
    of `rounding` times its size counts as rounding."""
    return new <= old + decrease * predicted + rounding * abs(old)


def after_step(whole: bool, part: real, length: real, drift: real, off: real, xtol: real, least: real) -> int:
    """How the iteration stands after a `part` of a step, or the `whole`, whose longest motion of a node is a `length`:
    it has converged when a whole step moves no node by more than xtol and the mean gap agrees, which was off by `drift`
    before and is `off` now, nan without contact; it stalls at a fraction `least`."""
    small = length <= xtol
    if whole and small and not (abs(drift) > xtol or off > xtol):
        return ContactStatus.converged
    if part * length < least * xtol:
        return ContactStatus.converged if small else ContactStatus.stopped
    return ContactStatus.running
