"""Sparsh: the pickles of its force and slip tasks, as read by its VisionForceSlipDataset for `digit` and `gelsight`.

    https://github.com/facebookresearch/sparsh (tactile_ssl/data/vision_based_forces_slip_probes.py, digit/utils.py)

`<sensor>/<shape>/batch_<n>/dataset_<sensor>_00.pkl` and on: lists of PNG files as bytes, upright (a picture that is
wider than high is turned clockwise, as Sparsh does itself). The first one is the untouched sensor, with 0 in
`in_contact`: Sparsh subtracts the first such picture from all. `dataset_slip_forces.pkl` is a dictionary:

    in_contact    (pictures,) 1 where the sensor is touched
    trajectories  by number, one for each scene:
        indexes        (N,) of its pictures
        forces         (N, 3) on the gel in the sensor's frame [N], as in the bundle: x right and y down in the picture
                       before it is turned
        slip_label     (N,) 1 where all of the contact slides or turns
        poses          (N, 7) of the indenter: x y z [mm], quaternion w x y z
        coef_friction  of the scene

A batch holds one split of the scenes with one untouched picture. `<sensor>/datasets.json` lists the batches as
Sparsh's configuration does: `list_datasets` to train with, `list_datasets_val`, `list_datasets_test`. Sparsh looks
back five frames: it takes nothing from a scene of five or fewer.
"""

import copyreg
import io
import json
import pickle
import re
from collections import defaultdict
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base.errors import UserError
from tacgen.base.output_file import add
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.caption import modes
from tacgen.bundle.image_file import encoded
from tacgen.bundle.splits import assigned
from tacgen.export import needs, poses

SPARSH_SENSORS = ("digit", "gelsight")  # as Sparsh names them; sensors are told by how their names begin
PICTURES_PER_FILE = 5000  # in a file, as in Sparsh's own data sets
SKIPPED_FRAMES = 5  # frames that Sparsh leaves out of each trajectory
SLIP_MODES = ("sliding", "turning")
SPLIT_LIST_KEYS = {"train": "list_datasets", "val": "list_datasets_val", "test": "list_datasets_test"}


def write(bundles: Sequence[Bundle], out: Path) -> list[Path]:
    """Write the batches of each sensor, and the list of them.

    Raises:
        UserError: a sensor that Sparsh does not know, scenes without pictures or events, or all too short.
    """
    for bundle in bundles:
        needs(bundle, ("/frames/rgb", "/reference/rgb", "/frames/events/mode"), "rgb and events")
        _sensor(bundle)
    if max(bundle.frames for bundle in bundles) <= SKIPPED_FRAMES:
        raise UserError(f"{bundles[0].path}: Sparsh needs scenes of more than {SKIPPED_FRAMES} frames, all are shorter")
    made: list[Path] = []
    listed: dict[str, dict[str, list[str]]] = defaultdict(lambda: {name: [] for name in SPLIT_LIST_KEYS.values()})
    for (sensor, shape, split, _), scenes in _batches(bundles).items():
        number = 1 + sum(name.startswith(f"{shape}/") for names in listed[sensor].values() for name in names)
        listed[sensor][SPLIT_LIST_KEYS[split]].append(f"{shape}/batch_{number}")
        made += _write(scenes, sensor, out / sensor / shape / f"batch_{number}")
    for sensor, lists in listed.items():
        made.append(add(out / sensor / "datasets.json", json.dumps(lists, indent=1) + "\n"))
    return made


def _sensor(bundle: Bundle) -> str:
    """Sparsh's name of the sensor."""
    for known in SPARSH_SENSORS:
        if bundle.attrs["sensor"].startswith(known):
            return known
    raise UserError(f"{bundle.path}: Sparsh knows digit and gelsight, not {bundle.attrs['sensor']}")


def _batches(bundles: Sequence[Bundle]) -> dict[tuple[str, str, str, str], list[Bundle]]:
    """Scenes by sensor, shape, split, and digest of the untouched picture, in order of first appearance."""
    batches: dict[tuple[str, str, str, str], list[Bundle]] = {}
    for bundle, split in zip(bundles, assigned(bundles), strict=True):
        indenter = bundle.recipe.get("indenter", {})
        shape = re.sub(r"[^\w-]", "_", Path(str(indenter.get("file") or indenter.get("shape", "object"))).stem)
        untouched = sha256(bundle["/reference/rgb"].tobytes()).hexdigest()
        batches.setdefault((_sensor(bundle), shape, split, untouched), []).append(bundle)
    return batches


def _write(scenes: Sequence[Bundle], sensor: str, folder: Path) -> list[Path]:
    made, pictures, touched = list[Path](), [_picture(scenes[0]["/reference/rgb"])], [np.zeros(1, np.int64)]
    trajectories, start = {}, 1
    for number, bundle in enumerate(scenes):
        trajectories[number] = _trajectory(bundle, start)
        touched.append((bundle["/frames/events/mode"] != 0).astype(np.int64))
        start += bundle.frames
        for k in range(bundle.frames):
            if len(pictures) == PICTURES_PER_FILE:
                made.append(_dump(pictures, folder / f"dataset_{sensor}_{len(made):02d}.pkl"))
                pictures = []
            pictures.append(_picture(bundle.frame("/frames/rgb", k)))
    made.append(_dump(pictures, folder / f"dataset_{sensor}_{len(made):02d}.pkl"))
    labels = {"in_contact": np.concatenate(touched), "trajectories": trajectories}
    return [*made, _dump(labels, folder / "dataset_slip_forces.pkl")]


def _trajectory(bundle: Bundle, start: int) -> dict[str, Any]:
    """The labels of a scene whose first picture is number `start` of the batch."""
    return {
        "indexes": start + np.arange(bundle.frames),
        "forces": bundle["/frames/force"],
        "slip_label": np.array([mode in SLIP_MODES for mode in modes(bundle)], np.int64),
        "poses": poses(bundle["/frames/pose"]),
        "coef_friction": float(bundle.recipe.get("contact", {}).get("friction", 0.0)),
    }


def _picture(image: np.ndarray) -> bytes:
    high, wide = image.shape[:2]
    return encoded(np.ascontiguousarray(np.rot90(image, -1)) if wide > high else image, "PNG")


def _dump(content: Any, path: Path) -> Path:
    """Pickle it so that every NumPy can read the arrays: 2 and 1 name their own functions for that differently."""
    file = io.BytesIO()
    pickler = pickle.Pickler(file, protocol=4)
    pickler.dispatch_table = copyreg.dispatch_table | {np.ndarray: _plain}
    pickler.dump(content)
    return add(path, file.getvalue())


def _plain(array: np.ndarray) -> tuple[Any, ...]:
    return np.ndarray, (array.shape, array.dtype.str, bytearray(np.ascontiguousarray(array).tobytes()))
