"""How far the solve of a frame is, whichever engine solves it; arrays of the present load step are that engine's."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from tacgen.mechanics.failures import Failure, NotConverged
from tacgen.mechanics.phases import Phase
from tacgen.mechanics.state import History, State

Array = np.ndarray
INITIAL_CONTRACTION = 0.1  # assumed contraction of the residual by a kept tangent, before it is measured [-]


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


@dataclass
class Newton:
    """Newton's method on the bulk in a load step: whether the next step takes a new tangent; the residual over the
    contact force, its contraction, the damping over the stiffness at rest; steps so far, and of them those from the
    first that needed damping on."""

    new: bool = False
    residual: float = np.inf
    rate: float = INITIAL_CONTRACTION
    damping: float = 0.0
    steps: int = 0
    folding: int = 0
    # of the step in the making: its damping, which the contact's steps may increase, and the part that is taken
    inner_damping: float = 0.0
    part: float = 1.0


@dataclass
class Course:
    """All that decides how a solve goes on, but for factors and iterates.

    index: of the frame; history: the end of the last load step; legs: the load steps to do; near: a solution for the
    same history nearby, only as a start; may_halve: whether a load step that fails is halved; effort: Newton steps of
    the bulk so far. state: the frame so far, with the work of all its load steps. Of the present load step: whether
    there is a prediction and whether a solve has found an equilibrium; solves so far, each with stiffer barriers; their
    steps, and those of them in a fold.
    """

    index: int
    history: History
    legs: tuple[Leg, ...]
    near: State | None = None
    may_halve: bool = True
    effort: int = 0
    phase: Phase = Phase.begin
    state: State | None = None
    failure: NotConverged | None = None
    predicted: bool = False
    found: bool = False
    solves: int = 0
    steps: int = 0
    damped: int = 0
    newton: Newton = field(default_factory=Newton)

    def fresh(self) -> None:
        """Forget what belongs to one load step, before the next one."""
        self.effort = 0 if self.legs[0].budget else self.effort
        self.failure, self.predicted, self.found = None, False, False
        self.solves = self.steps = self.damped = 0

    def fail(self, failure: Failure, **data: object) -> None:
        """Note why the load step has no solution."""
        self.failure = NotConverged(failure, **data)

    def reached(self) -> tuple[History, State]:
        """The end of a solve. Raises NotConverged: it failed."""
        if self.failure is not None and self.phase is Phase.failed:
            raise self.failure
        assert self.state is not None
        return self.history, self.state
