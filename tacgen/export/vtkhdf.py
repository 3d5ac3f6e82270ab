"""ParaView: an UnstructuredGrid over time in a VTKHDF file; the rest mesh is stored once, the fields for each frame.

    https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/vtkhdf_specifications.html

Points are the rest positions; `Warp By Vector` with `displacement` shows the deformed gel. Time is the frame's number.
VTK's symmetric tensors are in the order xx yy zz xy yz xz, not in the bundle's.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base import atomic_file
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.hdf5_file import written_file
from tacgen.export import names, needs

SUFFIX = ".vtkhdf"
VTKHDF_VERSION = (2, 2)  # the first version with time steps on a static mesh; read by ParaView since 5.13
CELL_TYPES = {8: 12, 4: 10, 10: 24}  # nodes -> VTK_HEXAHEDRON, VTK_TETRA, VTK_QUADRATIC_TETRA
VTK_TENSOR_ORDER = (0, 1, 2, 5, 3, 4)  # of xx yy zz yz xz xy
NEEDED_VTK_DATASETS = ("/mesh/points", "/mesh/cells", "/mesh/layer", "/fields/displacement")
VTK_FIELDS = (  # dataset of the bundle, name and location in VTK
    ("/fields/displacement", "displacement", "PointData"),
    ("/fields/nodal_stress", "stress", "PointData"),
    ("/fields/cauchy_stress", "cauchy_stress", "CellData"),
)


def write(bundles: Sequence[Bundle], out: Path) -> list[Path]:
    """One file a bundle: `out` itself if it ends in SUFFIX, otherwise <name>.vtkhdf in it."""
    for bundle in bundles:
        needs(bundle, NEEDED_VTK_DATASETS, "stress")
    made = [out] if out.suffix == SUFFIX else [out / f"{name}{SUFFIX}" for name in names(bundles)]
    for bundle, path in zip(bundles, made, strict=True):
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file.published(path) as sink, written_file(sink) as file:
            _fill(file.create_group("VTKHDF", track_order=False), bundle)
    return made


def _fill(root: Any, bundle: Bundle) -> None:
    """The group VTKHDF: mesh, data of points and cells, and where in each of them a step begins."""
    points, cells, layer = bundle["/mesh/points"], bundle["/mesh/cells"], bundle["/mesh/layer"]
    count, corners = cells.shape
    root.attrs["Version"] = np.array(VTKHDF_VERSION, "<i8")
    root.attrs["Type"] = np.bytes_("UnstructuredGrid")
    _put(root, "NumberOfPoints", np.array([len(points)]))
    _put(root, "NumberOfCells", np.array([count]))
    _put(root, "NumberOfConnectivityIds", np.array([cells.size]))
    _put(root, "Points", points)
    _put(root, "Connectivity", cells.astype("<i8").ravel())
    _put(root, "Offsets", corners * np.arange(count + 1))
    _put(root, "Types", np.full(count, CELL_TYPES[corners], "u1"))

    steps = root.create_group("Steps")
    still = np.zeros(bundle.frames, "<i8")
    steps.attrs["NSteps"] = np.int64(bundle.frames)
    _put(steps, "Values", np.arange(float(bundle.frames)))
    for name in ("PartOffsets", "PointOffsets"):
        _put(steps, name, still)
    _put(steps, "NumberOfParts", still + 1)
    for name in ("CellOffsets", "ConnectivityIdOffsets"):
        _put(steps, name, still[:, None])

    for where in ("PointData", "CellData"):
        root.create_group(where)
        steps.create_group(f"{where}Offsets")
    for name, vtk_name, where in VTK_FIELDS:
        if name in bundle:
            each, order = bundle.shapes[name][1], VTK_TENSOR_ORDER if bundle.shapes[name][2] == 6 else slice(None)
            frames = (bundle.frame(name, k)[:, order] for k in range(bundle.frames))
            _stack(root[where], vtk_name, frames, bundle.frames)
            _put(steps[f"{where}Offsets"], vtk_name, each * np.arange(bundle.frames))
    _put(root["CellData"], "layer", layer)
    _put(steps["CellDataOffsets"], "layer", still)


def _put(group: Any, name: str, values: np.ndarray) -> None:
    group.create_dataset(name, data=values, track_times=False)


def _stack(group: Any, name: str, frames: Iterable[np.ndarray], count: int) -> None:
    """The frames (n, c) one below the other, a chunk each; never two of them in memory."""
    data = None
    for k, values in enumerate(frames):
        n, c = values.shape
        if data is None:
            data = group.create_dataset(
                name, (count * n, c), values.dtype, chunks=(n, c), compression="gzip", compression_opts=1, shuffle=True,
                track_times=False,
            )  # fmt: skip
        data[k * n : (k + 1) * n] = values
