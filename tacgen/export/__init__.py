"""Finished bundles into the files of other tools: a module a format, each with `write(bundles, out)`.

A format is a line of EXPORTERS and a module of that name with

    def write(bundles: Sequence[Bundle], out: Path) -> list[Path]: ...

that writes below the folder `out` (or to the file `out`, where the format is one file) and says which files it made.
"""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from tacgen.errors import UserError

if TYPE_CHECKING:
    from tacgen.bundle.bundle import Bundle

EXPORTERS = {
    "exr": "linear light, height, normals and material points as OpenEXR: one .exr file a frame (tacgen[exr])",
    "vtkhdf": "mesh, displacement and stress over the frames, for ParaView: one .vtkhdf file a scene",
    "feats": "image and force in each of 24 x 32 cells, for FEATS: one .npy file a frame",
    "lerobot": "image, pose, force and markers as a LeRobot dataset, format v3.0 (tacgen[lerobot])",
    "univtac": "image, markers and depth of a finger as UniVTAC's episodes; its training needs two, and joints",
    "webdataset": "every dataset of a frame as samples in tar files, for streaming (tacgen[webdataset])",
}


def bundles(source: Path) -> "list[Bundle]":
    """The finished bundle `source`, or all of those in a folder or pack, in order; rejected scenes are left out.

    Raises:
        UserError: there is none, or one is damaged.
    """
    from tacgen.bundle.dataset import scenes

    found = [bundle for bundle in scenes(source) if bundle.attrs["status"] == "ok"]
    if not found:
        raise UserError(f"{source}: no finished scene to export")
    return found


def export(kind: str, source: Path, out: Path) -> list[Path]:
    """Write the bundles at `source` in a format of EXPORTERS, and return the files made.

    Raises:
        UserError: an unknown format, nothing to export, a damaged bundle, or one without what the format needs.
        OSError: `out` cannot be written.
    """
    if kind not in EXPORTERS:
        raise UserError(f"{kind}: unknown format, use one of {', '.join(EXPORTERS)}")
    found = bundles(source)
    for bundle in found:
        bundle.verify()
    made: list[Path] = import_module(f"tacgen.export.{kind}").write(found, out)
    return made


def needs(bundle: "Bundle", paths: Sequence[str], output: str) -> None:
    """UserError unless the bundle holds every dataset of `paths`, which the recipe's `output` brings."""
    if missing := [path for path in paths if path not in bundle]:
        raise UserError(f"{bundle.path}: has no {missing[0]}: the recipe's outputs need {output}")


def names(bundles: "Sequence[Bundle]") -> list[str]:
    """A name of its own for each bundle: that of its file, with its folders before it as far as they are needed."""
    parts = [(*bundle.path.with_suffix("").parts, *bundle.group.split("/")[1:]) for bundle in bundles]
    parts = [tuple(filter(None, part)) for part in parts]
    for depth in range(1, max(map(len, parts)) + 1):
        found = ["-".join(part[-depth:]) for part in parts]
        if len(set(found)) == len(found):
            break
    return found
