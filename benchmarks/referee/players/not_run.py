"""Simulators that take no part, and why."""

from dataclasses import dataclass

from benchmarks.referee.case import Case
from benchmarks.referee.player import Answer, NotPlayed


@dataclass(frozen=True)
class Absent:
    """A player that never runs."""

    name: str
    why: str
    settings: tuple[str, ...] = ("default",)

    def available(self) -> str:
        return self.why

    def version(self) -> str:
        return ""

    def play(self, case: Case, setting: str) -> Answer:
        raise NotPlayed(self.why)


PLAYERS = (
    Absent("Newton MPM, implicit", "a punch pressed by .4 mm met 2 % of the force at voxels of 2 mm: not understood"),
    Absent("Genesis MPM", "not set up: a rigid body meets its points by speeds on a grid, as in Newton's"),
    Absent("Newton Style3D", "cloth alone: the solver leaves out tetrahedra"),
    Absent("Newton MuJoCo", "rigid bodies alone: the solver leaves out points"),
    Absent("Warp FEM", "its example of contact, in 2D, glues two bodies: nothing presses, slides or lets go"),
    Absent("Taxim", "its markers move as finite elements of its own gel did, whose data are of that gel alone"),
)
