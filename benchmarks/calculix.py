"""Paths of a rigid body on a flat pad, solved by CalculiX, an established finite element program, if it is installed.

The usual set-up: quadratic hexes with reduced integration (C3D20R), graded like tacgen's; the same neo-Hookean energy,
except for the volumetric part K/2 (J - 1)^2; the body as a moved surface; surface-to-surface contact with a stiff
linear penalty; steps as long as possible with the force within some tenths of a percent of that of short steps.
"""

import re
import resource
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from benchmarks.results_page import one_thread
from tacgen.base.errors import UserError
from tacgen.fem.elements import HEX_EDGES, boxes
from tacgen.fem.materials import NeoHooke
from tacgen.geometry.gel import GelBody
from tacgen.mechanics import mesh

Array = np.ndarray
PROGRAM = "ccx"
STIFF = 1000.0  # penalty stiffness in Young's moduli per mm; 300 is faster, with an error of 0.2 %
RINGS, SECTORS = 40, 24  # facets of the ball of `press`, and of a quarter of it
INCREMENTS = "0.25, 1., 1e-6, 0.5"  # first, total, smallest and largest step, as parts of a frame
TOP_NODES = [4, 5, 6, 7, 12, 13, 14, 15]  # of a hex of 20 nodes
SHELL_MM = 0.1  # thickness of the body's shell, which is rigid
Symmetry = Literal["", "x", "y", "xy"]  # planes across x, y


@dataclass(frozen=True)
class Pressed:
    """Force of the whole ball [N], nodes of the mesh, processor seconds of the whole program."""

    force: float
    nodes: int
    seconds: float


@dataclass(frozen=True)
class Followed:
    """The n frames of a path. On the gel: points (n, p, 3) [mm] of the body's surface and the forces there (n, p, 3)
    [N], and the reaction on the base, as force (n, 3) [N] and torque (n, 3) [N mm] about the origin, with the opposite
    sign; face (q, 3) and moved (n, q, 3): points of the gel's face and their displacements [mm]; nodes of the gel;
    processor seconds of the whole program."""

    points: Array
    forces: Array
    force: Array
    torque: Array
    face: Array
    moved: Array
    nodes: int
    seconds: float


@dataclass(frozen=True)
class Body:
    """A rigid surface: vertices (v, 3) [mm], triangles (t, 3) counter-clockwise from outside, their normals (v, 3)."""

    vertices: Array
    triangles: Array
    normals: Array


def installed() -> bool:
    """Whether the program is installed."""
    return shutil.which(PROGRAM) is not None


def version() -> str:
    """Name and version of the program."""
    said = subprocess.run([PROGRAM, "-v"], capture_output=True, text=True, check=False).stdout
    return "CalculiX " + (re.search(r"[\d.]+", said) or [""])[0]


def press(gel: GelBody, radius: float, depth: float, edge: float, *, quarter: bool = True) -> Pressed:
    """Press a ball without friction into a flat pad of one neo-Hookean layer, with element edge `edge` [mm] below it:
    the whole pad as tacgen solves it, or a quarter by symmetry."""
    reach = np.sqrt(2 * radius * depth) + edge / 2  # radius of the ball's section with the untouched face
    body = _ball(radius, min(1.1 * reach, 0.97 * radius), 1 if quarter else 4)
    pose = np.eye(4)
    pose[2, 3] = -depth
    low, half = 0.0 if quarter else -1.0, (gel.width / 2, gel.height / 2)
    xs, ys = (mesh.graded(low * h, h, (low * reach, reach), edge, 1.7, 4.0) for h in half)
    zs, _ = mesh.heights(gel, 1.1 * edge, 1.1, 2.0)
    found = follow(gel, (xs, ys, zs), body, [pose], symmetry="xy" if quarter else "")
    return Pressed(abs(float(found.force[-1, 2])), found.nodes, found.seconds)


def follow(
    gel: GelBody, axes: tuple[Array, Array, Array], body: Body, poses: Sequence[Array], symmetry: Symmetry = ""
) -> Followed:
    """A body that follows `poses` (4, 4), a frame each, from its own frame, on a flat pad of one neo-Hookean layer
    without friction; the pad's mesh has the coordinates `axes` along x, y and z [mm]. With a symmetry these are of the
    part with positive x or y, or both, and the body is whole or of a little more than that part.

    Raises:
        UserError: CalculiX has not finished.
    """
    points, cells, top = _pad(gel, axes)
    path = np.array([body.vertices @ pose[:3, :3].T + pose[:3, 3] for pose in poses])
    deck = _deck(gel, points, cells, top, body, path, symmetry)
    said, seconds = _run("\n".join(deck))
    forces, pulls, moved = (_printed(said, name, len(poses)) for name in ("BODY", "BASE", "FACE"))
    face = points[np.unique(cells[top][:, TOP_NODES])]
    held = points[points[:, 2] < -gel.thickness + 1e-9]
    places, pushes = _whole(path, forces, symmetry)
    base = _whole(np.tile(held, (len(poses), 1, 1)), pulls, symmetry)
    surface, moves = _whole(np.tile(face, (len(poses), 1, 1)), moved, symmetry)
    force, torque = -base[1].sum(1), -np.cross(*base).sum(1)
    return Followed(places, pushes, force, torque, surface[0], moves, len(points), seconds)


def _run(deck: str) -> tuple[str, float]:
    """Run an input file: what the program prints, and its processor seconds."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "path.inp").write_text(deck)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        environment = one_thread() | {"CCX_NPROC_EQUATION_SOLVER": "1", "CCX_NPROC_STIFFNESS": "1"}
        done = subprocess.run(
            [PROGRAM, "path"], cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        said = Path(folder, "path.dat").read_text() if Path(folder, "path.dat").exists() else ""
    if "Job finished" not in done.stdout:
        raise UserError(f"CalculiX did not finish: {' '.join(done.stdout.split()[-20:])}")
    return said, used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime


def _printed(said: str, name: str, frames: int) -> Array:
    """The vectors (frames, n, 3) that were printed for a set of nodes at the end of each frame."""
    blocks = re.findall(rf"for set {name} and time.*?\n\s*\n(.*?)(?:\n\s*\n|\Z)", said, re.DOTALL)
    if len(blocks) != frames:
        raise UserError(f"CalculiX printed {len(blocks)} of {frames} frames")
    return np.array([np.array(block.split(), float).reshape(-1, 4)[:, 1:] for block in blocks])


def _whole(points: Array, vectors: Array, symmetry: Symmetry) -> tuple[Array, Array]:
    """Points and vectors (n, p, 3) of the whole pad from those of its part."""
    eye, flip_x, flip_y = np.eye(3), np.diag([-1.0, 1, 1]), np.diag([1.0, -1, 1])
    copies = {"": [eye], "x": [eye, flip_x], "y": [eye, flip_y], "xy": [eye, flip_x, flip_y, flip_x @ flip_y]}[symmetry]
    return np.concatenate([points @ c.T for c in copies], 1), np.concatenate([vectors @ c.T for c in copies], 1)


def _deck(
    gel: GelBody, points: Array, cells: Array, top: Array, body: Body, path: Array, symmetry: Symmetry
) -> Iterator[str]:
    """The lines of the input file; path: places of the body's vertices (n, v, 3) in each frame."""
    law, E = gel.layers[0].law, gel.layers[0].youngs_modulus
    assert isinstance(law, NeoHooke)
    outer = len(points) + 1
    inner = outer + len(body.vertices)
    shell = np.concatenate([body.vertices, body.vertices - SHELL_MM * body.normals])
    yield from ("*NODE, NSET=ALL", *_numbered(np.concatenate([points, shell])))
    yield from ("*ELEMENT, TYPE=C3D20R, ELSET=GEL", *_elements(cells + 1, 1))
    faces = body.triangles[:, ::-1]  # S1 is seen from inside of an element
    wedges = np.concatenate([outer + faces, inner + faces], 1)
    yield from ("*ELEMENT, TYPE=C3D6, ELSET=TOOL", *_elements(wedges, 1 + len(cells)))
    held = {"BASE": (points[:, 2] < -gel.thickness + 1e-9, "1, 3")}
    if symmetry in ("x", "xy"):
        held["NX"] = (np.abs(points[:, 0]) < 1e-9, "1, 1")
    if symmetry in ("y", "xy"):
        held["NY"] = (np.abs(points[:, 1]) < 1e-9, "2, 2")
    face = np.unique(cells[top][:, TOP_NODES])
    sets = {name: np.flatnonzero(there) for name, (there, _) in held.items()} | {"FACE": face}
    for name, nodes in sets.items():
        yield from (f"*NSET, NSET={name}", *(str(n + 1) for n in nodes))
    yield f"*NSET, NSET=BODY, GENERATE\n{outer}, {inner - 1}"
    yield from ("*SURFACE, NAME=FACE, TYPE=ELEMENT", *(f"{e + 1}, S2" for e in top))
    yield from ("*SURFACE, NAME=TOOL, TYPE=ELEMENT", "TOOL, S1")
    yield from ("*MATERIAL, NAME=GEL", "*HYPERELASTIC, NEO HOOKE", f"{law.mu / 2:.9g}, {2 / law.kappa:.9g}")
    yield from ("*MATERIAL, NAME=TOOL", "*ELASTIC", f"{1000 * E:.9g}, 0.3")
    yield from ("*SOLID SECTION, ELSET=GEL, MATERIAL=GEL", "*SOLID SECTION, ELSET=TOOL, MATERIAL=TOOL")
    yield from (
        "*SURFACE INTERACTION, NAME=TOUCH",
        "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR",
        f"{STIFF * E:.9g}",
    )
    yield from ("*CONTACT PAIR, INTERACTION=TOUCH, TYPE=SURFACE TO SURFACE", "FACE, TOOL")
    yield from ("*BOUNDARY", *(f"{name}, {dofs}" for name, (_, dofs) in held.items()))
    turned = np.concatenate([path, path - SHELL_MM * _normals(body, path)], 1)
    for moved in turned - shell:
        yield from ("*STEP, NLGEOM, INC=1000", "*STATIC", INCREMENTS, "*BOUNDARY")
        yield from (f"{outer + n}, {k + 1}, {k + 1}, {v:.9g}" for n, row in enumerate(moved) for k, v in enumerate(row))
        for name, what in (("BODY", "RF"), ("BASE", "RF"), ("FACE", "U")):
            yield f"*NODE PRINT, NSET={name}, FREQUENCY=100000\n{what}"
        yield "*END STEP"
    yield ""


def _normals(body: Body, path: Array) -> Array:
    """The body's normals (n, v, 3) along a path of its vertices, which is rigid."""
    middle = body.vertices.mean(0)
    rotations = [np.linalg.lstsq(body.vertices - middle, at - at.mean(0), rcond=None)[0] for at in path]
    return np.array([body.normals @ turn for turn in rotations])


def _pad(gel: GelBody, axes: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
    """Points, cells of 20 nodes and indices of the top cells."""
    xs, ys, zs = axes
    number = np.arange(len(xs) * len(ys) * len(zs)).reshape(len(xs), len(ys), len(zs))
    points = np.stack(np.meshgrid(xs, ys, zs, indexing="ij"), -1).reshape(-1, 3)
    hexes, layers = boxes(number), len(zs) - 1
    x, y = (xs[1:] + xs[:-1])[:, None] / 2, (ys[1:] + ys[:-1])[None] / 2
    hexes = hexes[gel.contains(x, y)]
    top = np.arange(len(hexes)) * layers + layers - 1
    cells = hexes.reshape(-1, 8)
    ends = np.sort(cells[:, HEX_EDGES], -1)
    edges, middle = np.unique(ends.reshape(-1, 2), axis=0, return_inverse=True)
    cells = np.concatenate([cells, len(points) + middle.reshape(len(cells), 12)], 1)
    points = np.concatenate([points, points[edges].mean(1)])
    used, compact = np.unique(cells, return_inverse=True)
    return points[used], compact.reshape(-1, 20), top


def _ball(radius: float, reach: float, quarters: int) -> Body:
    """Quarters of the ball's lower surface as far as `reach` from its axis."""
    polar = np.linspace(0, np.arcsin(reach / radius), RINGS + 1)[1:]
    sectors = quarters * SECTORS
    turn = np.linspace(0, quarters * np.pi / 2, sectors + 1)
    ring = np.stack([np.cos(turn), np.sin(turn)], -1)
    direction = np.concatenate(
        [[[0.0, 0.0, -1.0]], *(np.column_stack([np.sin(a) * ring, np.full(len(ring), -np.cos(a))]) for a in polar)]
    )
    number = 1 + np.arange(RINGS * (sectors + 1)).reshape(RINGS, sectors + 1)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    pole = np.stack([number[0, 1:], number[0, :-1], np.zeros(sectors, int)], -1)
    triangles = np.concatenate([pole, np.stack([c, b, a], -1), np.stack([d, c, a], -1)])
    return Body(radius * (direction + np.array([0.0, 0.0, 1.0])), triangles, direction)


def _numbered(points: Array) -> Iterator[str]:
    for n, (x, y, z) in enumerate(points):
        yield f"{n + 1}, {x:.9g}, {y:.9g}, {z:.9g}"


def _elements(cells: Array, first: int) -> Iterator[str]:
    for n, nodes in enumerate(cells):
        words = [str(first + n), *map(str, nodes)]
        yield ", ".join(words[:11]) + (",\n" + ", ".join(words[11:]) if len(words) > 11 else "")
