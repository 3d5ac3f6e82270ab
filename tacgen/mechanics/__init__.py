"""Mechanics of a gel under an indenter: mesh, contact and the states along a path, from plain objects.

It knows no recipe. A Scene (gel, indenter, poses, friction, tolerances) is meshed by `mesh.of`, discretised by
`Problem.of`, and `states` gives the gel at every frame:

    problem = Problem.of(scene, mesh.of(scene))
    for state in states(scene, problem):
        state.traction_force.sum((0, 1))  # force of the indenter on the gel (3,) [N]

docs/MECHANICS.md has the algorithm by module. `solver` drives it: kernels of load_step_phases, bulk_newton, admission
and load_stepping, in the order of phases.PHASE_TRANSITIONS, on the arrays of one_scene (contact_newton solves on the
Schur complement) or of the batch engine. Without CHOLMOD full_newton solves on all unknowns.
The names are imported when they are first used: a recipe's path needs no solver.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tacgen.mechanics.failures import Failure, NotConverged
    from tacgen.mechanics.frames import normal_force, states, warm
    from tacgen.mechanics.options import DEFAULT_OPTIONS, SolverOptions, plain, short_steps
    from tacgen.mechanics.problem import Problem
    from tacgen.mechanics.scene import Scene
    from tacgen.mechanics.state import State

PUBLIC_MODULES = {  # of each public name
    "DEFAULT_OPTIONS": "options",
    "Failure": "failures",
    "NotConverged": "failures",
    "Problem": "problem",
    "Scene": "scene",
    "SolverOptions": "options",
    "State": "state",
    "normal_force": "frames",
    "plain": "options",
    "short_steps": "options",
    "states": "frames",
    "warm": "frames",
}

__all__ = [
    "DEFAULT_OPTIONS", "Failure", "NotConverged", "Problem", "Scene", "SolverOptions", "State", "normal_force", "plain",
    "short_steps", "states", "warm",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in PUBLIC_MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{PUBLIC_MODULES[name]}"), name)
