"""UniVTAC: one HDF5 file per episode, as read by its HDF5Handler; the sensor is that of the left finger.

    https://github.com/univtac/UniVTAC (docs/Collection.md, envs/utils/data.py)

Of `tactile/left_tactile`: `rgb` (JPEG streams; with the markers in the picture also `rgb_marker`), `marker`
(reference and present pixels), `press_depth` (indentation, positive [mm]), `depth` (from the pinhole along its axis
[mm]), `pose` (of the sensor, which is the reference frame), and in addition to UniVTAC's datasets `force` and `torque`
[N, N mm]. `actor/indenter` is the indenter's pose, x y z [m] and a quaternion w x y z. There is no robot and no
head camera here, so `embodiment` and `observation` are left out rather than filled with zeros.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base import atomic_file
from tacgen.base.output_file import add
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.hdf5_file import written_file
from tacgen.bundle.image_file import encoded
from tacgen.export import names, needs, poses

POSE_TO_METRES = (1e-3, 1e-3, 1e-3, 1, 1, 1, 1)  # factors that convert a pose from mm to m
JPEG_QUALITY = 95  # what UniVTAC's encoder uses


def write(bundles: Sequence[Bundle], out: Path) -> list[Path]:
    """`out/hdf5/<n>.hdf5`, numbered in order, and `out/metadata.json`, which describes each."""
    for bundle in bundles:
        needs(bundle, ("/frames/rgb",), "rgb")
    folder = out / "hdf5"
    folder.mkdir()
    made, about = [], {}
    for number, (name, bundle) in enumerate(zip(names(bundles), bundles, strict=True)):
        made.append(folder / f"{number}.hdf5")
        with atomic_file.published(made[-1]) as sink, written_file(sink) as file:
            for path, values in episode(bundle).items():
                file.create_dataset(path, data=values, track_times=False)
        about[str(number)] = {"scene": name, "steps": bundle.frames, "recipe": bundle.recipe}
    return [*made, add(out / "metadata.json", json.dumps(about, indent=1) + "\n")]


def episode(bundle: Bundle) -> dict[str, np.ndarray]:
    """Path in the file -> values, the frame first."""
    steps = np.arange(bundle.frames)
    out: dict[str, Any] = {
        "step": steps,
        "atom/id": bundle["/frames/segment"].astype(np.int64),
        "atom/tag": np.array(bundle.segments, dtype=bytes),
        "actor/indenter": poses(bundle["/frames/pose"]) * POSE_TO_METRES,
    }
    still = np.tile([0, 0, 0, 1.0, 0, 0, 0], (len(steps), 1))
    tactile: dict[str, Any] = {"rgb": streams(bundle["/frames/rgb"]), "pose": still}
    if "/frames/markers" in bundle:
        now = bundle["/frames/markers"]
        tactile["marker"] = np.stack([np.broadcast_to(bundle["/reference/markers"], now.shape), now], axis=1)
        tactile["rgb_marker"] = tactile["rgb"]
    if "/frames/height" in bundle:
        from tacgen.optics.camera import PinholeCamera

        height = bundle["/frames/height"]
        tactile["press_depth"] = np.maximum(bundle["/reference/height"] - height, 0)
        tactile["depth"] = height - np.float32(PinholeCamera.from_sensor(bundle.sensor).pinhole[2])
    for name in ("force", "torque"):
        if f"/frames/{name}" in bundle:
            tactile[name] = bundle[f"/frames/{name}"]
    return out | {f"tactile/left_tactile/{name}": values for name, values in tactile.items()}


def streams(images: np.ndarray) -> np.ndarray:
    """JPEG files as byte strings (N,), red and blue swapped as by UniVTAC: OpenCV takes its RGB for BGR."""
    pictures = [encoded(np.ascontiguousarray(image[..., ::-1]), "JPEG", quality=JPEG_QUALITY) for image in images]
    return np.array(pictures, dtype=f"S{max(map(len, pictures))}")
