"""The players: names on the command line, and the modules that hold them as PLAYERS."""

import importlib

from benchmarks.referee.player import Player

MODULES = {
    "tacgen": "tacgen_player",
    "linear_tets": "linear_tets",
    "mujoco_rigid": "mujoco_rigid",
    "mujoco_flex": "mujoco_flex",
    "newton_soft": "newton_soft",
    "newton_tets": "newton_tets",
    "newton_hydroelastic": "newton_hydroelastic",
    "genesis_rigid": "genesis_rigid",
    "genesis_fem": "genesis_fem",
    "calculix": "calculix_player",
    "felupe": "felupe_player",
    "fots": "fots",
    "libuipc": "uipc",
    "not_run": "not_run",
}


def players(name: str) -> tuple[Player, ...]:
    """The players of one module, whose packages need not be installed."""
    found: tuple[Player, ...] = importlib.import_module(f"{__name__}.{MODULES[name]}").PLAYERS
    return found
