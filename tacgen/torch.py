"""Frames of a dataset for PyTorch's DataLoader or any other loop, as NumPy arrays.

    from torch.utils.data import DataLoader
    from tacgen.torch import TactileDataset

    train = TactileDataset("data/batch", fields=("rgb", "force"), split="train")
    for batch in DataLoader(train, batch_size=64, shuffle=True, num_workers=2):
        batch["rgb"], batch["force"]  # tensors: (64, 240, 320, 3), (64, 3)

PyTorch is not imported here: DataLoader accepts any object with a length and items, and converts arrays to tensors.
"""

import math
import os
from collections import OrderedDict
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tacgen.base.errors import UserError
from tacgen.bundle import dataset, field_names
from tacgen.bundle.check import UNIQUE_PATH
from tacgen.bundle.chunks import FrameReader
from tacgen.bundle.hdf5_file import item_at, open_file
from tacgen.bundle.splits import SPLIT_FRACTIONS, divide
from tacgen.outputs import LAYOUT

Item = dict[str, Any]
MAX_PIXEL_VALUE = 255  # of a picture in bytes
MAX_OPEN_FILES = 128  # most open files in each process
# bytes of a frame up to which a dataset is read for a whole scene at once and kept in memory
MAX_CACHED_FRAME_BYTES = 1024


class TactileDataset:
    """The frames of all finished scenes; `dataset[i]` is a dictionary.

    Its keys are the fields, as stored, and `scene` and `frame`, which say where it comes from. Each process opens files
    when it first reads them, so that a DataLoader may fork or spawn its workers.

    Args:
        path: a bundle, a folder of bundles, or a packed folder.
        fields: names below /frames or /fields of a bundle: rgb, force, pressure, markers, nodal_stress, ...
        merge: `path` may hold several data sets in folders of their own, which are taken as one.
        split: the part of the scenes, chosen by `seed`; no scene is in two parts. `all`: every scene.
        fractions: shares of scenes, or of objects, for train, val and test.
        by_object: split by indenters, so that no object is in two parts: meshes by their file, others by their shape.
        unique: leave out frames from a fold of the gel on, whose forces may depend on the step size; `left_out` is
            their number.
        subtract_reference: subtract the untouched sensor from rgb (then int16), height and markers (float32).
        float32: all fields as float32, pictures from 0 to 1 (their change from -1 to 1).
        channels_first: images and maps (h, w, c) as (c, h, w), for convolutions; those without channels stay (h, w).
        transform: a function that is applied to each item.

    Raises:
        UserError: no scenes, or no frames that are unique, several data sets without `merge`, a damaged or newer file,
            a missing shard, or a field that a scene does not have.

    A LeftOut warning names bundles that are not of the plan of their folder, which are left out.
    """

    def __init__(
        self,
        path: str | Path,
        fields: Sequence[str] = ("rgb", "force"),
        *,
        merge: bool = False,
        split: Literal["all", "train", "val", "test"] = "all",
        fractions: tuple[float, float, float] = SPLIT_FRACTIONS,
        by_object: bool = False,
        seed: int = 0,
        unique: bool = False,
        subtract_reference: bool = False,
        float32: bool = False,
        channels_first: bool = False,
        transform: Callable[[Item], Any] | None = None,
    ) -> None:
        good = [scene for scene in dataset.scenes(Path(path), merge=merge) if scene.attrs["status"] == "ok"]
        self.scenes = divide(good, split, fractions, seed, by_object=by_object)
        held: list[tuple[Path, Collection[str]]] = [(scene.path, scene.shapes) for scene in self.scenes]
        for place, paths in held or [(Path(path), LAYOUT)]:
            stored = field_names.short(paths).values()
            try:
                self.fields = {name: field_names.path_of(name, stored) for name in fields}
            except UserError as error:
                raise UserError(f"{place}: {error}") from None
        self.subtract_reference, self.transform = subtract_reference, transform
        self.float32, self.channels_first = float32, channels_first
        each = [np.flatnonzero(scene[UNIQUE_PATH]) if unique else np.arange(scene.frames) for scene in self.scenes]
        self._frame = np.concatenate([*each, np.zeros(0, np.int64)])
        self.left_out = sum(scene.frames for scene in self.scenes) - len(self._frame)
        self._starts = np.concatenate([[0], np.cumsum([len(frames) for frames in each])]).astype(int)
        if self.scenes and not len(self._frame):  # a loss over it would be nan
            raise UserError(f"{path}: no frame of split {split!r} is unique: more scenes, or another split")
        self._forget()

    def __len__(self) -> int:
        return int(self._starts[-1])

    def __repr__(self) -> str:
        without = f"; {self.left_out} after a fold left out" if self.left_out else ""
        return f"TactileDataset({len(self)} frames of {len(self.scenes)} scenes: {', '.join(self.fields)}{without})"

    def __getitem__(self, index: int) -> Any:
        """One frame. Raises IndexError, or UserError if the file is damaged there."""
        if not -len(self) <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        index %= len(self)
        number = int(np.searchsorted(self._starts, index, side="right")) - 1
        frame = int(self._frame[index])
        if self._process != os.getpid():  # a file that is inherited by a fork must not be read by two processes
            self._forget()
        item: Item = {"scene": number, "frame": frame}
        for name, path in self.fields.items():
            item[name] = self._formed(self._values(number, name, path, frame), path)
        return self.transform(item) if self.transform else item

    def places(self, scene: int) -> dict[int, int]:
        """The indices of the frames of a scene, by their numbers in it."""
        first, end = self._starts[scene : scene + 2].tolist()
        return dict(zip(self._frame[first:end].tolist(), range(first, end), strict=True))

    def __getstate__(self) -> dict[str, Any]:
        """State for spawned workers: without open files."""
        hidden = ("_files", "_kept", "_process")
        return {name: value for name, value in self.__dict__.items() if name not in hidden}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._forget()

    def _forget(self) -> None:
        self._process = os.getpid()
        self._files: OrderedDict[Path, tuple[Any, dict[str, FrameReader]]] = OrderedDict()
        self._kept: dict[tuple[int, str], np.ndarray] = {}  # small datasets and references

    def _formed(self, values: np.ndarray, path: str) -> np.ndarray:
        """Values of a dataset in the type and the order of axes that are asked for."""
        axes = LAYOUT[path].axes.split()
        if self.float32:
            values = values.astype(np.float32) / np.float32(MAX_PIXEL_VALUE if axes[-1] == "rgb" else 1)
        if self.channels_first and axes[1:3] == ["row", "column"] and len(axes) == 4:
            values = np.ascontiguousarray(np.moveaxis(values, -1, 0))
        return values

    def _values(self, number: int, name: str, path: str, frame: int) -> np.ndarray:
        shape = self.scenes[number].shapes[path]
        if math.prod(shape[1:]) * np.dtype(LAYOUT[path].dtype).itemsize <= MAX_CACHED_FRAME_BYTES:
            values: np.ndarray = self._whole(number, path)[frame]
        else:
            values = self._read(number, path, frame)
        if not self.subtract_reference or f"/reference/{name}" not in self.scenes[number]:
            return values
        kind = np.int16 if values.dtype == np.uint8 else np.float32
        return np.asarray(np.subtract(values, self._whole(number, f"/reference/{name}"), dtype=kind))

    def _whole(self, number: int, path: str) -> np.ndarray:
        if (number, path) not in self._kept:
            self._kept[number, path] = self._read(number, path, None)
        return self._kept[number, path]

    def _read(self, number: int, path: str, index: int | None) -> np.ndarray:
        scene = self.scenes[number]
        try:
            stored = self._stored(scene.path, f"{scene.group}{path}")
            return stored.whole() if index is None else stored[index]
        except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
            raise UserError(f"{scene.path}: damaged: {str(error).partition(chr(10))[0]}") from error

    def _stored(self, path: Path, inside: str) -> FrameReader:
        """A dataset of an open file; if too many files are open, the least recently used one is closed."""
        if path not in self._files:
            if len(self._files) >= MAX_OPEN_FILES:
                self._files.popitem(last=False)[1][0].close()
            self._files[path] = (open_file(path), {})
        self._files.move_to_end(path)
        file, known = self._files[path]
        if inside not in known:
            known[inside] = FrameReader(item_at(file, inside))
        return known[inside]


class TactilePairs:
    """Frames of one contact on several sensors, or of the two fingers of a grasp.

    `pairs[i]` is a dictionary from the sensors' names, or `left` and `right`, to one frame of each.

    Contacts that do not exist on all of `sensors` are left out; with `unique` also frames that are not so on all.

    Args:
        sensors: names of at least two; None: those of the first contact that exists on several sensors.
        options: as of TactileDataset.

    Raises:
        UserError: no contact exists on all of them.
    """

    def __init__(
        self,
        path: str | Path,
        fields: Sequence[str] = ("rgb", "force"),
        *,
        sensors: Sequence[str] | None = None,
        **options: Any,
    ) -> None:
        self.dataset = TactileDataset(path, fields, **options)
        scenes = self.dataset.scenes
        contacts = [{dataset.role(scenes[i]): i for i in places} for places in dataset.contacts(scenes)]
        several = sensors or next((tuple(contact) for contact in contacts if len(contact) > 1), ())
        self.sensors = tuple(several)
        whole = [contact for contact in contacts if several and contact.keys() >= set(several)]
        if not whole:
            raise UserError(f"{path}: holds no contact on {' and '.join(several) or 'several sensors'}")
        held = [[self.dataset.places(contact[name]) for name in several] for contact in whole]
        self._places = [
            [place[frame] for place in places]
            for places in held
            for frame in places[0]
            if all(frame in place for place in places)  # one may end before a fold
        ]

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, index: int) -> dict[str, Any]:
        """One frame on every sensor. Raises IndexError, or UserError if a file is damaged there."""
        return {name: self.dataset[i] for name, i in zip(self.sensors, self._places[index], strict=True)}
