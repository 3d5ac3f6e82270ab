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
    Absent("Newton hydroelastic", "its distance fields are built on a CUDA GPU alone (Newton 1.8.0)"),
    Absent("Warp FEM", "its example of contact, in 2D, glues two bodies: nothing presses, slides or lets go"),
    Absent("FOTS", "no package to install"),
    Absent("Taxim", "pictures of a given height map, without forces"),
)
