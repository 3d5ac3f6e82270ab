"""Uncertain inputs of a scene, and the change of its frames with each of them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter

from tacgen.fem.materials import Law
from tacgen.mechanics import Failure, NotConverged, Problem, State, mesh, states
from tacgen.mechanics.scene import Scene
from tacgen.mechanics.sensitivity import Parameter, Sensitivity
from tacgen.sensor.model import Gel

Array = np.ndarray
# edge ratio of the second mesh [-]; order of convergence, 1 to 2 for forces and maps
COARSE_EDGE_RATIO, CONVERGENCE_ORDER = 1.5, 1.5
# error over the difference of both meshes (Richardson extrapolation) [-]
RICHARDSON_FACTOR = 1 / (COARSE_EDGE_RATIO**CONVERGENCE_ORDER - 1)
MIN_COMPONENT_SHARE = 0.05  # smallest difference of a force's component over that of the whole force [-]
FORCE_DIFFERENCE_RATIO = 1e-3  # relative change of the contact force in difference quotients of maps [-]


def on_coarser_mesh(built: Scene) -> tuple[Problem, Iterator[State]]:
    """A scene's frames with element edges and contact range COARSE_EDGE_RATIO times as long.

    Raises:
        NotConverged: a frame has no solution on that mesh.
    """
    edge, dhat = COARSE_EDGE_RATIO * built.edge, COARSE_EDGE_RATIO * built.dhat
    built = replace(built, edge=edge, dhat=dhat, differentiable=False)
    problem = Problem.of(built, mesh.of(built))
    return problem, _solved(built, problem)


def _solved(built: Scene, problem: Problem) -> Iterator[State]:
    try:
        yield from states(built, problem)
    except NotConverged as error:
        raise NotConverged(Failure.coarser_mesh, why=error) from None


def mesh_variance(here: Array, coarse: Array, window: int) -> Array:
    """Variance by the discretisation error, of a force (3,) or of maps (h, w, ...).

    A single difference may be small by chance: to that of a force's component MIN_COMPONENT_SHARE of the whole force's
    is added, and a pixel's square is the mean of the window [px] around it.
    """
    square = (RICHARDSON_FACTOR * (coarse - here)) ** 2
    if here.ndim == 1:
        return np.asarray(square + MIN_COMPONENT_SHARE**2 * square.sum())
    return np.asarray(np.maximum(uniform_filter(square, (window, window, *(1,) * (here.ndim - 2))), 0.0))


@dataclass(frozen=True)
class Input:
    """An uncertain input: its name and standard deviation; the derivative of the force (3,) [N] with respect to it; and
    the state with the input larger by `step`, to first order: forces and normals change, nodes do not move."""

    name: str
    deviation: float
    force: Array
    near: State
    step: float


class Sensitivities:
    """Sensitivities of the frames of one scene, in order: friction's anchors depend on all frames before."""

    def __init__(self, problem: Problem, deviations: Mapping[str, float], gel: Gel) -> None:
        """`deviations` of modulus (relative), poissons_ratio, friction and depth [mm]; those of 0 are left out."""

        def poisson(by: float) -> tuple[Law, ...]:
            number = "poissons_ratio"
            old = [(layer, getattr(layer, number)) for layer in gel.layers]
            return tuple(
                (layer if v is None else layer.model_copy(update={number: v + by})).material() for layer, v in old
            )

        room = min(0.5 - (getattr(layer, "poissons_ratio", 0) or 0) for layer in gel.layers)
        inputs = {
            "poissons_ratio": (Parameter(room, poisson), deviations.get("poissons_ratio", 0.0)),
            "friction": (Parameter(1.0, friction=1.0), deviations.get("friction", 0.0) if problem.friction else 0.0),
            "depth": (Parameter(problem.contact.dhat, depth=1.0), deviations.get("depth", 0.0)),
        }
        inputs = {name: pair for name, pair in inputs.items() if pair[1] > 0}
        self._deviations = {name: deviation for name, (_, deviation) in inputs.items()}
        self._modulus = deviations.get("modulus", 0.0)
        self._path = Sensitivity(problem, [parameter for parameter, _ in inputs.values()]) if inputs else None

    def at(self, state: State) -> Iterator[Input]:
        """The uncertain inputs at the next frame."""
        force, normal_force = state.traction_force, state.normal_force
        if self._modulus:  # scaling all moduli scales the forces and moves no node
            yield _moved("modulus", self._modulus, state, force, normal_force, np.zeros_like(force))
        if self._path is not None:
            slopes = self._path.frame(state)
            each = zip(self._deviations.items(), slopes.force, slopes.normal_force, slopes.normal, strict=True)
            for (name, deviation), f, N, n in each:
                yield _moved(name, deviation, state, f, N, n)


def _moved(name: str, deviation: float, state: State, force: Array, normal_force: Array, normal: Array) -> Input:
    pressed, change = float(state.normal_force.sum()), float(np.abs(force).sum())
    # FORCE_DIFFERENCE_RATIO without contact
    step = FORCE_DIFFERENCE_RATIO * pressed / max(change, 1e-300) or FORCE_DIFFERENCE_RATIO
    N, n = state.normal_force + step * normal_force, state.normal + step * normal
    rub = None if state.friction is None else state.traction_force + step * force - N[..., None] * n
    return Input(name, deviation, force.sum((0, 1)), replace(state, normal_force=N, normal=n, friction=rub), step)
