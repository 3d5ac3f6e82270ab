"""A frame in solution as one record: what is solved, what is left to do, and the iterates of the present load step."""

from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np

from tacgen.mechanics.bulk import BulkPoint
from tacgen.mechanics.contact_newton import ContactIterate, Quadratic, QuadraticPoint
from tacgen.mechanics.coupled import CoupledContact
from tacgen.mechanics.failures import Failure, NotConverged
from tacgen.mechanics.load_step import Found, LoadStep
from tacgen.mechanics.phases import Phase
from tacgen.mechanics.state import History, State

Array = np.ndarray
T = TypeVar("T")
INITIAL_CONTRACTION = 0.1  # assumed contraction of the residual by a kept tangent, before it is measured [-]


def known(part: T | None) -> T:
    """A part of a SolveState that the present phase is sure to have."""
    assert part is not None
    return part


class Leg(NamedTuple):
    """A load step to do, from pose a to pose b (4, 4), rotating by `turn` (3,) [rad] in `duration` [s]; how often it
    was halved, and how often because it was too far; `budget`: whether it starts a new count of Newton steps."""

    a: Array
    b: Array
    turn: Array
    duration: float
    halved: int = 0
    far: int = 0
    budget: bool = True


@dataclass(frozen=True)
class Linearised:
    """A step of the bulk in the making: the unbalanced forces g (n, 3) [N], their forward substitution y, the bulk
    condensed to the contact, and the contact's iterate."""

    g: Array
    y: Array
    quadratic: Quadratic
    inner: ContactIterate[QuadraticPoint]

    @property
    def damping(self) -> float:
        """Over the stiffness at rest [-]; the contact's steps may increase it."""
        return self.quadratic.schur.damping


@dataclass(frozen=True)
class Stepped:
    """A step that lowers the energy: the bulk there, the part of the step that was taken, the decrease of the energy
    over the predicted one, and the contact's iterate there."""

    there: BulkPoint
    part: float
    gain: float
    inner: ContactIterate[QuadraticPoint]


@dataclass(frozen=True)
class BulkIterate:
    """Newton's method on the bulk: the bulk at the iterate, the J predicted there by the last step, the contact with
    its offset; whether the next step takes a new tangent; the residual, its contraction and the damping so far."""

    start: Array  # x (n, 3) where it began
    at: BulkPoint
    J: tuple[Array, ...]
    contact: CoupledContact
    new: bool
    residual: float = np.inf  # of the contact force
    rate: float = INITIAL_CONTRACTION
    damping: float = 0.0  # over the stiffness at rest [-]
    steps: int = 0
    path: tuple[Array, ...] = ()  # x (n, 3) after each step, from the first that needed damping on
    linear: Linearised | None = None
    stepped: Stepped | None = None


@dataclass(frozen=True)
class SolveState:
    """All that a solve knows between two kernels, but for the factor of the problem's kept tangent.

    index: of the frame; history: the end of the last load step; legs: the load steps to do; near: a solution for the
    same history nearby, only as a start; may_halve: whether a load step that fails is halved; effort: Newton steps of
    the bulk so far. state: the frame so far, with the work of all its load steps. Of the present load step: contact and
    bulk at its pose; where Newton's method begins (n, 3), its iterate and what it found; solves so far, each with
    stiffer barriers; their steps.
    """

    index: int
    history: History
    legs: tuple[Leg, ...]
    near: State | None = None
    may_halve: bool = True
    effort: int = 0
    phase: Phase = Phase.begin
    state: State | None = None
    step: LoadStep | None = None
    begins: Array | None = None
    newton: BulkIterate | None = None
    found: Found | None = None
    solves: int = 0
    steps: int = 0
    damped: int = 0
    failure: NotConverged | None = None

    def between(self) -> "SolveState":
        """Without what belongs to one load step: plain arrays, which can be kept."""
        return replace(self, step=None, begins=None, newton=None, found=None, solves=0, steps=0, damped=0)

    def failed(self, failure: Failure, **data: object) -> "SolveState":
        """With the reason why the load step has no solution."""
        return replace(self, failure=NotConverged(failure, **data))

    def __str__(self) -> str:
        left, newton = len(self.legs), self.newton
        text = (
            f"frame {self.index}: {self.phase}, {left} load step{'s' * (left != 1)} to do, {self.effort} Newton steps"
        )
        if newton is not None:
            text += f"; residual {newton.residual:.1e}, damping {newton.damping:.1e}"
        if newton is not None and newton.linear is not None:
            text += f", {newton.linear.inner.steps} contact steps"
        return text if self.failure is None else f"{text}: {self.failure}"

    def reached(self) -> tuple[History, State]:
        """The end of a solve. Raises NotConverged: it failed."""
        if self.failure is not None and self.phase is Phase.failed:
            raise self.failure
        assert self.state is not None
        return self.history, self.state
