"""Which inputs of a scene are not sure, and the frame as it would be with each a little larger."""

from collections.abc import Iterator
from dataclasses import replace

from tacgen.fem.materials import Law
from tacgen.recipe.model import Uncertainty
from tacgen.recipe.sensor import Gel
from tacgen.scene.scene import law_of
from tacgen.solve import Problem, State
from tacgen.solve.sensitivity import Linearised, Parameter


class Sensitivities:
    """Goes along the frames of one scene in order: a frame starts from the friction anchors of the one before."""

    def __init__(self, problem: Problem, asked: Uncertainty, gel: Gel) -> None:
        """Inputs whose standard deviation is 0 are left out."""

        def poisson(by: float) -> tuple[Law, ...]:
            number = "poissons_ratio"
            old = [(layer, getattr(layer, number)) for layer in gel.layers]
            return tuple(law_of(layer if v is None else layer.model_copy(update={number: v + by})) for layer, v in old)

        material, room = asked.material, min(0.5 - (getattr(la, "poissons_ratio", 0) or 0) for la in gel.layers)
        inputs = {
            "poissons_ratio": (Parameter(room, poisson), material.poissons_ratio),
            "friction": (Parameter(1.0, friction=1.0), material.friction),
            "depth": (Parameter(problem.contact.dhat, depth=1.0), asked.pose.depth_mm),
        }
        inputs = inputs if problem.friction else {k: pair for k, pair in inputs.items() if k != "friction"}
        self._inputs = {name: pair for name, pair in inputs.items() if pair[1] > 0}
        self._modulus = material.modulus
        self._problem, self._before = problem, problem.rest(problem.contact.pose)

    def at(self, state: State) -> Iterator[tuple[str, State, float, float]]:
        """Each input's name, the frame where it is larger by a step, that step, and its standard deviation."""
        if self._modulus:  # forces are proportional to all moduli together, and nothing moves
            rub = None if state.friction is None else 2 * state.friction
            yield "modulus", replace(state, normal_force=2 * state.normal_force, friction=rub), 1.0, self._modulus
        here = Linearised(self._problem, state, self._before) if self._inputs else None
        for name, (parameter, deviation) in self._inputs.items():
            assert here is not None
            yield name, *here.moved(parameter), deviation
        assert state.after is not None
        self._before = state.after
