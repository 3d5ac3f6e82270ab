"""Bundles in the formats of other tools, read back by those tools where they are installed."""

from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from helpers.command import refused, tacgen_, told
from helpers.needs import needs
from helpers.synthetic import write

from tacgen import export as exporting
from tacgen.base.errors import UserError
from tacgen.bundle.bundle import read
from tacgen.cli import main as cli
from tacgen.export import EXPORTERS, export

Array = np.ndarray


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A folder with a finished scene, another of the same name, and a rejected one."""
    for name in ("one", "two"):
        write(tmp_path / "in" / name / "scene.h5", edit=_tell_components_apart)
    write(tmp_path / "in" / "none" / "scene.h5", stop=3)
    return tmp_path / "in"


def _tell_components_apart(index: int, arrays: dict[str, Array]) -> None:
    arrays["/fields/nodal_stress"] = np.arange(48.0).reshape(8, 6) + 100 * index
    arrays["/fields/cauchy_stress"] = np.arange(6.0)[None] + 10 * index


@pytest.fixture
def vtkhdf(source: Path, tmp_path: Path) -> Path:
    return export("vtkhdf", source / "one", tmp_path / "x.vtkhdf")[0]


def test_the_command_writes_a_file_a_scene(source: Path, tmp_path: Path) -> None:
    made = [tmp_path / "out" / f"{name}-scene.vtkhdf" for name in ("one", "two")]
    assert told("export", "vtkhdf", source, "-o", tmp_path / "out", "--merge").split() == [*map(str, made)]
    assert sorted((tmp_path / "out").glob("[!.]*")) == made


def test_the_help_names_every_format() -> None:
    """From a text of its own: the formats' table imports what starts slowly."""
    assert sorted(cli.EXPORT_FORMATS.replace(" or ", ", ").split(", ")) == sorted(EXPORTERS)


def test_what_cannot_be_exported_is_reported_in_one_line(source: Path, tmp_path: Path) -> None:
    for args, words in (
        (("excel", source), f"excel: unknown format; there are: {', '.join(EXPORTERS)}"),
        (("vtkhdf", tmp_path / "no"), "no such file or folder"),
        (("vtkhdf", source / "none"), "no finished scene to export"),
    ):
        (line,) = refused("export", *args, "-o", tmp_path / "out").splitlines()
        assert words in line
    bare = write(tmp_path / "bare.h5", outputs=frozenset({"force"}))
    with pytest.raises(UserError, match="has no /mesh/points: the recipe's outputs need stress"):
        export("vtkhdf", bare, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_vtkhdf_is_laid_out_as_specified_in_the_same_bytes(vtkhdf: Path, source: Path, tmp_path: Path) -> None:
    assert export("vtkhdf", source / "one", tmp_path / "y.vtkhdf")[0].read_bytes() == vtkhdf.read_bytes()
    bundle = read(source / "one" / "scene.h5")
    with h5py.File(vtkhdf) as file:
        root = file["VTKHDF"]
        assert root.attrs["Type"] == b"UnstructuredGrid"
        assert h5py.h5a.open(root.id, b"Type").get_type().get_cset() == h5py.h5t.CSET_ASCII
        assert tuple(root.attrs["Version"]) == (2, 2)
        assert root["Connectivity"].shape == (8,)
        assert root["Offsets"][:].tolist() == [0, 8]
        assert root["Types"][:].tolist() == [12]
        assert root["Steps"].attrs["NSteps"] == bundle.frames
        assert np.array_equal(root["Points"], bundle["/mesh/points"])
        assert np.array_equal(root["PointData/displacement"], bundle["/fields/displacement"].reshape(-1, 3))
        voigt = bundle["/fields/nodal_stress"].reshape(-1, 6)
        assert np.array_equal(root["PointData/stress"], voigt[:, [0, 1, 2, 5, 3, 4]])
        assert root["Steps/PointDataOffsets/displacement"][:].tolist() == [8 * k for k in range(bundle.frames)]


def test_vtk_reads_every_step(vtkhdf: Path, source: Path) -> None:
    """Points, cells, displacement, and both stresses with VTK's own names of the components."""
    needs("vtk")
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOHDF import vtkHDFReader

    bundle = read(source / "one" / "scene.h5")
    reader = vtkHDFReader()
    reader.SetFileName(str(vtkhdf))
    reader.UpdateInformation()
    assert reader.GetNumberOfSteps() == bundle.frames
    for k in range(bundle.frames):
        reader.SetStep(k)
        reader.Update()
        grid = reader.GetOutputAsDataSet()
        assert grid.GetCellType(0) == 12
        assert [grid.GetCell(0).GetPointId(i) for i in range(8)] == bundle["/mesh/cells"][0].tolist()
        assert vtk_to_numpy(grid.GetPoints().GetData()) == pytest.approx(bundle["/mesh/points"])
        found = {name: vtk_to_numpy(grid.GetPointData().GetArray(name)) for name in ("displacement", "stress")}
        assert (found["displacement"] == bundle.frame("/fields/displacement", k)).all()
        xx, yy, zz, yz, xz, xy = bundle.frame("/fields/nodal_stress", k).T
        assert (found["stress"] == np.stack([xx, yy, zz, xy, yz, xz], 1)).all()
        assert vtk_to_numpy(grid.GetCellData().GetArray("cauchy_stress"))[0, 3] == 5 + 10 * k
        assert vtk_to_numpy(grid.GetCellData().GetArray("layer")).tolist() == [0]


def test_splits_without_scenes_are_told(source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Scores over them would be nan; formats that divide are those whose module knows the splits."""
    package = Path(exporting.__file__).parent
    texts = {kind: (package / f"{kind}.py").read_text() for kind in EXPORTERS}
    divided = {kind for kind, text in texts.items() if "bundle.splits import" in text or "split_ranges" in text}
    assert divided == set(exporting.SPLIT_FORMATS)
    monkeypatch.setattr(exporting, "import_module", lambda _: SimpleNamespace(write=lambda bundles, out: []))
    for kind in ("zarr", "vtkhdf"):
        done = tacgen_("export", kind, source, "-o", tmp_path / kind, "--merge")
        said = "warning: no scene for the split val and test, of 2: make more before scores are compared\n"
        assert (done.exit_code, done.stderr) == (0, said if kind == "zarr" else ""), done.output
