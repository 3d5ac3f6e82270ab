"""Which inputs of a scene are not sure, and how its frames move with each."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from tacgen.fem.materials import Law
from tacgen.recipe.model import Uncertainty
from tacgen.recipe.sensor import Gel
from tacgen.scene.scene import law_of
from tacgen.solve import Problem, State
from tacgen.solve.sensitivity import Parameter, Sensitivity

Array = np.ndarray
SMALL = 1e-3  # of the contact force, by which the state moves of which maps are differenced


@dataclass(frozen=True)
class Input:
    """What is not sure: its name and standard deviation; the change of force (3,) [N] by it; and the state where it is
    larger by a small `step`, forces and normals moved but no node."""

    name: str
    deviation: float
    force: Array
    near: State
    step: float


class Sensitivities:
    """Goes along the frames of one scene in order: friction's anchors depend on all frames before."""

    def __init__(self, problem: Problem, asked: Uncertainty, gel: Gel) -> None:
        """Inputs whose standard deviation is 0 are left out."""

        def poisson(by: float) -> tuple[Law, ...]:
            number = "poissons_ratio"
            old = [(layer, getattr(layer, number)) for layer in gel.layers]
            return tuple(law_of(layer if v is None else layer.model_copy(update={number: v + by})) for layer, v in old)

        material, room = asked.material, min(0.5 - (getattr(la, "poissons_ratio", 0) or 0) for la in gel.layers)
        inputs = {
            "poissons_ratio": (Parameter(room, poisson), material.poissons_ratio),
            "friction": (Parameter(1.0, friction=1.0), material.friction if problem.friction else 0.0),
            "depth": (Parameter(problem.contact.dhat, depth=1.0), asked.pose.depth_mm),
        }
        inputs = {name: pair for name, pair in inputs.items() if pair[1] > 0}
        self._deviations = {name: deviation for name, (_, deviation) in inputs.items()}
        self._modulus = material.modulus
        self._path = Sensitivity(problem, [parameter for parameter, _ in inputs.values()]) if inputs else None

    def at(self, state: State) -> Iterator[Input]:
        """The next frame's."""
        force, normal_force = state.traction_force, state.normal_force
        if self._modulus:  # forces are proportional to all moduli together, and nothing moves
            yield _moved("modulus", self._modulus, state, force, normal_force, np.zeros_like(force))
        if self._path is not None:
            slopes = self._path.frame(state)
            each = zip(self._deviations.items(), slopes.force, slopes.normal_force, slopes.normal, strict=True)
            for (name, deviation), f, N, n in each:
                yield _moved(name, deviation, state, f, N, n)


def _moved(name: str, deviation: float, state: State, force: Array, normal_force: Array, normal: Array) -> Input:
    step = SMALL * float(state.normal_force.sum()) / max(float(np.abs(force).sum()), 1e-300) or SMALL  # or none touches
    N, n = state.normal_force + step * normal_force, state.normal + step * normal
    rub = None if state.friction is None else state.traction_force + step * force - N[..., None] * n
    return Input(name, deviation, force.sum((0, 1)), replace(state, normal_force=N, normal=n, friction=rub), step)
