"""A scene as the numerics need it: gel, indenter, path and tolerances as arrays and numbers, without a recipe."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from tacgen.mechanics.face_overlap import Overlap, overlaps

if TYPE_CHECKING:
    from tacgen.geometry.analytic_sdf import Shape
    from tacgen.geometry.gel import GelBody
    from tacgen.mechanics.failures import NotConverged

Array = np.ndarray
Element = Literal["hex", "tet", "linear_tet"]
MAX_FORCE_SEARCH_DEPTH = 0.8  # largest depth in the search for a force, over the gel's thickness [-]


@dataclass(frozen=True)
class Forced:
    """Frames (N,) whose height is found from a normal force; their `poses` hold first guesses.

    asked: force at the end of the segment [N], nan where the height is given; part: fraction of the segment's change of
    force that is reached at a frame [-]; carry: fraction of the difference between the last found height and its guess
    that is added to a later pose [-]; floor: lowest height of the indenter's origin in the search [mm]; below: largest
    depth of a frame below its guess [mm], which the fine part of the mesh allows for; tol: relative tolerance of every
    force; None: the options' `force_tol` at the end of a movement, and more on the way there; end: number of frames to
    solve, all unless given; hopeless: a frame whose force the gel cannot bear, and the failure.
    """

    asked: Array
    part: Array
    carry: Array
    floor: Array
    below: Array
    tol: float | None = None
    end: int | None = None
    hopeless: "tuple[int, NotConverged] | None" = None

    @property
    def allowance(self) -> Array:
        """Largest depth (N,) of each frame below its guess, including frames that follow a found height [mm]."""
        below, out = 0.0, np.zeros(len(self.asked))
        for i, asked in enumerate(self.asked):
            below = self.below[i] if np.isfinite(asked) else below
            out[i] = self.carry[i] * below
        return out


class Wanted(NamedTuple):
    """A row of a table whose force is to be matched."""

    pose: Array | None  # (4, 4) of the object in the table, None: not known
    force: float = np.nan  # normal force; in a grasp of each finger [N]
    note: str = ""  # why the frame cannot be as the table has it


@dataclass(frozen=True)
class Match:
    """Rows of a table whose forces are to be matched.

    frames (N,): whether a frame has one; poses (N, 4, 4): of the object in the sensor's frame, in a grasp in the world,
    nan where not known; force (N,) [N], nan where not known; notes: see Wanted.
    """

    frames: Array
    poses: Array
    force: Array
    notes: tuple[str, ...]

    @classmethod
    def of(cls, wanted: Sequence[Wanted | None]) -> "Match | None":
        """The rows of all frames; None: there is none."""
        if all(each is None for each in wanted):
            return None
        every = [each or Wanted(None) for each in wanted]
        poses = np.array([np.full((4, 4), np.nan) if each.pose is None else each.pose for each in every])
        force, notes = np.array([each.force for each in every]), tuple(each.note for each in every)
        return cls(np.array([each is not None for each in wanted]), poses, force, notes)

    def __getitem__(self, index: int) -> Wanted | None:
        """The row of a frame, None where there is none."""
        return Wanted(self.poses[index], self.force[index], self.notes[index]) if self.frames[index] else None


@dataclass(frozen=True)
class GelDynamics:
    """Mass and Rayleigh damping of the gel."""

    density: float  # [t/mm^3]
    alpha: float  # factor of the mass in Rayleigh damping [1/s]
    beta: float  # factor of the stiffness in Rayleigh damping [s]
    longest: float  # longest time step [s]


@dataclass(frozen=True)
class Scene:
    """All that the numerics need of one scene, without the recipe.

    poses (N, 4, 4): indenter frame to sensor frame at each frame; with `forced` some heights are guesses;
    segment (N,): number of the trajectory segment;
    start (4, 4): the pose before the first frame, clear of the gel.
    """

    gel: "GelBody"
    shape: "Shape"
    poses: Array
    start: Array
    segment: Array
    friction: float
    edge: float  # element edge under the contact [mm]
    dhat: float  # [mm]
    forced: Forced | None = None
    dynamics: GelDynamics | None = None
    duration: Array | None = None  # (N,) of each frame [s]; None: quasi-static
    element: Element = "hex"
    turns: Array | None = None  # (N, 3) rotation vector from each pose to the next [rad]; None: the shortest
    match: Match | None = None  # what a table wants of frames
    differentiable: bool = False  # predictions take the exact tangent, for derivatives of the frames

    @property
    def prony_terms(self) -> int:
        """Terms of the longest Prony series of a layer; 0 without durations, since none has an effect then."""
        return 0 if self.duration is None else max(len(layer.prony) for layer in self.gel.layers)

    @cached_property
    def overlaps(self) -> list[tuple[Overlap, Array]]:
        """How the indenter overlaps the untouched face in some of the frames, the last among them, and their poses."""
        return overlaps(self.gel, self.shape, self.poses)
