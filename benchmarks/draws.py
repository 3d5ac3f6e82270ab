"""Ordinary scenes by number, drawn at random as in a data set: these ranges define "ordinary"."""

import math
from dataclasses import dataclass

import numpy as np

SEED = 41
# of the gel [mm], for press depths; DIGIT: at the rim (4.06 mm at the crown)
THICKNESS = {"gelsight_mini": 4.0, "digit": 2.5, "ninedtact": 2.8}
OBJECTS = ("gear", "hex_bolt", "key", "letters", "ring")
KINDS = ("sphere", "sphere", "cylinder", "box", "cone", "wedge", "capsule", "torus", "mesh", "mesh")  # equal chances
STEEPEST = {"cone": 65.0, "wedge": 60.0}  # largest half angle [deg]


@dataclass(frozen=True)
class Draw:
    """One scene: `shape` names the indenter's shape or the object, `sets` are the other changes to the quickstart."""

    index: int | None  # None: not drawn
    sensor: str
    shape: str
    sets: tuple[str, ...]


PATH = "trajectory=[{press: {depth_mm: 1.0, frames: 3}}, {slide: {x_mm: 1.5, frames: 5}}]"
BALL = Draw(None, "gelsight_mini", "sphere", ("indenter={shape: sphere, radius_mm: 4}", PATH, "contact.friction=0.6"))


def drawn(index: int) -> Draw:
    """Ordinary scene number `index`, the same at every level."""
    r = np.random.default_rng((SEED, index))
    sensor = str(r.choice(list(THICKNESS)))
    shape, indenter = _indenter(r)
    depth = r.uniform(0.1, 0.35) * THICKNESS[sensor]
    moves = [f"{{press: {{depth_mm: {depth:.3f}, frames: {r.integers(3, 6)}}}}}"]
    moves += [_move(r) for _ in range(r.integers(0, 3))]
    moves += ["{release: {frames: 2}}"] if r.random() < 0.3 else []
    path, friction = f"trajectory=[{', '.join(moves)}]", f"contact.friction={r.uniform(0.2, 1.0):.3f}"
    start = f"start={{x_mm: {r.uniform(-3, 3):.2f}, y_mm: {r.uniform(-3, 3):.2f}}}"
    return Draw(index, sensor, shape, (f"indenter={{{indenter}}}", path, friction, start))


def _indenter(r: np.random.Generator) -> tuple[str, str]:
    """The name of a shape or object, and the indenter in a recipe."""
    kind, size, tip, length = str(r.choice(KINDS)), r.uniform(2, 5), r.uniform(0.8, 1.5), r.uniform(5, 10)
    if kind == "mesh":
        name = str(r.choice(OBJECTS))
        return name, f"shape: mesh, file: {name}"
    fillet = size * r.uniform(0.15, 0.5)
    fields = {
        "sphere": {"radius": size},
        "cylinder": {"radius": size, "fillet": fillet},
        "box": {"size_x": 1.6 * size, "size_y": 1.6 * size * r.uniform(0.5, 1), "fillet": min(fillet, 0.3 * size)},
        "cone": {"tip_radius": tip},
        "wedge": {"tip_radius": tip, "length": length},
        "capsule": {"radius": r.uniform(1.2, 2.5), "length": length},
        "torus": {"radius": r.uniform(2.5, 4.5), "tube_radius": r.uniform(1.0, 1.6)},
    }
    angle = f", half_angle_deg: {r.uniform(35, STEEPEST[kind]):.1f}" if kind in STEEPEST else ""
    return kind, f"shape: {kind}{angle}" + "".join(f", {name}_mm: {value:.3f}" for name, value in fields[kind].items())


def _move(r: np.random.Generator) -> str:
    """A slide, or half as often a twist or a tilt, as a segment of the trajectory."""
    distance, heading, turn, lean = r.uniform(0.3, 3), r.uniform(0, 2 * math.pi), r.uniform(3, 30), r.uniform(1, 5)
    x, y = distance * math.cos(heading), distance * math.sin(heading)
    slide = f"{{slide: {{x_mm: {x:.3f}, y_mm: {y:.3f}, frames: {math.ceil(distance / 0.35)}}}}}"
    twist = f"{{twist: {{angle_deg: {turn:.1f}, frames: {math.ceil(turn / 5)}}}}}"
    axis = f"axis_deg: {r.uniform(0, 360):.0f}"
    tilt = f"{{tilt: {{angle_deg: {lean:.1f}, {axis}, frames: {math.ceil(lean / 1.5)}}}}}"
    return str(r.choice([slide, slide, twist, tilt]))
