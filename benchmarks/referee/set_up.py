"""Minutes until a player's first answer: its packages into an empty folder by pip, then the first press without caches.

    python -m benchmarks.referee.set_up NAME [NAME ...]

Keeps them in docs/results/referee_set_up.json; a program or a GPU's driver that pip does not install is not counted.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time

from benchmarks.referee.case import CASES
from benchmarks.referee.players import MODULES, players
from benchmarks.results_page import ROOT
from tacgen.base.errors import UserError
from tacgen.base.terminal import say

MINUTES = ROOT / "docs/results/referee_set_up.json"
TACGEN = (".",)  # what pip installs of tacgen's own player
CACHES = ("XDG_CACHE_HOME", "WARP_CACHE_PATH", "HOME")  # folders where simulators keep what they compile


def minutes(name: str) -> float:
    """Minutes to set up one player.

    Raises:
        UserError: pip does not bring the player, or it failed or did not run.
    """
    wanted = getattr(players(name)[0], "distributions", TACGEN)
    if not wanted:
        raise UserError(f"{name} was not set up: pip does not install it")
    with tempfile.TemporaryDirectory() as folder:
        caches = dict.fromkeys(CACHES, f"{folder}/caches")
        packages = os.pathsep.join((f"{folder}/packages", str(ROOT)))
        known, start = os.environ | caches | {"PYTHONPATH": packages}, time.monotonic()
        pip = (sys.executable, "-m", "pip", "install", "--quiet", "--target", f"{folder}/packages", *wanted)
        first = (sys.executable, "-m", "benchmarks.referee", "--players", name, "--cases", CASES[0].name, "-o", folder)
        for command in (pip, first):
            done = subprocess.run(command, cwd=ROOT, env=known, capture_output=True, text=True, check=False)
            if done.returncode or ": not run: " in done.stderr:
                raise UserError(f"{name} was not set up: {done.stderr.strip().splitlines()[-1]}")
        return (time.monotonic() - start) / 60


def kept() -> dict[str, float]:
    """Minutes by the names of players, as they were measured last."""
    return dict(json.loads(MINUTES.read_text())) if MINUTES.exists() else {}


def main() -> None:
    """Measure some players."""
    ask = argparse.ArgumentParser("python -m benchmarks.referee.set_up", description=__doc__)
    ask.add_argument("names", nargs="+", choices=MODULES)
    for name in ask.parse_args().names:
        found = dict.fromkeys([one.name for one in players(name)], round(minutes(name), 1))
        MINUTES.write_text(json.dumps(kept() | found, indent=1) + "\n")
        say(f"{name}: {found} minutes")


if __name__ == "__main__":
    main()
