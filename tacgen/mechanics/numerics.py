"""The arrays of a solve behind one interface: NumPy's of one scene, or an engine's of hundreds.

The phases (load_step_phases, bulk_newton, admission, load_stepping) decide how each scene goes on; what they need to
know is computed here, for the scenes in some rows at once. `one_scene.OneScene` does so on a core.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from tacgen.mechanics.course import Course
from tacgen.mechanics.failures import NotConverged
from tacgen.mechanics.options import SolverOptions
from tacgen.mechanics.phases import Outcome
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.state import History
from tacgen.physics.decisions import ContactStatus

Array = np.ndarray
BARRIER_STIFFENING_FACTOR = 4.0  # factor of a barrier that does not suffice [-]


class StepEnd(NamedTuple):
    """The end of a step of the bulk: residual over the contact force; whether the step was small, the indenter acts on
    condensed facets only, and the contact has converged, went in circles, and has the mean gap by which the indenter
    is shrunk."""

    residual: float
    still: bool
    covered: bool
    converged: bool
    circling: bool
    agrees: bool


class Checked(NamedTuple):
    """An equilibrium: smallest gap [mm], certified lower bound of J, residual and imbalance over the contact force,
    depth of the gel inside the indenter [mm], and whether a point passed through it."""

    least_gap: float
    least_J: float
    residual: float
    balance: float
    deep: float
    through: bool


@dataclass(frozen=True)
class Reached:
    """An equilibrium: the history that the next load step inherits, but for folds; normals (f, q, 3) outward in the
    sensor's frame, friction (f, q, 3) [N] on the gel, which points slide (f, q), and the mean gap [mm]."""

    after: History
    outward: Array
    friction: Array
    sliding: Array
    mean_gap: float


class Numerics(Protocol):
    """Arrays of scenes in rows, and of the load step in hand of each, as the phases need them."""

    @property
    def options(self) -> SolverOptions: ...

    @property
    def condensed(self) -> bool:
        """Whether contact is solved on Schur complements."""

    @property
    def courses(self) -> Mapping[int, Course]:
        """How far the scene in each row is."""

    def problem(self, row: int) -> Problem: ...

    def place(self, rows: list[int]) -> list[Outcome]:
        """Contact and bulk at the pose of the next load step, and whether the kept tangent serves its prediction."""

    def renew(self, rows: list[int]) -> list[bool]:
        """Factorise the tangents at the last equilibria; which are positive definite."""

    def predict(self, rows: list[int]) -> list[bool]:
        """Move the gel with the indenter by these tangents; which scenes have a prediction."""

    def choose(self, rows: list[int]) -> list[bool]:
        """The first of a solution nearby, the prediction and the last positions in which nothing tunnels and no cell is
        inverted, and anchors of new points; which scenes have such a place."""

    def start(self, rows: list[int]) -> None:
        """Newton's method at that place, or where the solve with softer barriers ended."""

    def whole(self, row: int) -> NotConverged | None:
        """Newton's method on all unknowns to its end, where contact is not condensed; its failure."""

    def follow(self, rows: list[int]) -> list[bool]:
        """Condense to the nodes on which contact acts; which kept tangents serve there."""

    def factor(self, rows: list[int]) -> list[bool]:
        """Factorise the tangents at the iterates, with the pressures predicted; which are positive definite."""

    def load(self, rows: list[int]) -> None:
        """The unbalanced forces, condensed."""

    def untouch(self, rows: list[int]) -> None:
        """The contact before its first step, with `Newton.inner_damping`."""

    def contact(self, rows: list[int]) -> list[ContactStatus]:
        """A step of the contact, or a part of one."""

    def lower(self, rows: list[int], part: float) -> list[bool]:
        """Take a part of the step of all nodes where it lowers the energy, normal forces frozen; where it does."""

    def measure(self, rows: list[int]) -> list[StepEnd]:
        """The end of the step that was taken, which is the next iterate."""

    def least_J(self, row: int, start: bool) -> float:
        """Smallest J at the iterate, or where Newton's method began."""

    def check(self, rows: list[int]) -> list[Checked]:
        """The figures of equilibria."""

    def stiffen(self, row: int, contact: bool, folding: bool) -> None:
        """Stiffer barriers of the contact or against inversion."""

    def record(self, rows: list[int]) -> list[Reached]:
        """Equilibria, from which the next load steps begin."""

    def forget(self, row: int) -> None:
        """The kept tangent no longer serves: a load step failed."""
