"""The frames of a scene as another engine than `mechanics.states` found them."""

from collections.abc import Sequence
from dataclasses import dataclass

from tacgen.mechanics.state import State


@dataclass(frozen=True)
class SolvedScene:
    """States of all frames, and the engine and its versions, as bundles name them; or no state, and `why` there is
    none. heights: those that presolve found, for a scene with forces [mm]."""

    engine: str
    states: Sequence[State] = ()
    why: str = ""
    heights: Sequence[float] = ()
