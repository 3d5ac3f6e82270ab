"""Export of finished bundles to the formats of other tools, one module per format.

A format is a line of EXPORTERS and a module of that name with

    def write(bundles: Sequence[Bundle], out: Path) -> list[Path]: ...

that writes into the new, empty folder `out` and returns the files it made. If a scene becomes a single file, the module
defines its SUFFIX, and `out` may then be the name of that file.
"""

import io
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from tacgen.base import output_file, regular_file
from tacgen.base.errors import UserError
from tacgen.bundle import whole_folder
from tacgen.bundle.dataset import CARD_FILES

if TYPE_CHECKING:
    import numpy as np

    from tacgen.bundle.bundle import Bundle

EXPORTERS = {
    "exr": "linear light, height, normals and material points as OpenEXR: one .exr file a frame",
    "vtkhdf": "mesh, displacement and stress over the frames, for ParaView: one .vtkhdf file a scene",
    "feats": "image and force in each of 24 x 32 cells, for FEATS: one .npy file a frame",
    "lerobot": "image, pose, force and markers as a LeRobot dataset, format v3.0 (tacgen[lerobot])",
    "sparsh": "image, force and slip of the DIGIT or GelSight, as Sparsh's pickles of these tasks",
    "feelanyforce": "image, depth and wrench of the GelSight Mini as FeelAnyForce's tables, images and arrays",
    "zarr": "every dataset of a frame as a replay buffer of diffusion policies (tacgen[zarr])",
    "rerun": "image, maps, face and wrench over time for the Rerun viewer: one .rrd file a scene (tacgen[rerun])",
    "univtac": "image, markers and depth of a finger as UniVTAC's episodes; its training needs two, and joints",
    "webdataset": "every dataset of a frame as samples in tar files, for streaming (tacgen[webdataset])",
}


IMAGE = (240, 320, 3)  # which FEATS and FeelAnyForce take
SPLIT_FORMATS = ("lerobot", "sparsh", "feelanyforce", "zarr", "webdataset")  # into train, val and test


def bundles(source: Path, *, merge: bool = False) -> "list[Bundle]":
    """The finished bundle `source`, or all of a data set, in order, without rejected scenes; `merge` as of `scenes`.

    Raises:
        UserError: there is none, or one is damaged; there are several data sets and no `merge`.
    """
    from tacgen.bundle.dataset import scenes

    good = [bundle for bundle in scenes(source, merge=merge) if bundle.attrs["status"] == "ok"]
    if not good:
        raise UserError(f"{source}: no finished scene to export")
    return good


def export(
    kind: str,
    source: Path,
    out: Path,
    *,
    merge: bool = False,
    overwrite: bool = False,
    card: "Callable[[Sequence[Bundle], Path], str] | None" = None,
    tell: "Callable[[Sequence[str]], None] | None" = None,
) -> list[Path]:
    """Write the bundles at `source` in a format of EXPORTERS, and return the files made.

    The card of the data set, if `source` is a folder that has one, goes with an export that is a folder.

    Args:
        merge: `source` may hold several data sets, which become one.
        overwrite: `out`, if it is a file, may exist.
        card: makes the text of README.md in the place of that card, from the bundles and the folder that is written.
        tell: takes warnings, such as of a split without scenes.

    Raises:
        UserError: an unknown format, nothing to export, a damaged bundle, or one without the datasets that the
            format needs; `out` is a file or input, or holds anything other than an export of this format, which would
            be replaced; a card for a file.
        OSError: `out` cannot be written.
    """
    if kind not in EXPORTERS:
        from tacgen.sensor.validation_messages import unknown

        raise UserError(f"{kind}: {unknown('format', kind, EXPORTERS)}")
    from tacgen.bundle.splits import empty_parts

    sources = bundles(source, merge=merge)
    for bundle in sources:
        bundle.verify()
    module = import_module(f"tacgen.export.{kind}")
    if len(sources) == 1 and out.suffix == getattr(module, "SUFFIX", None):
        if card:
            raise UserError(f"{out}: a card needs a folder to be in: name one")
        with output_file.written(out, [source], overwrite=overwrite) as path:
            module.write(sources, path)
        return [out]
    with whole_folder.written(out, kind) as folder:
        made = [path.relative_to(folder) for path in module.write(sources, folder)]
        page = card(sources, folder).encode() if card else _card(source)
        if page:
            output_file.add(folder / CARD_FILES[0], page)
            made.append(Path(CARD_FILES[0]))
    if tell and kind in SPLIT_FORMATS:
        tell(empty_parts(sources))
    return [out / path for path in made]


def _card(source: Path) -> bytes:
    """The card that tacgen wrote for the data set in a folder; empty without one."""
    cards = (source / name for name in CARD_FILES) if source.is_dir() else ()
    page = next((path for path in cards if output_file.is_unchanged_page(path)), None)
    return b"" if page is None else regular_file.read_bytes(page, output_file.MAX_PAGE_BYTES)


def needs(bundle: "Bundle", paths: Sequence[str], output: str) -> None:
    """UserError, naming the `output` of the recipe, unless the bundle holds all datasets of `paths`."""
    if missing := [path for path in paths if path not in bundle]:
        raise UserError(f"{bundle.path}: has no {missing[0]}: the recipe's outputs need {output}")


def needs_package(kind: str, package: str) -> ModuleType:
    """The `package` that writes a format, which an extra named after it brings. UserError if it is missing."""
    try:
        return import_module(package.lower())
    except ImportError:
        raise UserError(f"export {kind} needs {package}: pip install 'tacgen[{kind}]'") from None


def needs_image(bundle: "Bundle", reader: str) -> None:
    """UserError, naming the `reader` of the format, unless the images have the size of IMAGE."""
    if bundle.shapes["/frames/rgb"][1:] != IMAGE:
        size = " x ".join(map(str, bundle.shapes["/frames/rgb"][1:3]))
        raise UserError(f"{bundle.path}: {reader} takes images of {IMAGE[0]} x {IMAGE[1]} pixels, these have {size}")


def names(bundles: "Sequence[Bundle]") -> list[str]:
    """A unique name for each bundle: that of its file, preceded by as many folder names as needed."""
    paths = [bundle.path.with_suffix("") for bundle in bundles]
    parts = [(*p.relative_to(p.anchor).parts, *b.group.split("/")[1:]) for p, b in zip(paths, bundles, strict=True)]
    parts = [tuple(filter(None, part)) for part in parts]
    for depth in range(1, max(map(len, parts)) + 1):
        unique = ["-".join(part[-depth:]) for part in parts]
        if len(set(unique)) == len(unique):
            break
    return unique


def npy(content: "np.ndarray | Mapping[str, Any]") -> bytes:
    """An array, or a pickled dictionary of arrays, as the bytes of an .npy file."""
    import numpy as np

    file = io.BytesIO()
    np.save(file, content, allow_pickle=True)  # type: ignore[arg-type]  # its stub takes arrays alone
    return file.getvalue()


def poses(matrices: "np.ndarray") -> "np.ndarray":
    """(N, 4, 4) -> (N, 7): x y z [mm], quaternion w x y z with w >= 0."""
    import numpy as np
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(matrices[:, :3, :3]).as_quat(canonical=True, scalar_first=True)
    return np.hstack([matrices[:, :3, 3], turn])
