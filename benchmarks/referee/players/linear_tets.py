"""Linear tetrahedra, as most simulators of soft bodies have: tacgen's `mesh: linear_tet`, all else the same."""

from benchmarks.referee.players.tacgen_player import Tacgen

PLAYERS = (
    Tacgen("linear tets", {"default": "default", "fine": "{edge_mm: 0.25, dhat_mm: 0.02}"}, ("mesh=linear_tet",)),
)
