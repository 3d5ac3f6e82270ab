"""FElupe: its quadratic hexes with reduced integration, neo-Hookean; contact with the exact shape and Coulomb's law are
written here, in `felupe_contact`. It judges the cases with friction.
"""

import time

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from benchmarks.referee.case import Case, Pose, dots
from benchmarks.referee.player import Answer, NotPlayed
from benchmarks.referee.players.felupe_contact import Touch, solve
from benchmarks.referee.players.felupe_pad import Pad
from benchmarks.referee.playing import Settings, Simulator, answer
from benchmarks.reference_runs import row_of
from tacgen.recipe import scene_of_row

DEFAULT = {"edge_mm": 0.9, "steps": 4, "points": 2}
LAST, LEAST = 5, 1 / 64  # corrections of the multipliers in a judged frame; the shortest step, a part of a frame


def run(case: Case, how: Settings) -> Answer:
    """Play with elements of this size under the contact, so many steps a frame, and points of Gauss along an edge."""
    if case.mass_kg:
        raise NotPlayed("a free body between two pads was not set up")
    start, shape = time.process_time(), scene_of_row.build(row_of(case.recipe)).shape
    pad = Pad(case, how["edge_mm"], how["points"])
    last, found, moved, u, rate = Pose(z=case.clearance), [], [], np.zeros(3 * len(pad.points)), 0.0
    y = (pad.at @ pad.points.ravel()).reshape(-1, 3) - last[:3]
    kept: Touch = np.zeros(len(y)), np.zeros_like(y), np.zeros((len(y), 1), bool)
    for frame, pose in enumerate(case.poses):
        way, done, usual = np.subtract(pose, last), 0.0, 1 / how["steps"] if pose.z < 0 else 1.0  # nothing touches
        step = usual
        while done < 1:
            part = min(step, 1 - done)
            now = Pose(*(np.array(last) + (done + part) * way))
            times = LAST if done + part == 1 and frame in case.judged else 1
            guesses = (u + part * rate, u, 0 * u)
            for guess in guesses:
                if (got := solve(pad, guess, y, kept, now, shape, case.friction, times)) is not None:
                    break
            else:
                if (step := part / 2) < LEAST:
                    raise NotPlayed("Newton's method did not converge")
                continue
            rate, (u, y, kept, forces) = (got[0] - u) / part, got
            done, step = done + part, usual
        after = case.poses[min(frame + 1, len(case.poses) - 1)]
        rate = rate * np.allclose(np.subtract(after, pose), way)
        if frame in case.judged:
            found.append(pad.whole((pad.at @ (pad.points.ravel() + u)).reshape(-1, 3), forces))
            moved.append(pad.whole(pad.points[pad.face], u.reshape(-1, 3)[pad.face]))
        last = pose
    said = answer(found, (time.process_time() - start) / len(case.poses), how)
    marks = [LinearNDInterpolator(at[:, :2], way[:, :2])(dots()) for at, way in moved]
    return Answer(said.force, said.torque, said.seconds, dict(how), said.pressure, said.traction, np.array(marks))


PLAYERS = (Simulator("FElupe", ("felupe", "pypardiso"), ("felupe", "pypardiso"), {"default": DEFAULT}, run),)
