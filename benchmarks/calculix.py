"""The press of a ball solved by CalculiX, an established finite element program, if its `ccx` is installed.

The usual set-up: quadratic hexes with reduced integration (C3D20R), graded like tacgen's; the same neo-Hookean energy,
except for the volumetric part K/2 (J - 1)^2; the ball as a moved surface; surface-to-surface contact with a stiff
linear penalty; steps as long as possible with the force within some tenths of a percent of that of short steps.
"""

import re
import resource
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

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
RINGS, SECTORS = 40, 24  # elements on a quarter of the ball's surface
INCREMENTS = "0.25, 1., 1e-6, 0.5"  # first, total, smallest and largest step, as parts of the press


@dataclass(frozen=True)
class Pressed:
    """Force of the whole ball [N], nodes of the mesh, processor seconds of the whole program."""

    force: float
    nodes: int
    seconds: float


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
    deck, nodes = _deck(gel, radius, depth, edge, quarter)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "press.inp").write_text(deck)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        environment = one_thread() | {"CCX_NPROC_EQUATION_SOLVER": "1", "CCX_NPROC_STIFFNESS": "1"}
        done = subprocess.run(
            [PROGRAM, "press"], cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        said = Path(folder, "press.dat").read_text() if Path(folder, "press.dat").exists() else ""
    forces = re.findall(r"total force.*?\n\s*\n?\s*(\S+)\s+(\S+)\s+(\S+)", said)
    if not forces or "Job finished" not in done.stdout:
        raise UserError(f"CalculiX did not finish: {' '.join(done.stdout.split()[-20:])}")
    seconds = used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime
    return Pressed((4 if quarter else 1) * abs(float(forces[-1][2])), nodes, seconds)


def _deck(gel: GelBody, radius: float, depth: float, edge: float, quarter: bool) -> tuple[str, int]:
    """The input file, and the number of nodes of the gel."""
    law = gel.layers[0].law
    assert isinstance(law, NeoHooke)
    reach = np.sqrt(2 * radius * depth) + edge / 2  # radius of the ball's section with the untouched face
    low = 0.0 if quarter else -1.0
    points, cells, top = _pad(gel, low, reach, edge)
    ball, bricks, wedges = _ball(radius, min(1.1 * reach, 0.97 * radius), 1 if quarter else 4, len(points))
    moved = len(points) + 1, len(points) + len(ball)
    held = {"BASE": (points[:, 2] < -gel.thickness + 1e-9, "1, 3")}
    if quarter:
        held |= {"NX": (points[:, 0] < 1e-9, "1, 1"), "NY": (points[:, 1] < 1e-9, "2, 2")}
    E = gel.layers[0].youngs_modulus
    first = 1 + len(cells)
    lines = ["*NODE, NSET=ALL", *_numbered(np.concatenate([points, ball]))]
    lines += ["*ELEMENT, TYPE=C3D20R, ELSET=GEL", *_elements(cells + 1, 1)]
    lines += ["*ELEMENT, TYPE=C3D8, ELSET=BALL", *_elements(bricks + 1, first)]
    lines += ["*ELEMENT, TYPE=C3D6, ELSET=BALL", *_elements(wedges + 1, first + len(bricks))]
    for name, (there, _) in held.items():
        lines += [f"*NSET, NSET={name}", *(str(n + 1) for n in np.flatnonzero(there))]
    lines += [f"*NSET, NSET=MOVED, GENERATE\n{moved[0]}, {moved[1]}"]
    lines += ["*SURFACE, NAME=FACE, TYPE=ELEMENT", *(f"{e + 1}, S2" for e in top)]
    lines += ["*SURFACE, NAME=TOOL, TYPE=ELEMENT", "BALL, S1"]
    lines += ["*MATERIAL, NAME=GEL", "*HYPERELASTIC, NEO HOOKE", f"{law.mu / 2:.9g}, {2 / law.kappa:.9g}"]
    lines += ["*MATERIAL, NAME=BALL", "*ELASTIC", f"{1000 * E:.9g}, 0.3"]
    lines += ["*SOLID SECTION, ELSET=GEL, MATERIAL=GEL", "*SOLID SECTION, ELSET=BALL, MATERIAL=BALL"]
    lines += ["*SURFACE INTERACTION, NAME=TOUCH", "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR"]
    lines += [f"{STIFF * E:.9g}", "*CONTACT PAIR, INTERACTION=TOUCH, TYPE=SURFACE TO SURFACE", "FACE, TOOL"]
    lines += ["*BOUNDARY", "MOVED, 1, 2", *(f"{name}, {dofs}" for name, (_, dofs) in held.items())]
    lines += ["*STEP, NLGEOM, INC=1000", "*STATIC", INCREMENTS]
    lines += ["*BOUNDARY", f"MOVED, 3, 3, {-depth:.9g}"]
    lines += ["*NODE PRINT, NSET=BASE, TOTALS=ONLY", "RF", "*END STEP", ""]
    return "\n".join(lines), len(points)


def _pad(gel: GelBody, low: float, reach: float, edge: float) -> tuple[Array, Array, Array]:
    """Points, cells of 20 nodes and indices of the top cells; x and y start at `low` times the pad's half size."""
    size, fine = (gel.width / 2, gel.height / 2), (low * reach, reach)
    xs, ys = (mesh.graded(low * half, half, fine, edge, 1.7, 4.0) for half in size)
    zs, _ = mesh.heights(gel, 1.1 * edge, 1.1, 2.0)
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


def _ball(radius: float, reach: float, quarters: int, first: int) -> tuple[Array, Array, Array]:
    """Quarters of the ball's lower surface as a shell of bricks and, at the pole, wedges, with faces S1 towards the
    gel: points, and nodes numbered from `first`."""
    polar = np.linspace(0, np.arcsin(reach / radius), RINGS + 1)[1:]
    sectors = quarters * SECTORS
    turn = np.linspace(0, quarters * np.pi / 2, sectors + 1)
    ring = np.stack([np.cos(turn), np.sin(turn)], -1)
    direction = np.concatenate(
        [[[0.0, 0.0, -1.0]], *(np.column_stack([np.sin(a) * ring, np.full(len(ring), -np.cos(a))]) for a in polar)]
    )
    shell = np.concatenate([radius * direction, 0.8 * radius * direction])
    shell[:, 2] += radius
    above = len(direction)
    number = 1 + np.arange(RINGS * (sectors + 1)).reshape(RINGS, sectors + 1)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    quads = np.stack([a, b, c, d], -1)
    pole = np.stack([np.zeros(sectors, int), number[0, :-1], number[0, 1:]], -1)
    bricks, wedges = np.concatenate([quads, quads + above], 1), np.concatenate([pole, pole + above], 1)
    return shell, first + bricks, first + wedges


def _numbered(points: Array) -> Iterator[str]:
    for n, (x, y, z) in enumerate(points):
        yield f"{n + 1}, {x:.9g}, {y:.9g}, {z:.9g}"


def _elements(cells: Array, first: int) -> Iterator[str]:
    for n, nodes in enumerate(cells):
        words = [str(first + n), *map(str, nodes)]
        yield ", ".join(words[:11]) + (",\n" + ", ".join(words[11:]) if len(words) > 11 else "")
