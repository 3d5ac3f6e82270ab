"""The solved state of a frame, and the history that the next load step needs."""

from dataclasses import dataclass, field, replace

import numpy as np

from tacgen.geometry.pose import Pose

Array = np.ndarray


@dataclass(frozen=True)
class History:
    """The state that a load step inherits from the one before; anchors and normals are in the indenter's frame."""

    pose: Pose
    x: Array  # (n, 3) [mm]
    offset: float  # by which the indenter was shrunk [mm]
    normal_force: Array  # (f, q) [N]
    normal: Array  # (f, q, 3)
    anchor: Array  # (f, q, 3) [mm]
    gap: Array  # (f, q) [mm]
    kappa: float  # barrier stiffness [MPa]
    least_force: float  # smallest force scale of the tolerances [N]
    velocity: Array | None = None  # (n, 3) [mm/s], with inertia
    # of viscoelastic layers, by their numbers: H (k, e, q, 3, 3) [MPa]
    internal: dict[int, Array] = field(default_factory=dict)
    folded: bool = False  # a step was damped since the gel was last untouched
    predictor_error: tuple[Array, Array] | None = None  # of first order, and the motion it belongs to (see predictor)
    predicted: Array | None = None  # x (n, 3) by this load step's predictor


@dataclass(frozen=True)
class State:
    """The gel at one frame.

    x (n, 3) nodal positions [mm]; normal_force (f, q) [N] pressing on the gel's quadrature points, normal (f, q, 3)
    outward from the indenter, friction (f, q, 3) [N] on the gel or None without friction; sliding (f, q) bool.
    """

    index: int
    pose: Array
    x: Array
    normal_force: Array
    normal: Array
    friction: Array | None
    sliding: Array | None
    iterations: int  # Newton steps of the bulk
    substeps: int  # load steps
    offset: float  # by which the indenter was shrunk [mm]
    mean_gap: float  # [mm], to the shrunk indenter; equal to offset within step_tol
    min_gap: float  # [mm], to the shrunk indenter
    residual: float  # 2-norm of the free nodes' forces, over the contact force
    balance: float  # |indenter force + base reaction| / indenter force
    least_J: float  # certified lower bound of J over all of the gel [-]
    damped: int = 0  # of the iterations, those in a fold: from the first of a load step that needed damping on
    unique: bool = True  # no damped step since the gel was last untouched
    note: str = ""  # why the frame is not as a table wants it
    rounded: float = 0.0  # friction at points that crossed a sharp edge in one step, over the contact force
    internal: dict[int, Array] = field(default_factory=dict)  # see History
    after: History | None = None  # at its end
    passed: tuple[History, ...] = ()  # at the ends of its load steps but the last

    @property
    def traction_force(self) -> Array:
        """Force of the indenter on each quadrature point of the gel (f, q, 3) [N]."""
        push = self.normal_force[..., None] * self.normal
        return np.asarray(push if self.friction is None else push + self.friction)


def joined(first: State, second: State) -> State:
    """The second of two load steps in a row, with the iterations and substeps of both."""
    both = {name: getattr(first, name) + getattr(second, name) for name in ("iterations", "damped", "substeps")}
    assert first.after is not None
    passed = (*first.passed, first.after, *second.passed)
    return replace(second, **both, rounded=max(first.rounded, second.rounded), passed=passed)
