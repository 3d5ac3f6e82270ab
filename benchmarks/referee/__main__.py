"""Judge the contact forces of simulators of soft pads.

    python -m benchmarks.referee [--players NAME ...] [--cases TEXT ...] [-o FOLDER] [--reference]

Writes FOLDER/results/referee.json, referee.png and FOLDER/referee.md; what they hold of other players stays.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.referee import reference, report
from benchmarks.referee.case import CASES, Case
from benchmarks.referee.player import NotPlayed, Player
from benchmarks.referee.players import MODULES, players
from benchmarks.referee.score import score
from benchmarks.results_page import Say
from tacgen.base.errors import UserError
from tacgen.base.terminal import say


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the referee; returns the exit code."""
    ask = argparse.ArgumentParser(
        "python -m benchmarks.referee", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    ask.add_argument("--players", nargs="+", choices=MODULES, default=list(MODULES), help="all if left out")
    ask.add_argument("--cases", nargs="+", default=[""], help="parts of their names; all if left out")
    ask.add_argument("-o", "--out", type=Path, default=Path("out/referee"), help="folder; out/referee if left out")
    ask.add_argument("--reference", action="store_true", help="solve the reference again, which takes an hour")
    told = ask.parse_args(arguments)
    cases = [case for case in CASES if any(part in case.name for part in told.cases)]

    def tell(text: str) -> None:
        say(text, err=True)

    try:
        if told.reference:
            reference.write(cases, tell)
        found = [entry for name in told.players for one in players(name) for entry in entries(one, cases, tell)]
        report.write(told.out, found)
    except UserError as error:
        for line in error.lines:
            tell(line)
        return 2
    say(str(told.out / report.PAGE))
    return 0


def entries(player: Player, cases: Sequence[Case], tell: Say) -> Iterator[dict[str, Any]]:
    """The scores of a player at each of its settings, by case; of a case that it does not play, why."""
    if (why := player.available()) is not None:
        tell(f"{player.name}: not run: {why}")
        yield {"player": player.name, "setting": "", "version": "", "not_run": why, "settings": {}, "cases": {}}
        return
    for setting in player.settings:
        played, told = dict[str, Any](), dict[str, Any]()
        for case in cases:
            try:
                said = player.play(case, setting)
                its = score(case, said, reference.kept()[case.name])
                told = told or said.settings
                played[case.name] = {**asdict(its), "resolved": its.resolved, "force_N": said.force.round(5).tolist()}
                far = f"{max(its.force):.2%} of the force" if its.force else "no force"
                tell(f"{player.name}, {setting}, {case.name}: {far}, {its.seconds:.2f} s")
            except NotPlayed as error:
                played[case.name] = {"not_played": str(error)}
                tell(f"{player.name}, {setting}, {case.name}: not played: {error}")
        yield {
            "player": player.name,
            "setting": setting,
            "version": player.version(),
            "settings": told,
            "cases": played,
        }


if __name__ == "__main__":
    sys.exit(main())
