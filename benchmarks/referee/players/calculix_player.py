"""CalculiX: quadratic hexes with reduced integration, a rigid body as a moved surface, contact by a stiff penalty. A
second opinion of the reference, without friction.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from benchmarks import calculix
from benchmarks.referee.case import Case, dots, spread
from benchmarks.referee.player import Answer, NotPlayed
from benchmarks.referee.players.calculix_parts import axes, body
from benchmarks.referee.playing import Settings, Simulator
from benchmarks.reference_runs import row_of
from tacgen.recipe import scene_of_row


@dataclass(frozen=True)
class Program(Simulator):
    """A program instead of a package."""

    def available(self) -> str | None:
        return None if calculix.installed() else "not installed: ccx (apt install calculix-ccx)"

    def version(self) -> str:
        return calculix.version()


def symmetry(case: Case) -> calculix.Symmetry:
    """The symmetry of a case without friction."""
    return "xy" if case.moved <= {"z"} else "y" if case.moved <= {"z", "x"} else "x"


def run(case: Case, how: Settings) -> Answer:
    """Play without friction, on a mesh with steps of this scale."""
    if case.friction or case.mass_kg:
        raise NotPlayed("its contact with friction was not set up")
    planes, poses, frames = symmetry(case), case.poses, list(case.judged)
    tool = body(case, planes)
    if way := case.poses[-1].x:  # without friction it ends as a press there, in which CalculiX fails less often
        tool = replace(tool, vertices=tool.vertices + np.array([way, 0.0, 0.0]))
        poses, frames = tuple(pose for pose in poses if not pose.x), [-1]
    pad = scene_of_row.build(row_of(case.recipe)).gel
    path = [pose.matrix for pose in poses]
    found = calculix.follow(pad, axes(case, pad, planes, how["scale"]), tool, path, symmetry=planes)
    maps = [spread(found.points[k], found.forces[k]) for k in frames]
    pressure, traction = (np.array(part) for part in zip(*maps, strict=True))
    markers = np.array([LinearNDInterpolator(found.face[:, :2], found.moved[k, :, :2])(dots()) for k in frames])
    seconds = found.seconds / len(case.poses)
    return Answer(found.force[frames], found.torque[frames], seconds, dict(how), pressure, traction, markers)


PLAYERS = (Program("CalculiX", (), (), {"default": {"scale": 1.4}}, run),)
