"""The page of an export on a data hub: README.md with a YAML header that the Hugging Face Hub reads.

    https://huggingface.co/docs/hub/datasets-cards

The header has the licence, task, size, splits (bytes by their shares of the frames) and, where the hub can show the
files, their places and columns. Its key `tacgen` says where the data are from: version, recipe, digest, the command of
the export, and every dataset of the scenes with shape and unit. Below it are the data set's own card and the recipe of
its first scene.
"""

import json
import shlex
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from tacgen.base.errors import LeftOut, printable
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.dataset import contacts
from tacgen.bundle.schema import entry
from tacgen.bundle.splits import SPLITS, assigned
from tacgen.export import EXPORTERS, lerobot
from tacgen.export.episodes import episodes
from tacgen.report import dataset_card, dataset_summary
from tacgen.report.dataset_summary import Overview
from tacgen.sensor.yaml_source import dumped

SIZE_CATEGORIES = {10**3: "n<1K", 10**4: "1K<n<10K", 10**5: "10K<n<100K", 10**6: "100K<n<1M", 10**7: "1M<n<10M"}
LARGEST_SIZE_CATEGORY = "10M<n<100M"
JOINED_FORMATS = ("lerobot", "webdataset", "zarr")  # formats in which a contact on several sensors is one row
HUB_FORMATS = {**EXPORTERS, "pack": "bundles in HDF5 shards and their index, for `tacgen.torch.TactileDataset` or h5py"}
# of each split, in the formats that the hub's library reads
SPLIT_FILE_PATTERNS = {"feelanyforce": "TacForce_{}_set.csv", "webdataset": "{}-*.tar"}


def writer(
    kind: str, source: Path, out: Path, *, licence: str | None = None, merge: bool = False
) -> Callable[[Sequence[Bundle], Path], str]:
    """A function that makes the page of an export from its bundles and its folder, whose other files are complete.

    Args:
        licence: an identifier of the hub, such as cc-by-4.0; None: the page says that it is not known.
    """
    options = ["--card", *(["--licence", licence] if licence else []), *(["--merge"] if merge else [])]
    command = shlex.join(["tacgen", "export", kind, source.resolve().name, "-o", out.resolve().name, *options])

    def page(bundles: Sequence[Bundle], folder: Path) -> str:
        seen = dataset_summary.of_bundles(bundles, source) if merge else dataset_summary.look(source)
        return text(kind, command, bundles, folder, seen, licence)

    return page


def text(
    kind: str,
    command: str,
    bundles: Sequence[Bundle],
    folder: Path,
    seen: Overview,
    licence: str | None = None,
    more: str = "",
) -> str:
    """The page of a folder that holds the bundles in a format of HUB_FORMATS and was made by a command.

    Args:
        seen: the overview of the data set.
        more: a further part of the text, in Markdown.
    """
    head = dumped(header(kind, bundles, folder, command, licence or "unknown"))
    about = HUB_FORMATS[kind].partition(" (tacgen[")[0]
    made = f"## Files\n\n`{kind}`: {about}. Made by\n\n```sh\n{printable(command)}\n```"
    recipe = json.dumps(bundles[0].recipe, indent=1).replace("`", "\\u0060")
    parts = [dataset_card.text(seen, licence or "").rstrip("\n"), made, more.strip("\n")]
    parts.append(f"## Recipe of the first scene\n\n```json\n{recipe}\n```")
    return f"---\n{head}---\n\n" + "\n\n".join(filter(None, parts)) + "\n"


def header(kind: str, bundles: Sequence[Bundle], folder: Path, command: str, licence: str) -> dict[str, Any]:
    """The header as plain values."""
    frames = _frames(kind, bundles)
    total = sum(frames.values())
    names = list(dict.fromkeys(str(bundle.recipe.get("name", "")) for bundle in bundles))
    sensors = list(dict.fromkeys(str(bundle.attrs["sensor"]) for bundle in bundles))
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    found: dict[str, Any] = {
        "license": licence,
        "pretty_name": ", ".join(names),
        "task_categories": ["robotics"],
        "size_categories": [next((v for most, v in SIZE_CATEGORIES.items() if total < most), LARGEST_SIZE_CATEGORY)],
        "tags": ["tactile", "simulation", *sensors, *(["LeRobot"] if kind == "lerobot" else [])],
    }
    splits = [{"name": n, "num_bytes": round(size * k / total), "num_examples": k} for n, k in frames.items()]
    info: dict[str, Any] = {"splits": splits, "download_size": size, "dataset_size": size}
    if files := _files(kind, folder, list(frames)):
        found["configs"] = [{"config_name": "default", "data_files": files}]
    else:
        found["viewer"] = False  # the hub's library does not read this format
    if kind == "lerobot":
        info = {"features": _columns(folder)} | info
    found["dataset_info"] = info
    found["tacgen"] = {
        "version": ", ".join(dict.fromkeys(str(bundle.attrs["tacgen_version"]) for bundle in bundles)),
        "recipe": ", ".join(names),
        "digest": dataset_card.digest(bundles),
        "format": kind,
        "command": command,
        "scenes": dict(Counter(assigned(bundles))),
        "features": _features(bundles),
    }
    return found


def _frames(kind: str, bundles: Sequence[Bundle]) -> dict[str, int]:
    """Number of rows of each split that has any."""
    rows = [(split, bundle.frames) for split, bundle in zip(assigned(bundles), bundles, strict=True)]
    if kind in JOINED_FORMATS and len(contacts(bundles)) < len(bundles):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LeftOut)  # the export has told it
            rows = [(episode.split, episode.frames) for episode in episodes(bundles)]
    counts = {name: sum(n for split, n in rows if split == name) for name in SPLITS}
    return {name: count for name, count in counts.items() if count}


def _files(kind: str, folder: Path, splits: Sequence[str]) -> list[dict[str, Any]]:
    """Where the files of each split are; empty if the hub's library cannot read them."""
    if kind == "lerobot":
        return [{"split": name, "path": paths} for name, paths in lerobot.split_files(folder).items()]
    pattern = SPLIT_FILE_PATTERNS.get(kind)
    return [{"split": name, "path": pattern.format(name)} for name in splits] if pattern else []


def _columns(folder: Path) -> list[dict[str, Any]]:
    """The columns of LeRobot's tables as the hub describes them."""
    columns = []
    for name, feature in json.loads((folder / "meta" / "info.json").read_text(encoding="utf-8"))["features"].items():
        if feature["dtype"] == "image" or feature["shape"] == [1]:
            columns.append({"name": name, "dtype": feature["dtype"]})
        else:
            columns.append({"name": name, "list": feature["dtype"], "length": feature["shape"][0]})
    return columns


def _features(bundles: Sequence[Bundle]) -> list[dict[str, Any]]:
    """Name, shape of a frame, type and unit of every dataset of a frame; sizes that differ between scenes are `*`."""
    shapes: dict[str, set[tuple[int, ...]]] = {}
    for bundle in bundles:
        for path, shape in bundle.shapes.items():
            if path.startswith(("/frames/", "/fields/")) and not path.startswith("/frames/quality/"):
                shapes.setdefault(path, set()).add(shape[1:])
    return [
        {
            "name": path.split("/", 2)[2],
            "shape": " x ".join(map(str, kinds.pop())) or "1" if len(kinds) == 1 else "*",
            "dtype": entry(path).dtype.lstrip("<|"),
            "unit": entry(path).units,
        }
        for path, kinds in sorted(shapes.items())
    ]
