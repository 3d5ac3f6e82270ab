"""Bundles that look like a ball pressed, slid and twisted on a gel, made in milliseconds from closed formulas."""

from collections.abc import Callable
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.bundle.bundle import Writer
from tacgen.sensor.yaml_source import parse_path, put

FRICTION = 0.6
MM_PER_PX = 0.0634  # at 320 x 240
TRAJECTORY = [
    {"press": {"depth_mm": 1.0, "frames": 4}},
    {"slide": {"x_mm": 1.0, "y_mm": 0.0, "frames": 3}},
    {"hold": {"frames": 2}},
    {"twist": {"angle_deg": 10.0, "frames": 3}},
]
OUTPUTS = frozenset({"force", "stress", "traction", "height", "rgb", "markers"})


def attributes(**changes: Any) -> dict[str, Any]:
    recipe: Any = {
        "tacgen": 1, "name": "synthetic", "sensor": "gelsight_mini", "indenter": {"shape": "sphere", "radius_mm": 4.0},
        "trajectory": TRAJECTORY, "contact": {"friction": FRICTION},
    }  # fmt: skip
    for name, value in changes.get("values", {}).items() if "recipe" not in changes else ():
        if not name.startswith("sensor."):
            recipe = put(recipe, parse_path(name), value)
    keys = {"sensor_sha256": "0" * 64, "input_key": "k" * 64}
    return {"recipe": recipe, "scene_index": 0, "seed": 7, "sensor": "gelsight_mini", "solver": "none"} | keys | changes


def states() -> list[tuple[int, float, float, float]]:
    """(segment, depth [mm], x [mm], angle [rad]) of each frame."""
    rows, depth, x, angle = [], 0.0, 0.0, 0.0
    for index, segment in enumerate(TRAJECTORY):
        (move,) = segment.values()
        for _ in range(move["frames"]):
            depth += move.get("depth_mm", 0.0) / move["frames"]
            x += move.get("x_mm", 0.0) / move["frames"]
            angle += np.deg2rad(move.get("angle_deg", 0.0)) / move["frames"]
            rows.append((index, depth, x, angle))
    return rows


def frame(state: tuple[int, float, float, float], shape: tuple[int, int], outputs: frozenset[str]) -> dict[str, Any]:
    """One frame of a Hertz-like contact: image of `shape` (H, W), maps of a quarter of it."""
    return deepcopy(_frame(state, shape, outputs))


@cache
def _frame(state: tuple[int, float, float, float], shape: tuple[int, int], outputs: frozenset[str]) -> dict[str, Any]:
    segment, depth, x, angle = state
    out: dict[str, Any] = {"/frames/segment": segment, "/frames/pose": pose(depth, x, angle)}
    normal = 1.2 * depth**1.5
    drag = FRICTION * 0.9 * min(1.0, x / 0.5)
    out["/frames/force"] = np.array([drag * normal, 0.0, -normal])
    out["/frames/torque"] = np.array([0.0, 0.0, 0.3 * angle * normal])
    out["/frames/quality/force_balance"] = 1e-9
    out["/frames/quality/newton_iterations"], out["/frames/quality/damped_steps"] = 4, 0
    grid, flat = positions((shape[0] // 4, shape[1] // 4), x)
    radius = np.sqrt(4.0 * depth)
    pressure = 0.09 * np.sqrt(depth) * np.sqrt(np.clip(1 - (flat / radius) ** 2, 0, None))
    height = -np.where(flat < radius, depth - flat**2 / 8, depth * 0.5 * np.exp(-(flat - radius)))
    if "traction" in outputs:
        spin = 2 * angle * np.stack([-grid[..., 1], grid[..., 0]], axis=-1)
        pull = np.array([drag, 0.0]) + FRICTION * 0.9 * np.tanh(spin) * (angle > 0)
        pull *= np.minimum(1, 0.99 * FRICTION / np.maximum(np.linalg.norm(pull, axis=-1), 1e-9))[..., None]
        out["/frames/traction"] = pressure[..., None] * pull
        out["/frames/pressure"] = pressure
        out["/frames/contact"] = pressure > 0
        out["/frames/slip"] = (pressure > 0) & (pressure < 0.03)
    if "height" in outputs:
        out["/frames/height"] = height
    flow = marker_flow(shape, x, depth, drag, angle)
    if "markers" in outputs:
        out["/frames/marker_flow"] = flow
        out["/frames/markers"] = marker_grid(shape) + flow
    if "rgb" in outputs:
        out["/frames/rgb"] = image(shape, x, depth, flow)
    if "stress" in outputs:
        wave = np.sin(np.arange(24.0).reshape(8, 3) + depth + x + angle)
        out["/fields/displacement"] = 0.1 * wave
        out["/fields/cauchy_stress"] = np.full((1, 6), -0.01 * depth)
        out["/fields/nodal_stress"] = np.full((8, 6), -0.01 * depth)
    return out


def pose(depth: float, x: float, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0, x], [s, c, 0, 0], [0, 0, 1, 4 - depth], [0, 0, 0, 1]])


def positions(shape: tuple[int, int], x: float) -> tuple[np.ndarray, np.ndarray]:
    """Where the samples lie from the ball's axis: (h, w, 2) and distance (h, w) [mm]."""
    rows, columns = shape
    mm = 320 * MM_PER_PX / columns
    offset = np.stack(np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5), axis=-1) - [columns / 2, rows / 2]
    grid = offset * mm - [x, 0.0]
    return grid, np.linalg.norm(grid, axis=-1)


def marker_grid(shape: tuple[int, int]) -> np.ndarray:
    pitch = 2.0625 / MM_PER_PX * shape[1] / 320
    across, down = np.meshgrid(np.arange(9) - 4, np.arange(7) - 3)
    return np.stack([across.ravel(), down.ravel()], axis=-1) * pitch + np.array(shape)[::-1] / 2


def marker_flow(shape: tuple[int, int], x: float, depth: float, drag: float, angle: float) -> np.ndarray:
    scale = shape[1] / 320
    offset = (marker_grid(shape) - np.array(shape)[::-1] / 2) / scale * MM_PER_PX - [x, 0.0]
    decay = np.exp(-((np.linalg.norm(offset, axis=-1, keepdims=True) / 3) ** 2))
    spread = 0.6 * depth * offset + 6 * drag * np.array([1.0, 0.0])
    turn = 8 * angle * np.stack([-offset[:, 1], offset[:, 0]], axis=-1)
    return scale * decay * (spread + turn)


def image(shape: tuple[int, int], x: float, depth: float, flow: np.ndarray | float) -> np.ndarray:
    grid, flat = positions(shape, x)
    inside = np.exp(-((flat / np.sqrt(4 * depth + 1e-9)) ** 4))[..., None] if depth else 0.0
    slope = grid / 4.0
    colour = np.array([80.0, 108.0, 112.0]) + grid[..., :1] * [0.0, 2.0, 0.5] + grid[..., 1:] * [-2.0, 0.0, 2.0]
    dent = slope[..., 1:] * [-100.0, 0.0, 70.0] + slope[..., :1] * [0.0, 75.0, 0.0]
    dots = np.ones(shape)
    rows, columns = np.mgrid[: shape[0], : shape[1]] + 0.5
    for px, py in marker_grid(shape) + flow:
        dots[np.hypot(columns - px, rows - py) < 7 * shape[1] / 320] = 0.25
    noise = np.random.default_rng(0).normal(0, 1, (*shape, 3))
    return np.clip((colour + inside * dent) * dots[..., None] + noise, 0, 255).astype(np.uint8)


@cache
def _untouched(shape: tuple[int, int]) -> np.ndarray:
    return image(shape, 0.0, 0.0, 0.0)


def write(
    path: Path,
    *,
    outputs: frozenset[str] = OUTPUTS,
    shape: tuple[int, int] = (48, 64),
    frames: int | None = None,
    stop: int | None = None,
    edit: Callable[[int, dict[str, Any]], None] | None = None,
    reference_height: np.ndarray | None = None,
    **changes: Any,
) -> Path:
    """Write a bundle of the first `frames`. `edit(index, arrays)` may spoil one; `stop` rejects the scene there."""
    rows = states()[:frames]
    with Writer(path, attributes(**changes), frames=len(rows)) as writer:
        if "rgb" in outputs:
            writer.put("/reference/rgb", _untouched(shape))
        if "markers" in outputs:
            writer.put("/reference/markers", marker_grid(shape))
        if "height" in outputs:
            flat = np.zeros((shape[0] // 4, shape[1] // 4))
            writer.put("/reference/height", flat if reference_height is None else reference_height)
        if "stress" in outputs:
            writer.put("/mesh/points", np.indices((2, 2, 2)).reshape(3, 8).T)
            writer.put("/mesh/cells", np.array([[0, 4, 6, 2, 1, 5, 7, 3]]))
            writer.put("/mesh/layer", np.zeros(1, int))
            writer.put("/mesh/facets/coated", np.array([[1, 5, 7, 3]]))
        for index, state in enumerate(rows[:stop]):
            arrays = frame(state, shape, outputs)
            if edit:
                edit(index, arrays)
            writer.append(arrays)
        if stop is None:
            writer.finish()
        else:
            writer.finish("rejected", f"frame {stop} of {len(rows)}: Newton's method stalled")
    return path
