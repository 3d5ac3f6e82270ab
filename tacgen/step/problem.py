"""A mesh made ready to be solved on, and what one pose inherits from the one before."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from tacgen.fem import linear
from tacgen.fem.assembly import Pattern, pattern
from tacgen.fem.condensed import Condensed
from tacgen.fem.contact import Contact, Faces, Pose
from tacgen.fem.elements import elements
from tacgen.fem.potentials import Elastic
from tacgen.fem.stiffness import LAZY
from tacgen.mesh import Mesh
from tacgen.scene import Scene

if TYPE_CHECKING:
    from tacgen.fem.inertia import Body
    from tacgen.fem.ipc import MeshContact

Array = np.ndarray
UNFELT = 1e-3  # of the barrier's stiffness over dhat squared: a force that touching to within tolerances may well give
AnyContact: TypeAlias = "Contact | MeshContact"


@dataclass(frozen=True)
class Memory:
    """What a pose inherits from the one before; anchors and normals are in the indenter's frame."""

    pose: Pose
    x: Array
    before: Array  # x one pose earlier, for extrapolation
    offset: float
    normal_force: Array
    normal: Array
    anchor: Array
    gap: Array
    kappa: float  # barrier stiffness [MPa]
    scale: float  # force below which nothing is told apart [N]
    velocity: Array | None  # (n, 3) [mm/s], with inertia
    missed: tuple[Array, Array] | None = None  # of the way here, by what was carried, and that way (see step.carried)
    finer: int = 0  # how often the next step is halved before it is tried


@dataclass(frozen=True)
class Problem:
    """A mesh made ready: elasticity, contact, the linear solver, and mass where the scene asks for dynamics.

    `longest` is the longest step in time [s].
    """

    mesh: Mesh
    elastic: tuple[Elastic, ...]
    contact: AnyContact
    linear: linear.Stale
    pattern: Pattern
    friction: float
    edge: float  # [mm]
    body: "Body | None" = None
    longest: float = math.inf

    @classmethod
    def of(cls, scene: Scene, mesh: Mesh) -> "Problem":
        free = np.ones((len(mesh.points), 3), bool)
        free[np.unique(mesh.facets["bonded"])] = False
        pat = pattern([mesh.cells], free)
        elastic, softest = [], min(layer.law.mu for layer in scene.gel.layers)
        for number, layer in enumerate(scene.gel.layers):
            cells = mesh.cells[mesh.layer == number]
            lazy = LAZY * min(1.0, 10 * softest / layer.law.mu)  # what is little to a hard skin is much to a soft base
            elastic.append(Elastic.on(pat, elements(mesh.points, cells), layer.law, lazy))
        contact = _contact(scene, mesh, pat)
        ready = cls(mesh, tuple(elastic), contact, linear.best(pat), pat, scene.friction, scene.edge)
        if (d := scene.dynamics) is None:
            return ready
        from tacgen.fem.inertia import Body

        return replace(ready, body=Body.of(pat, ready.elastic, d.density, d.alpha, d.beta), longest=d.longest)

    @cached_property
    def condensed(self) -> Condensed | None:
        """What brings contact to its end within each step; None where the solver's factors cannot be read."""
        return Condensed(self.pattern) if linear.readable() else None

    @property
    def factored(self) -> int:
        """How many times the stiffness was factorised so far."""
        return int(getattr(self.linear, "factored", 0)) + (self.condensed.factored if self.condensed else 0)

    @property
    def thickness(self) -> float:
        """Of the gel [mm]."""
        return float(np.ptp(self.mesh.points[:, 2]))

    def rest(self, pose: Pose) -> Memory:
        """The untouched gel below an indenter at `pose`."""
        x = self.mesh.points
        pose = self.contact.clear(pose, x)
        force, normal, gap = self.contact.moved(pose, 0.0).pressure(x)
        local = normal @ pose.rotation
        at, kappa = pose.local(self.contact.faces.at(x)), self.contact.kappa
        still = None if self.body is None else np.zeros_like(x)
        scale = UNFELT * kappa * self.contact.dhat**2
        return Memory(pose, x, x, 0.0, np.zeros_like(force), local, at, gap, kappa, scale, still)

    def steps(self, duration: float) -> int:
        """How many steps a movement of so many seconds takes."""
        return 1 if self.body is None else max(1, math.ceil(duration / self.longest - 1e-9))


def _contact(scene: Scene, mesh: Mesh, pat: Pattern) -> AnyContact:
    """Barely softer than the gel: what the outermost layer is made of sets the barrier's stiffness."""
    facets, pose = mesh.facets["coated"], Pose.of(scene.start)
    kappa = 2 * scene.gel.layers[-1].youngs_modulus
    if scene.surface is None:
        return Contact(Faces.on(pat, mesh.points, facets), scene.shape, pose, scene.dhat, kappa)
    from tacgen.fem.ipc import MeshContact, Pair

    pair = Pair.of(pat, mesh.points, facets, scene.surface)
    return MeshContact(pair, Contact(pair.faces, scene.shape, pose, scene.dhat, kappa), pose, scene.dhat, kappa)
