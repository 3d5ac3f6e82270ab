"""The solver: the states of a scene's gel along the path, by load steps. docs/MECHANICS.md has the algorithm by module.

Contact by distance is solved by bulk_newton (on the gel) with contact_newton (on its Schur complement), or without
CHOLMOD by full_newton (on all unknowns); contact between meshes by newton (on an energy) and lagging.
"""

from tacgen.solve.frames import TooMuch, normal_force, states
from tacgen.solve.options import DEFAULT, SolverOptions, plain, short_steps
from tacgen.solve.problem import Problem
from tacgen.solve.state import NotConverged, State
from tacgen.solve.warm import warm

__all__ = [
    "DEFAULT",
    "NotConverged", "Problem", "SolverOptions", "State", "TooMuch", "normal_force", "plain", "short_steps", "states",
    "warm",
]  # fmt: skip
