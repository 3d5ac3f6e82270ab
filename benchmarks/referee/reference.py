"""The answers that players are judged by: FElupe's, by more than one integration and step, and a closed form."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np

from benchmarks.referee.case import CASES, Array, Case
from benchmarks.referee.player import Answer
from benchmarks.referee.players import felupe_player
from benchmarks.results_page import ROOT, Say
from tacgen.base.errors import UserError

FORCES, MAPS = ROOT / "docs/results/referee_reference.json", ROOT / "docs/results/referee_reference.npz"
# Sizes of FElupe's elements [mm] by shape, with reduced integration (2 points of Gauss an edge), which is too soft, and
# with full integration (3), which is too stiff; and its other settings, the reference first.
SMOOTH_MM = {"ball": (0.45, 0.45), "punch": (0.45, 0.45), "ring": (0.45, 0.45), "edge": (0.64, 0.64)}
FRICTION_MM = {"ball": (0.64, 0.64), "punch": (0.64, 0.64), "edge": (0.9, 0.64)}
SMOOTH = ({"steps": 4, "points": 2}, {"steps": 4, "points": 3})
FRICTION = ({"steps": 8, "points": 2}, *SMOOTH)
CLOSED = "closed form"
PARTS = ("pressure", "traction", "markers")


@dataclass(frozen=True)
class Judged:
    """The answer of a reference, named in `judge`, and its own error in each frame: of the force (n,) [N] and of the
    torque (n,) [N mm], the difference of two integrations and, with friction, of two steps; 0 of a closed form."""

    judge: str
    answer: Answer
    force_error: Array
    torque_error: Array


def judged(case: Case) -> Judged:
    """The reference of a case, solved now.

    Raises:
        UserError: FElupe is not installed.
    """
    if case.mass_kg:  # at rest both gels together bear the weight, which is along y
        held = np.tile([0.0, case.weight, 0.0], (len(case.judged), 1))
        nothing = np.zeros(len(held))
        return Judged(CLOSED, Answer(held, np.zeros_like(held), 0.0), nothing, nothing)
    ours = felupe_player.PLAYERS[0]
    if ours.available():
        raise UserError("the reference needs FElupe: pip install felupe pypardiso")
    sizes, ways = (FRICTION_MM, FRICTION) if case.friction else (SMOOTH_MM, SMOOTH)
    played = [ours.run(case, {"edge_mm": sizes[case.shape][how["points"] - 2]} | how) for how in ways]
    apart = ([getattr(a, part) - getattr(b, part) for a, b in pairwise(played)] for part in ("force", "torque"))
    judge = f"{ours.name} ({ours.version()})"
    return Judged(judge, played[0], *(np.linalg.norm(each, axis=-1).sum(0) for each in apart))


def write(cases: Sequence[Case], say: Say) -> None:
    """Solve the references of these cases and keep them; those of the others stay."""
    told = json.loads(FORCES.read_text()) if FORCES.exists() else {}
    maps = dict(np.load(MAPS)) if MAPS.exists() else {}
    for case in cases:
        found = judged(case)
        told[case.name] = {
            "judge": found.judge,
            "frames": list(case.judged),
            "force_N": found.answer.force.round(5).tolist(),
            "force_error_N": found.force_error.round(5).tolist(),
            "torque_N_mm": found.answer.torque.round(4).tolist(),
            "torque_error_N_mm": found.torque_error.round(4).tolist(),
        }
        for part in PARTS:
            if (values := getattr(found.answer, part)) is not None:
                maps[f"{case.name}/{part}"] = values.astype(np.float32)
        FORCES.write_text(json.dumps(told, indent=1) + "\n")
        np.savez_compressed(MAPS, **maps)
        say(f"{case.name}: {found.judge}, {told[case.name]['force_N'][-1]} N")


@cache
def kept() -> dict[str, Judged]:
    """The references that are kept, by the names of their cases."""
    told, maps = json.loads(FORCES.read_text()), np.load(MAPS)

    def one(case: Case) -> Judged:
        its = {key: np.array(value) for key, value in told[case.name].items() if key != "judge"}
        parts = {part: maps.get(f"{case.name}/{part}") for part in PARTS}
        answer = Answer(its["force_N"], its["torque_N_mm"], 0.0, {}, **parts)
        return Judged(told[case.name]["judge"], answer, its["force_error_N"], its["torque_error_N_mm"])

    return {case.name: one(case) for case in CASES if case.name in told}
