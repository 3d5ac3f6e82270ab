"""FEATS: one .npy dictionary per frame, as read by its FEATSDataset and training scripts.

    https://github.com/feats-ai/feats (src/feats/scripts/label_generation.py, src/feats/src/data/dataloader.py)

`gs_img` (240, 320, 3) RGB; `grid_x|y|z` (24, 32), the force on the gel in each cell of the image [N]; `f_x|y|z`,
their sums. Their grid_x is the force along their solver's y, which by their homography points left in the image,
and grid_y that along its x, which points up; z is negative in compression. So grid_x = -Fx, grid_y = -Fy, grid_z =
Fz in the sensor frame (x right, y down). They do not state on which body the force
acts; by the sign of z it is taken as the force on the gel.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tacgen.base.output_file import add
from tacgen.bundle.bundle import Bundle
from tacgen.export import names, needs, needs_image, npy

FEATS_FORCE_GRID = (24, 32)
FEATS_FORCE_SIGNS = (("x", -1.0), ("y", -1.0), ("z", 1.0))


def write(bundles: Sequence[Bundle], out: Path) -> list[Path]:
    """`out/train/<scene>_<frame>.npy`, and `out/normalization.npy`, the ranges by which FEATSDataset scales."""
    for bundle in bundles:
        needs(bundle, ("/frames/rgb", "/frames/force_map"), "rgb and force_map")
        needs_image(bundle, "FEATS")
    made, ranges = [], dict[str, dict[str, float]]()
    for name, bundle in zip(names(bundles), bundles, strict=True):
        for k in range(bundle.frames):
            label = sample(bundle, k)
            made.append(add(out / "train" / f"{name}_{k:05d}.npy", npy(label)))
            for key, values in label.items():
                known = ranges.setdefault(key, {"min": np.inf, "max": -np.inf})
                known["min"] = min(known["min"], float(np.min(values)))
                known["max"] = max(known["max"], float(np.max(values)))
    return [*made, add(out / "normalization.npy", npy(ranges))]


def sample(bundle: Bundle, frame: int) -> dict[str, np.ndarray]:
    """The dictionary of a frame."""
    force = bundle.frame("/frames/force_map", frame).astype(float)
    rows, columns = (shares(n, cells) for n, cells in zip(force.shape, FEATS_FORCE_GRID, strict=False))
    label = {"gs_img": bundle.frame("/frames/rgb", frame)}
    for axis, (name, sign) in enumerate(FEATS_FORCE_SIGNS):
        label[f"grid_{name}"] = sign * (rows @ force[..., axis] @ columns.T)
    for name, _ in FEATS_FORCE_SIGNS:
        label[f"f_{name}"] = label[f"grid_{name}"].sum()
    return label


def shares(n: int, cells: int) -> np.ndarray:
    """(cells, n): fraction of each of n equal samples that lies in each of `cells` equal cells; columns sum to one."""
    edges = np.arange(n + 1) * cells / n
    low, high = edges[:-1], edges[1:]
    cell = np.arange(cells)[:, None]
    overlap = np.minimum(high, cell + 1) - np.maximum(low, cell)
    return np.asarray(np.maximum(overlap, 0) / (high - low))
