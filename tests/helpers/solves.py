"""Single movements and load steps, solved by the CPU engine."""

from typing import Any

from tacgen.mechanics.course import Course
from tacgen.mechanics.load_stepping import at_once, to_pose
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.solver import solve


def advance(problem: Problem, *movement: Any) -> Course:
    """A movement from pose to pose at its end; see load_stepping.to_pose."""
    return solve(problem, to_pose(problem, *movement))


def equilibrium(problem: Problem, *step: Any, **how: Any) -> Course:
    """One load step, which is not halved, at its end; see load_stepping.at_once."""
    return solve(problem, at_once(*step, **how))
