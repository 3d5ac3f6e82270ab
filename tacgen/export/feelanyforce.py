"""FeelAnyForce: tables of picture, depth and wrench, as read by its TacForceDataset for the GelSight Mini.

    https://github.com/prgumd/FeelAnyForce (dataset.py, record_deForce.py, training_multi_head.py)

`TacForce_train_set.csv`, `TacForce_val_set.csv` and `TacForce_test_set.csv` have the columns

    tactile  `tactile/<scene>_<frame>.png`, RGB, 240 x 320; `tactile_nobg/` has it less the untouched sensor, plus 127
    depth    `depth/<scene>_<frame>.npy`, float32 (240, 320): indentation in widths of a pixel
    FT       force [N] and torque [N m] on the object in the sensor's frame, six numbers: Fz is positive in compression

and `tactile/background.png` is the untouched sensor; other units of the sensor follow as background_1.png and on.
FeelAnyForce joins its option --data_basedir and these paths as they are: give it with a slash at its end, and without
the word tactile in it, which it replaces by tactile_nobg. It does not state on which body its FT acts, nor its axes.
"""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tacgen.base.output_file import add
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.image_file import encoded
from tacgen.bundle.splits import SPLITS, assigned
from tacgen.export import IMAGE, needs, needs_image, npy

MM_PER_M = 1e3


def write(bundles: Sequence[Bundle], out: Path) -> list[Path]:
    """Write the tables and their files. Raises UserError: a scene without rgb or height, or of another image size."""
    for bundle in bundles:
        needs(bundle, ("/frames/rgb", "/reference/rgb", "/frames/height", "/reference/height"), "rgb and height")
        needs_image(bundle, "FeelAnyForce")
    made, backgrounds = list[Path](), list[bytes]()
    tables: dict[str, list[tuple[str, str, str]]] = {split: [] for split in SPLITS}
    for number, (bundle, split) in enumerate(zip(bundles, assigned(bundles), strict=True)):
        background = encoded(bundle["/reference/rgb"], "PNG")
        if background not in backgrounds:
            name = f"background{f'_{len(backgrounds)}' if backgrounds else ''}.png"
            made.append(add(out / "tactile" / name, background))
            backgrounds.append(background)
        for k in range(bundle.frames):
            name = f"{number:05d}_{k:05d}"  # a scene's own name may hold the word tactile
            made += _frame(bundle, k, out, name)
            tables[split].append((f"tactile/{name}.png", f"depth/{name}.npy", _wrench(bundle, k)))
    for split, rows in tables.items():
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([("tactile", "depth", "FT"), *rows])
        made.append(add(out / f"TacForce_{split}_set.csv", text.getvalue()))
    return made


def _frame(bundle: Bundle, k: int, out: Path, name: str) -> list[Path]:
    """The three files of a frame."""
    image = bundle.frame("/frames/rgb", k)
    less = np.clip(image.astype(int) - bundle["/reference/rgb"] + 127, 0, 255).astype(np.uint8)
    return [
        add(out / "tactile" / f"{name}.png", encoded(image, "PNG")),
        add(out / "tactile_nobg" / f"{name}.png", encoded(less, "PNG")),
        add(out / "depth" / f"{name}.npy", npy(depth(bundle, k))),
    ]


def depth(bundle: Bundle, k: int) -> np.ndarray:
    """Indentation behind each pixel (240, 320), positive into the gel, in widths of a pixel on the untouched face."""
    from scipy.ndimage import zoom

    indentation = np.nan_to_num(bundle["/reference/height"] - bundle.frame("/frames/height", k))
    factors = [n / m for n, m in zip(IMAGE[:2], indentation.shape, strict=True)]
    finer = zoom(indentation, factors, order=1, mode="nearest", grid_mode=True)
    return np.asarray(finer / bundle.sensor.camera.mm_per_px, np.float32)


def _wrench(bundle: Bundle, k: int) -> str:
    force, torque = -bundle["/frames/force"][k], -bundle["/frames/torque"][k] / MM_PER_M
    return " ".join(f"{value:.6f}" for value in (*force, *torque))
