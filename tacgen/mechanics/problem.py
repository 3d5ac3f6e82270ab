"""The discretised problem of a scene: elasticity, contact and linear solver of a mesh."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen.fem.assembly import Pattern, pattern
from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import elements
from tacgen.fem.folding_barrier import FoldingBarrier
from tacgen.fem.viscoelasticity import Viscoelastic
from tacgen.geometry.pose import Pose
from tacgen.mechanics import linear_solvers
from tacgen.mechanics.barrier import Contact, Faces
from tacgen.mechanics.bulk import Bulk, Tangent
from tacgen.mechanics.mesh import GelMesh
from tacgen.mechanics.options import DEFAULT_OPTIONS, SolverOptions, tighter
from tacgen.mechanics.scene import GelDynamics, Scene
from tacgen.mechanics.state import History
from tacgen.physics.contact import MIN_SLOPE

if TYPE_CHECKING:
    from tacgen.fem.inertia import Body

Array = np.ndarray
USUAL_GAP_RATIO = 0.75  # mean gap of a light press over dhat, the first offset of the indenter [-]
BARRIER_STIFFNESS_RATIO = 2  # kappa over Young's modulus of the outermost layer [-]
FORCE_FLOOR_RATIO = 1e-3  # smallest force scale over kappa dhat^2: forces that occur within the tolerances [-]
# Contact points along a facet's side. Two partly cancel the stiffness of a coarse mesh: three make a ball 1 % and a
# flat punch 3 % stiffer. More under an indenter thinner than that side, since friction stretches the gel to twice its
# length, and where contact is narrower than the side and sharper than the mesh, since a tip passes between two points.
CONTACT_POINTS, CONTACT_POINTS_IF_THIN, CONTACT_POINTS_IF_NARROW = 2, 3, 4
EMPTY_PATTERN = Pattern(*(np.zeros(0, np.int32),) * 3, 0, *(np.zeros(0, np.int32),) * 2)


@dataclass(frozen=True)
class Problem:
    """Elasticity, contact and linear solver of a mesh; mass, if the scene has dynamics; and the viscoelastic layers, if
    it has durations.

    `dynamics` are those of the scene, of which body is made where matrices are.
    """

    mesh: GelMesh
    elastic: tuple[Elastic, ...]
    folding: tuple[FoldingBarrier, ...]
    contact: Contact
    pattern: Pattern
    friction: float
    edge: float  # [mm]
    body: "Body | None" = None
    dynamics: GelDynamics | None = None
    differentiable: bool = False  # see Scene
    viscous: dict[int, Viscoelastic] = field(default_factory=dict)  # by the layer's number
    options: SolverOptions = DEFAULT_OPTIONS

    @classmethod
    def of(
        cls, scene: Scene, mesh: GelMesh, options: SolverOptions = DEFAULT_OPTIONS, held: Array | None = None
    ) -> "Problem":
        """`held` (n, 3) bool: dofs that do not move; those of the bonded nodes unless given."""
        if held is None:
            held = np.zeros((len(mesh.points), 3), bool)
            held[np.unique(mesh.facets["bonded"])] = True
        pat = pattern([mesh.cells], ~held)
        elastic, folding = [], []
        for number, layer in enumerate(scene.gel.layers):
            some = elements(mesh.points, mesh.cells[mesh.layer == number])
            elastic.append(Elastic.on(pat, some, layer.law))
            folding.append(FoldingBarrier.on(pat, mesh.points, some, layer.law.mu))
        contact, parts = _contact(scene, mesh, pat), (tuple(elastic), tuple(folding))
        ready = cls(mesh, *parts, contact, pat, scene.friction, scene.edge, **_in_time(scene, elastic, options))
        if (d := scene.dynamics) is None:
            return ready
        from tacgen.fem.inertia import Body

        return replace(ready, body=Body.of(pat, ready.elastic, d.density, d.alpha, d.beta))

    @classmethod
    def of_known_frames(cls, scene: Scene, mesh: GelMesh, *, stress: bool = False) -> "Problem":
        """For labels of a scene whose frames another engine solves: contact, laws of the layers and, for
        `stress`, their elements; neither matrices nor the folding barrier, which take most of the time to set up."""
        some = mesh.cells if stress else mesh.cells[:0]
        layer = mesh.layer[: len(some)]
        elastic = tuple(
            Elastic(elements(mesh.points, some[layer == number]), each.law)
            for number, each in enumerate(scene.gel.layers)
        )
        contact, timed = _contact(scene, mesh, None), _in_time(scene, elastic, DEFAULT_OPTIONS)
        return cls(mesh, elastic, (), contact, EMPTY_PATTERN, scene.friction, scene.edge, **timed)

    @cached_property
    def linear(self) -> linear_solvers.Solver:
        """The fastest solver that is installed, for all free dofs at once."""
        return linear_solvers.best(self.pattern)

    @cached_property
    def tangent(self) -> Tangent:
        """The factorised tangent of the bulk, kept from step to step."""
        return self.new_tangent()

    def new_tangent(self) -> Tangent:
        """A tangent of the bulk, not yet factorised."""
        at_rest, points, pattern = Bulk(self.elastic, self.folding), self.mesh.points, self.pattern  # not self: a
        return Tangent(pattern, lambda: at_rest.at(points).stiffness(pattern))  # cycle would outlive the scene

    @property
    def condensed(self) -> bool:
        """Whether contact is solved on the Schur complement."""
        return self.options.condense and linear_solvers.readable()

    @property
    def factored(self) -> int:
        """Number of factorisations so far."""
        return self.linear.factored if not self.condensed else self.tangent.condensation.factored

    @property
    def thickness(self) -> float:
        """Thickness of the gel [mm]."""
        return float(np.ptp(self.mesh.points[:, 2]))

    def rest(self, pose: Pose) -> History:
        """The untouched gel below an indenter at `pose`."""
        x, offset = self.mesh.points, USUAL_GAP_RATIO * self.contact.dhat
        seen, kappa = self.contact.moved(pose, offset).gaps(x), self.contact.kappa
        slope = np.maximum(np.linalg.norm(seen.n, axis=2, keepdims=True), MIN_SLOPE)  # 1 but for interpolated distances
        still = None if self.body is None else np.zeros_like(x)
        least = FORCE_FLOOR_RATIO * kappa * self.contact.dhat**2
        internal = {number: layer.rest() for number, layer in self.viscous.items()}
        normal, at = seen.n / slope @ pose.rotation, pose.local(seen.at)
        return History(
            pose, x, offset, np.zeros_like(seen.d), normal, at, seen.d + offset, kappa, least, still, internal
        )

    def during(self, history: History, h: float) -> tuple[Elastic, ...]:
        """The layers' potentials in a load step of h [s]."""
        steps = {k: layer.step(history.internal[k], history.x, h) for k, layer in self.viscous.items()}
        return tuple(steps.get(k, part) for k, part in enumerate(self.elastic))

    def internal(self, history: History, x: Array, h: float) -> dict[int, Array]:
        """History.internal at x (n, 3), where that load step ends."""
        return {k: layer.after(history.internal[k], history.x, x, h) for k, layer in self.viscous.items()}

    def stressed(self, internal: dict[int, Array]) -> tuple[Elastic, ...]:
        """The layers' potentials whose stress includes these internal variables."""
        now = {k: layer.relaxing(internal[k]) for k, layer in self.viscous.items()}
        return tuple(now.get(k, part) for k, part in enumerate(self.elastic))

    def steps(self, duration: float) -> int:
        """How many steps a movement of so many seconds takes."""
        return 1 if self.dynamics is None else max(1, math.ceil(duration / self.dynamics.longest - 1e-9))


def _in_time(scene: Scene, elastic: Sequence[Elastic], options: SolverOptions) -> dict[str, Any]:
    """All that depends on time in a scene; and tighter options with it, since velocity is a difference of x over a
    short time."""
    layers = enumerate(scene.gel.layers) if scene.prony_terms else ()
    viscous = {k: Viscoelastic.of(elastic[k], layer.prony) for k, layer in layers if layer.prony}
    if scene.dynamics is not None or viscous:
        options = tighter(options)
    return {"viscous": viscous, "dynamics": scene.dynamics, "options": options, "differentiable": scene.differentiable}


def _contact(scene: Scene, mesh: GelMesh, pat: Pattern | None) -> Contact:
    """The contact at the start; without a pattern, its tangents cannot be added to a sparse matrix."""
    faces = Faces.on(pat, mesh.points, mesh.facets["coated"], points_along(scene))
    kappa = BARRIER_STIFFNESS_RATIO * scene.gel.layers[-1].youngs_modulus
    return Contact(faces, scene.shape, Pose.of(scene.start), scene.dhat, kappa)


def points_along(scene: Scene) -> int:
    """Number of contact points along a facet's side."""
    if scene.shape.smallest_radius < scene.edge:
        widths = [contact.width for contact, _ in scene.overlaps if contact.area]
        if widths and max(widths) < scene.edge:
            return CONTACT_POINTS_IF_NARROW
    return CONTACT_POINTS_IF_THIN if 2 * scene.shape.reach < scene.edge else CONTACT_POINTS
