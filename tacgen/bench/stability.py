"""Scenes at the end of what can be asked for, and how each ends: no element inside out, no indenter through the gel."""

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tacgen import assets, mesh, plan, scene, solve
from tacgen.errors import UserError
from tacgen.fem.contact import Pose
from tacgen.fem.elements import HEX_CORNERS

Array = np.ndarray
Sets = tuple[str, ...]

PLAIN = (
    "outputs=[force]",
    "indenter={shape: sphere, radius_mm: 4}",
    "trajectory=[{press: {depth_mm: 1.0, frames: 2}}, {slide: {x_mm: 0.4, frames: 1}}]",
    "contact.friction=0.6",
    "quality={edge_mm: 0.8, dhat_mm: 0.05}",
)
SKINNED = ("sensor=ninedtact", "trajectory=[{press: {depth_mm: 0.6, frames: 2}}, {slide: {x_mm: 0.4, frames: 1}}]")
MEDIUM = "quality={edge_mm: 0.4, dhat_mm: 0.03}"
FINE = "quality={edge_mm: 0.2, dhat_mm: 0.02}"
DEEP_SLIDE = "trajectory=[{press: {depth_mm: 3.0, frames: 3}}, {slide: {x_mm: 2, frames: 2}}]"
SHALLOW = "trajectory=[{press: {depth_mm: 0.3, frames: 2}}, {slide: {x_mm: 0.2, frames: 1}}]"
JUMP = "trajectory=[{press: {depth_mm: 1.0, frames: 1}}, {slide: {x_mm: 6, frames: 1}}]"
DROP = "trajectory=[{press: {depth_mm: 1.2, frames: 1}}, {slide: {x_mm: 3, frames: 1}}]"


def _youngs(*moduli: float) -> Sets:
    return tuple(f"sensor.gel.layers[{i}].youngs_modulus_mpa={E}" for i, E in enumerate(moduli))


def _indenter(text: str) -> str:
    return f"indenter={{{text}}}"


CASES: dict[str, Sets] = {
    "1 kPa": _youngs(0.001),
    "100 MPa": _youngs(100),
    "nu 0": ("sensor.gel.layers[0].poissons_ratio=0",),
    "nu 0.4999": ("sensor.gel.layers[0].poissons_ratio=0.4999",),
    "half deep": ("trajectory=[{press: {depth_mm: 2.0, frames: 2}}]",),
    "three quarters deep at once": ("trajectory=[{press: {depth_mm: 3.0, frames: 1}}]",),
    "three quarters deep, nu 0.4999": (
        "trajectory=[{press: {depth_mm: 3.0, frames: 3}}]",
        "sensor.gel.layers[0].poissons_ratio=0.4999",
    ),
    "three quarters deep, then slid": (
        "trajectory=[{press: {depth_mm: 3.0, frames: 3}}, {slide: {x_mm: 2, frames: 2}}]",
    ),
    "punch three quarters deep": (
        _indenter("shape: cylinder, radius_mm: 3, fillet_mm: 0.3"),
        "trajectory=[{press: {depth_mm: 3.0, frames: 1}}]",
    ),
    "friction 0": ("contact.friction=0",),
    "friction 2": ("contact.friction=2",),
    "cone 30 deg, tip 0.1 mm": (_indenter("shape: cone, half_angle_deg: 30, tip_radius_mm: 0.1"),),
    "ball of 0.3 mm": (_indenter("shape: sphere, radius_mm: 0.3"), FINE, SHALLOW),
    "ball of 0.1 mm": (
        _indenter("shape: sphere, radius_mm: 0.1"),
        "quality={edge_mm: 0.1, dhat_mm: 0.01}",
        "trajectory=[{press: {depth_mm: 0.1, frames: 1}}]",
    ),
    "skin stiffer 1000:1": (*SKINNED, *_youngs(0.01, 10)),
    "skin softer 1000:1": (*SKINNED, *_youngs(10, 0.01)),
    "skin of 0.1 mm": (*SKINNED, "sensor.gel.layers[1].thickness_mm=0.1"),
    "skin of 0.1 mm, stiffer 1000:1": (*SKINNED, *_youngs(0.01, 10), "sensor.gel.layers[1].thickness_mm=0.1"),
    "jump across the pad": (JUMP,),
    "punch jumps across the pad": (_indenter("shape: cylinder, radius_mm: 2, fillet_mm: 0.3"), JUMP),
    "sharp wedge": (_indenter("shape: wedge, half_angle_deg: 30, tip_radius_mm: 0.1, length_mm: 8"),),
    "thin torus": (_indenter("shape: torus, radius_mm: 2.5, tube_radius_mm: 0.4"), MEDIUM, DROP),
    "thin rod": (_indenter("shape: capsule, radius_mm: 0.4, length_mm: 4"), MEDIUM, DROP),
    "needle": (_indenter("shape: capsule, radius_mm: 0.16, length_mm: 3"), FINE, SHALLOW),
    "needle on a coarse mesh": (_indenter("shape: capsule, radius_mm: 0.1, length_mm: 6"), DROP),
    "knife jumps": (
        _indenter("shape: wedge, half_angle_deg: 10, tip_radius_mm: 0.2, length_mm: 8"),
        "trajectory=[{press: {depth_mm: 1.5, frames: 1}}, {slide: {x_mm: 5, frames: 1}}]",
    ),
    "box twisted by 45 deg a frame": (
        _indenter("shape: box, size_x_mm: 5, size_y_mm: 3, fillet_mm: 0.4"),
        "trajectory=[{press: {depth_mm: 0.8, frames: 2}}, {twist: {angle_deg: 90, frames: 2}}]",
    ),
    "sphere spun by 180 deg": ("trajectory=[{press: {depth_mm: 1, frames: 1}}, {twist: {angle_deg: 180, frames: 1}}]",),
    "letters twisted": (
        _indenter("shape: mesh, file: letters"),
        "trajectory=[{press: {depth_mm: 0.5, frames: 1}}, {twist: {angle_deg: 10, frames: 2}}]",
    ),
    "ball of slivers": (_indenter("shape: mesh, file: {folder}/slivers.obj"),),
    "blade": (_indenter("shape: mesh, file: {folder}/blade.obj"), DROP),
}


RANDOM = 8  # numbers that a random scene is made of


def random(u: Sequence[float]) -> Sets:
    """A scene from RANDOM numbers in [0, 1]; at 0 it is mild: a ball, shallow, smooth, not slid nor turned."""
    size = 1.4 + 2.6 * u[1]
    shapes = (
        f"shape: sphere, radius_mm: {size}",
        f"shape: capsule, radius_mm: {size / 2}, length_mm: {size}",
        f"shape: torus, radius_mm: {size}, tube_radius_mm: {size / 2}",
        f"shape: cylinder, radius_mm: {size}, fillet_mm: {size / 4}",
        f"shape: box, size_x_mm: {2 * size}, size_y_mm: {size}, fillet_mm: {size / 4}",
        f"shape: cone, half_angle_deg: {20 + 10 * size}, tip_radius_mm: {size / 8}",
        f"shape: wedge, half_angle_deg: {20 + 10 * size}, tip_radius_mm: {size / 8}, length_mm: {2 * size}",
    )
    moves = (
        f"{{press: {{depth_mm: {0.2 + 1.3 * u[2]}, frames: 2}}}}",
        f"{{slide: {{x_mm: {2 * u[4]}, y_mm: {u[4] * u[5]}, frames: 2}}}}",
        f"{{twist: {{angle_deg: {30 * u[5]}, frames: 1}}}}",
        "{release: {frames: 1}}",
    )
    return (
        _indenter(shapes[min(int(u[0] * len(shapes)), len(shapes) - 1)]),
        f"trajectory=[{', '.join(moves)}]",
        f"contact.friction={2 * u[3]}",
        *_youngs(0.001 * 1e5 ** u[6]),
        f"sensor.gel.layers[0].poissons_ratio={0.4999 * (1 - u[7])}",
    )


@dataclass(frozen=True)
class Outcome:
    """How a scene ended: `status` is ok, refused (before it was solved) or rejected (on the way), `reason` says why.

    Over its frames: most iterations and substeps of one frame; smallest J and gap [mm]; largest force balance and
    residual; overlap [mm] by which matter of the gel is inside the indenter, between the points where contact acts.
    """

    name: str
    status: str
    reason: str = ""
    frames: int = 0
    nodes: int = 0
    force: float = 0.0  # largest [N]
    iterations: int = 0
    substeps: int = 0
    least_J: float = np.inf
    min_gap: float = np.inf
    balance: float = 0.0
    residual: float = 0.0
    overlap: float = 0.0
    seconds: float = 0.0

    def line(self) -> str:
        """A row of the table."""
        return (
            f"{self.name:<34} {self.status:<8} {self.frames:>2} {self.nodes:>6} {self.force:9.4f} {self.iterations:>4}"
            f" {self.substeps:>3} {self.least_J:7.3f} {self.min_gap:8.4f} {self.overlap:7.4f} {self.balance:8.1e}"
            f" {self.residual:8.1e} {self.seconds:7.1f}  {self.reason}"
        )


HEADER = (
    f"{'case':<34} {'status':<8} {'fr':>2} {'nodes':>6} {'force N':>9} {'it':>4} {'sub':>3} {'least J':>7}"
    f" {'gap mm':>8} {'overlap':>7} {'balance':>8} {'residual':>8} {'CPU s':>7}"
)


def measure(name: str, sets: Sequence[str]) -> Outcome:
    """Solve the plain scene with these changes and look at every frame."""
    begun = time.process_time()
    try:
        with tempfile.TemporaryDirectory() as folder:
            for file, (vertices, triangles) in {"slivers.obj": slivers(4.0), "blade.obj": blade(8.0, 0.4, 4.0)}.items():
                (Path(folder) / file).write_text(wavefront(vertices, triangles))
            filled = [text.replace("{folder}", folder) for text in (*PLAIN, *sets)]
            made = scene.build(plan.load(assets.recipe_path("quickstart"), filled).rows[0])
        problem = solve.Problem.of(made, mesh.of(made))
    except UserError as error:
        return Outcome(name, "refused", error.lines[0], seconds=time.process_time() - begun)
    states: list[solve.State] = []
    status, reason = "ok", ""
    try:
        states.extend(solve.states(made, problem))
    except solve.NotConverged as error:
        status, reason = "rejected", str(error)
    if not states:
        return Outcome(name, status, reason, nodes=len(problem.mesh.points), seconds=time.process_time() - begun)
    return Outcome(
        name,
        status,
        reason,
        len(states),
        len(problem.mesh.points),
        max(float(np.linalg.norm(s.traction_force.sum((0, 1)))) for s in states),
        max(s.iterations for s in states),
        max(s.substeps for s in states),
        min(float(part.at(s.x).J.min()) for s in states for part in problem.elastic),
        min(s.min_gap for s in states),
        max(s.balance for s in states),
        max(s.residual for s in states),
        max(overlap(problem, s) for s in states),
        time.process_time() - begun,
    )


def overlap(problem: solve.Problem, state: solve.State, fine: int = 5) -> float:
    """How deep matter of the gel is inside the shrunk indenter [mm], sampled fine^3 times in each hex around it.

    Contact acts at points of the face; what is thinner than they are apart could pass between them unseen.
    """
    x = state.x[problem.mesh.cells]
    size = np.linalg.norm(np.ptp(x, axis=1), axis=1)
    pose, shape = Pose.of(state.pose), problem.contact.shape
    x = x[shape.distance(pose.local(x.mean(1)))[0] < size]
    if not len(x):
        return 0.0
    t = np.linspace(-1, 1, fine)
    at = np.stack(np.meshgrid(t, t, t), -1).reshape(-1, 1, 3)
    N = (1 + at * HEX_CORNERS).prod(2) / 8
    inside = shape.distance(pose.local((N @ x).reshape(-1, 3)))[0] + state.offset
    return float(max(-inside.min(), 0.0))


def slivers(radius: float, around: int = 2000, up: int = 24) -> tuple[Array, Array]:
    """A ball of triangles forty times longer than wide: vertices (n, 3), triangles (m, 3)."""
    polar = np.linspace(0, np.pi, up + 1)[1:-1]
    turn = np.arange(around) * (2 * np.pi / around)
    ring = np.stack([np.cos(turn), np.sin(turn)], 1)
    body = np.concatenate([np.column_stack([np.sin(a) * ring, np.full(around, np.cos(a))]) for a in polar])
    i = np.arange(around)
    j = (i + 1) % around
    low = [np.column_stack([k * around + i, (k + 1) * around + i, k * around + j]) for k in range(up - 2)]
    high = [np.column_stack([(k + 1) * around + i, (k + 1) * around + j, k * around + j]) for k in range(up - 2)]
    top, bottom = len(body), len(body) + 1
    last = (up - 2) * around
    caps = [
        np.column_stack([np.full(around, top), i, j]),
        np.column_stack([np.full(around, bottom), last + j, last + i]),
    ]
    return radius * np.concatenate([body, [[0, 0, 1], [0, 0, -1]]]), np.concatenate([*low, *high, *caps])


def blade(length: float, thickness: float, height: float) -> tuple[Array, Array]:
    """A plate on its edge, along y: vertices (8, 3), triangles (12, 3)."""
    corner = (HEX_CORNERS + 1) / 2 * [thickness, length, height]
    quads = np.array([[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])
    return corner, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def wavefront(vertices: Array, triangles: Array) -> str:
    """An OBJ file."""
    points = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    faces = [f"f {a} {b} {c}" for a, b, c in triangles + 1]
    return "\n".join([*points, *faces, ""])
