"""The answers that players are judged by: CalculiX or, with friction, FElupe, on two meshes each; and closed forms."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from benchmarks import calculix
from benchmarks.referee.case import CASES, PAD_MM, Array, Case, Shape, dots, spread
from benchmarks.referee.player import Answer
from benchmarks.referee.players import felupe_player
from benchmarks.reference_runs import row_of
from benchmarks.results_page import ROOT, Say
from tacgen.base.errors import UserError
from tacgen.geometry import surface_nets
from tacgen.geometry.gel import GelBody
from tacgen.mechanics import mesh
from tacgen.recipe import scene_of_row

FORCES, MAPS = ROOT / "docs/results/referee_reference.json", ROOT / "docs/results/referee_reference.npz"
SCALES = (1.0, 1.4)  # of the steps of CalculiX's two meshes
FRICTION = ({"edge_mm": 0.9, "steps": 8}, {"edge_mm": 0.9, "steps": 4}, {"edge_mm": 1.25, "steps": 4})  # of FElupe
SAG_MM, FACET_MM = 0.003, 0.4  # of the body: distance of its facets from the shape, and their longest edge
MAX_HEIGHT_MM = 0.3  # parts of the body that stay higher above the untouched face never touch it
CLOSED = "closed form"
PARTS = ("pressure", "traction", "markers")


@dataclass(frozen=True)
class Judged:
    """The answer of a reference, named in `judge`, and its own error in each frame: of the force (n,) [N] and of the
    torque (n,) [N mm], the difference of two meshes and, of FElupe, of two steps; 0 of a closed form."""

    judge: str
    answer: Answer
    force_error: Array
    torque_error: Array


def symmetry(case: Case) -> calculix.Symmetry:
    """The symmetry of a case without friction."""
    moved = {name for name, *values in zip(case.poses[0]._fields, *case.poses, strict=True) if any(values)}
    return "xy" if moved <= {"z"} else "y" if moved <= {"z", "x"} else "x"


def body(case: Case) -> calculix.Body:
    """The part of the case's shape that can touch the part of the gel that is solved. Facets are as much outside of the
    shape as inside."""
    import trimesh

    shape = scene_of_row.build(row_of(case.recipe)).shape
    made = surface_nets.of_shape(shape, half=5.0, height=2.0, tolerance=SAG_MM)
    split: Any = trimesh.remesh.subdivide_to_size  # without types
    vertices, triangles = split(made.vertices, made.triangles, FACET_MM)
    whole = trimesh.Trimesh(vertices, triangles)
    d, normals = shape.gradient(whole.vertices)
    vertices = whole.vertices - d[:, None] * normals
    corners = vertices[whole.faces]
    lowest = np.min([corners @ pose.matrix[2, :3] + pose.z for pose in case.poses], 0).min(1)
    kept = (lowest < MAX_HEIGHT_MM) & (normals[whole.faces][..., 2] < 0.3).all(1)
    for axis, name in enumerate("xy"):
        if name in symmetry(case):
            kept &= corners[..., axis].max(1) > -FACET_MM
    sag = np.where(kept, 0.75 * shape.value(corners.mean(1)), 0.0)
    count = np.bincount(whole.faces.ravel(), np.repeat(kept, 3), len(vertices))
    out = -np.bincount(whole.faces.ravel(), np.repeat(sag, 3), len(vertices)) / np.maximum(count, 1)
    used, number = np.unique(whole.faces[kept], return_inverse=True)
    return calculix.Body((vertices + out[:, None] * normals)[used], number.reshape(-1, 3), normals[used])


@cache
def pad() -> GelBody:
    """The gel of all cases."""
    return scene_of_row.build(row_of(CASES[0].recipe)).gel


# Steps of the mesh [mm] under each shape, up to a distance from its middle, along x and along y: small where the rim of
# the contact is, which for punch and ring is round.
STEPS: dict[Shape, tuple[tuple[tuple[float, float], ...], ...]] = {
    "ball": (((2.4, 0.5),), ((2.4, 0.5),)),
    "punch": (((1.9, 0.65), (3.3, 0.24)), ((1.9, 0.65), (3.3, 0.24))),
    "edge": (((0.4, 0.2), (1.3, 0.3)), ((3.0, 1.0), (4.3, 0.33))),
    "ring": (((1.6, 0.55), (4.0, 0.4)), ((1.6, 0.55), (4.0, 0.4))),
}
FIRST_LAYER = {"ball": 0.5, "punch": 0.24, "edge": 0.25, "ring": 0.4}  # height of the elements under the face [mm]


def _axis(steps: tuple[tuple[float, float], ...], scale: float, end: float, slid: float = 0.0) -> Array:
    """Coordinates from 0 to `end` with these steps, times `scale`; beyond them the steps grow. The last part is longer
    by the way `slid`."""
    at = [0.0]
    for number, (to, step) in enumerate(steps):
        stop = to + (slid if number == len(steps) - 1 else 0.0)
        count = max(round((stop - at[-1]) / (scale * step)), 1)
        at += list(np.linspace(at[-1], stop, count + 1)[1:])
    size, left = at[-1] - at[-2], end - at[-1]
    count = next(n for n in range(1, 99) if sum(min(size * 1.7**k, 4.0) for k in range(1, n + 1)) > 0.85 * left)
    grown = np.cumsum([min(size * 1.7**k, 4.0) for k in range(1, count + 1)])
    return np.array([*at, *(at[-1] + left * grown / grown[-1])])


def axes(case: Case, planes: calculix.Symmetry, scale: float) -> tuple[Array, Array, Array]:
    """The mesh's coordinates [mm]."""
    x, y = STEPS[case.shape]
    slid = max(pose.x for pose in case.poses)
    xs, ys = _axis(x, scale, PAD_MM[0] / 2, slid), _axis(y, scale, PAD_MM[1] / 2)
    if planes == "y":
        xs = np.concatenate([-_axis(x, scale, PAD_MM[0] / 2)[:0:-1], xs])
    if planes == "x":
        ys = np.concatenate([-ys[:0:-1], ys])
    zs, _ = mesh.heights(pad(), scale * FIRST_LAYER[case.shape], 1.5, 1.6)
    return xs, ys, zs


def _solved(case: Case, scale: float) -> Answer:
    """A case without friction by CalculiX."""
    planes, tool, poses, frames = symmetry(case), body(case), case.poses, list(case.judged)
    if way := case.poses[-1].x:  # without friction it ends as a press there, in which CalculiX fails less often
        tool = replace(tool, vertices=tool.vertices + np.array([way, 0.0, 0.0]))
        poses, frames = tuple(pose for pose in poses if not pose.x), [-1]
    path = [pose.matrix for pose in poses]
    found = calculix.follow(pad(), axes(case, planes, scale), tool, path, symmetry=planes)
    maps = [spread(found.points[k], found.forces[k]) for k in frames]
    pressure, traction = (np.array(part) for part in zip(*maps, strict=True))
    markers = np.array([LinearNDInterpolator(found.face[:, :2], found.moved[k, :, :2])(dots()) for k in frames])
    return Answer(found.force[frames], found.torque[frames], found.seconds, {}, pressure, traction, markers)


def judged(case: Case) -> Judged:
    """The reference of a case, solved now.

    Raises:
        UserError: CalculiX or FElupe is not installed, or has not finished.
    """
    if case.mass_kg:  # at rest both gels together bear the weight, which is along y
        held = np.tile([0.0, case.weight, 0.0], (len(case.judged), 1))
        nothing = np.zeros(len(held))
        return Judged(CLOSED, Answer(held, np.zeros_like(held), 0.0), nothing, nothing)
    ours = felupe_player.PLAYERS[0]
    if case.friction and ours.available():
        raise UserError("the reference needs FElupe: pip install felupe pypardiso")
    if not case.friction and not calculix.installed():
        raise UserError("the reference needs CalculiX: apt install calculix-ccx")
    judge = f"{ours.name} ({ours.version()})" if case.friction else calculix.version()
    played = [ours.run(case, how) for how in FRICTION] if case.friction else [_solved(case, scale) for scale in SCALES]
    apart = ([getattr(a, part) - getattr(b, part) for a, b in pairwise(played)] for part in ("force", "torque"))
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
