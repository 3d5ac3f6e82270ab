"""A scene in a slot of a batch, beside its course."""

from dataclasses import dataclass, field
from enum import Enum

from tacgen.mechanics.failures import NotConverged
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.state import State
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
class Slot:
    """A scene: its mesh within the pattern, its frames so far and why there are no more, and how its factors stand."""

    problem: Problem
    place: Place
    states: list[State] = field(default_factory=list)
    why: NotConverged | str | None = None
    usable: bool = False  # whether the kept factor serves
    rested: bool = False  # whether there is the Schur complement at rest
    left: bool = False  # whether its contact is where the factors cannot be condensed to
    nodes: int = 0  # condensed ones
    part_of_step: PartOfStep = PartOfStep.COUPLED
    kept: int = 0  # unknowns to which the Schur complement is reduced, or will be
    reduced: float = -1.0  # damping of the Schur complement whose reduction is kept; -1: none
