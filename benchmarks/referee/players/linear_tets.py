"""Linear tetrahedra, as most simulators of soft bodies have: tacgen's `mesh: linear_tet`, all else the same."""

from benchmarks.referee.players.tacgen_player import Tacgen

PLAYERS = (Tacgen("linear tets", {"default": "default"}, ("mesh=linear_tet",)),)
