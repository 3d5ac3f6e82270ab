"""How far the solve of a scene in a batch is."""

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from tacgen.mechanics.failures import NotConverged
from tacgen.mechanics.phases import Phase
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.solve_state import INITIAL_CONTRACTION, Leg
from tacgen.mechanics.state import History, State
from tacgen.tensor_engine.grids import Place


class PartOfStep(Enum):
    """The next part of a step of a scene's contact. They have queues of their own, since few scenes need the last two.

    COUPLED: takes the coupled step, unless its condensed bulk must be reduced to other unknowns first; REDUCE: that;
    SYMMETRIC: takes a part of the symmetric step, since no part of the coupled one was good enough.
    """

    COUPLED = 0
    REDUCE = 1
    SYMMETRIC = 2


@dataclass
class Course:
    """How far a scene's solve is: as SolveState, BulkIterate and Linearised say it, but for arrays."""

    problem: Problem
    place: Place
    phase: Phase = Phase.begin
    index: int = 0
    legs: tuple[Leg, ...] = ()
    near: bool = False  # whether `begins` has a solution nearby
    may_halve: bool = True
    effort: int = 0
    state: State | None = None
    states: list[State] = field(default_factory=list)
    why: NotConverged | str | None = None
    history: History | None = None
    failure: NotConverged | None = None
    usable: bool = False  # whether the kept factor serves
    rested: bool = False  # whether there is the Schur complement at rest
    left: bool = False  # whether its contact is where the factors cannot be condensed to
    nodes: int = 0  # condensed ones
    # of the load step
    predicted: bool = False
    found: bool = False
    solves: int = 0
    steps: int = 0
    damped: int = 0
    # of Newton's method on the bulk
    new: bool = False
    residual: float = np.inf
    rate: float = INITIAL_CONTRACTION
    damping: float = 0.0
    newton_steps: int = 0
    newton_folding: int = 0  # of newton_steps, those from the first that needed damping on
    # of the step in the making
    inner_damping: float = 0.0
    part_of_step: PartOfStep = PartOfStep.COUPLED
    kept: int = 0  # unknowns to which the Schur complement is reduced, or will be
    reduced: float = -1.0  # damping of the Schur complement whose reduction is kept; -1: none
    part: float = 1.0

    def fresh(self) -> None:
        """Forget all that belongs to one load step."""
        self.predicted = self.found = False
        self.solves = self.steps = self.damped = 0
