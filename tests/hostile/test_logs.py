"""Logs for `tacgen replay`: damaged and crafted ones end in a line, soon, and nothing outside of the file is read."""

import io
import json
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from helpers.small_recipe import BALL

from hostile import attempts
from tacgen import replay
from tacgen.base import csv_table
from tacgen.base.errors import UserError
from tacgen.recipe import plan
from tacgen.replay import log_file
from tacgen.replay.contact_log import Conventions

N = 4
HOW = Conventions("tacgen", "wxyz", "mm")


def arrays() -> dict[str, Any]:
    return {name: values for name, values in attempts.log_arrays().items() if not isinstance(values, str)}


def npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def archive(path: Path, how: int = zipfile.ZIP_DEFLATED, **changed: bytes) -> Path:
    """An npz file; `changed` are the bytes of entries."""
    with zipfile.ZipFile(path, "w", how) as file:
        for name, values in arrays().items():
            file.writestr(f"{name}.npy", changed.get(name, npy(values)))
    return path


def header(text: str) -> bytes:
    """An array of the first version of the format with this header."""
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode() + bytes(64)


def flipped(path: Path, name: str) -> None:
    """Spoil the compressed bytes of an entry."""
    with zipfile.ZipFile(path) as file:
        info = file.getinfo(f"{name}.npy")
    data = bytearray(path.read_bytes())
    start = info.header_offset + 30 + len(info.filename)
    data[start : start + info.compress_size] = b"\xff" * info.compress_size
    path.write_bytes(data)


def marked(path: Path, at: int, value: int) -> None:
    """Change 2 bytes of each local and central head of a zip file, `at` as of the local one."""
    data = bytearray(path.read_bytes())
    for sign, shift in ((b"PK\x03\x04", 0), (b"PK\x01\x02", 2)):
        place = data.find(sign)
        while place >= 0:
            data[place + at + shift : place + at + shift + 2] = value.to_bytes(2, "little")
            place = data.find(sign, place + 4)
    path.write_bytes(data)


WHOLE = "{'descr': '<f8', 'fortran_order': False, 'shape': "
HEADERS = {
    "cut short": f"{WHOLE}(",
    "of quotes": "{'descr': '''",
    "of brackets": "(" * 9000,
    "of a shape beyond numbers": f"{WHOLE}({10**30},)}}",
    "of a shape beyond memory": f"{WHOLE}({10**15},)}}",
    "of a shape of texts": f"{WHOLE}('a',)}}",
    "of a type that is none": "{'descr': [('a', ('b', {}))], 'fortran_order': False, 'shape': (4,)}",
}
ARCHIVES: dict[str, Callable[[Path], Any]] = {
    **{f"a header {name}": lambda path, text=text: archive(path, time=header(text)) for name, text in HEADERS.items()},
    "deflate that is none": lambda path: flipped(archive(path), "time"),
    "lzma that is none": lambda path: flipped(archive(path, zipfile.ZIP_LZMA), "time"),
    "bzip2 that is none": lambda path: flipped(archive(path, zipfile.ZIP_BZIP2), "time"),
    "an encrypted entry": lambda path: marked(archive(path), 6, 1),
    "a compression that nobody knows": lambda path: marked(archive(path), 8, 77),
    "an empty entry": lambda path: archive(path, time=b""),
    "a pickle": lambda path: archive(path, time=npy(np.array([{"a": 1}], object))),
    "an empty file": lambda path: path.write_bytes(b""),
    "an array that is no archive": lambda path: path.write_bytes(npy(np.zeros(3))),
    "numbers beyond use": lambda path: archive(path, force=npy(np.full((N, 3), 1e308))),
    "positions beyond use": lambda path: archive(path, object_position=npy(np.full((N, 3), 1e306))),
    "quaternions beyond use": lambda path: archive(path, object_quaternion=npy(np.full((N, 4), 1e200))),
}


def refused(path: Path, note: Path, how: Conventions = HOW) -> None:
    """A child with little memory and time reads the log, and says why it cannot in a line that names the file."""

    def read() -> str:
        with pytest.raises(UserError) as caught:
            log_file.read(path, how)
        assert len(caught.value.lines) == 1
        assert caught.value.lines[0].startswith(f"{path}: ")
        assert not caught.value.lines[0].endswith(": ")
        return "accepted"

    found = attempts.contained(read, note)
    assert found == "accepted", (found, note.read_text() if note.exists() else "")


@pytest.mark.parametrize("name", ARCHIVES)
def test_crafted_archives_are_refused_in_a_line(tmp_path: Path, name: str) -> None:
    ARCHIVES[name](path := tmp_path / "log.npz")
    refused(path, tmp_path / "note")


def hdf5(path: Path) -> Path:
    with h5py.File(path, "w") as file:
        for name, values in arrays().items():
            file[name] = values
        file["units"] = "mm"  # in a heap
        file["group/other"] = 1.0
    return path


def _zeroed(path: Path) -> None:
    data = bytearray(path.read_bytes())
    at = data.index(b"GCOL")
    data[at + 16 : at + 200] = bytes(184)
    path.write_bytes(data)


def _pipe(path: Path) -> str:
    os.mkfifo(place := path.with_name("pipe.h5"))
    return str(place)


def _virtual(file: Any) -> None:
    layout = h5py.VirtualLayout((N,), "f8")
    layout[...] = h5py.VirtualSource("/etc/passwd", "time", (N,))
    file.create_virtual_dataset("time", layout)


ELSEWHERE = [("/etc/passwd", 0, h5py.h5f.UNLIMITED)]
FILES: dict[str, Callable[[Path], Any]] = {
    "a zeroed heap": _zeroed,
    "nothing at all": lambda path: path.write_bytes(b""),
    "no HDF5": lambda path: path.write_bytes(b"time,x\n"),
}
# in the place of an array
ARRAYS: dict[str, Callable[[Any], Any]] = {
    "a link to a pipe": lambda f: f.update({"time": h5py.ExternalLink(_pipe(Path(f.filename)), "/time")}),
    "a loop of links": lambda f: f.update({"time": h5py.SoftLink("/loop"), "loop": h5py.SoftLink("/time")}),
    "a link to nothing": lambda f: f.update({"time": h5py.SoftLink("/nothing")}),
    "numbers of another file": lambda f: f.create_dataset("time", (N,), "f8", external=ELSEWHERE),
    "force of another file": lambda f: f.create_dataset("force", (N, 3), "u1", external=ELSEWHERE),
    "a view of another file": _virtual,
    "references": lambda f: f.create_dataset("time", data=f.ref, dtype=h5py.ref_dtype),
    "rows of all lengths": lambda f: f.create_dataset("time", (N,), dtype=h5py.vlen_dtype("f8")),
    "more than is stored": lambda f: f.create_dataset("time", (10**11,), "f8", chunks=(1000,), compression="gzip"),
    "no numbers": lambda f: f.create_dataset("time", data=np.zeros(N, [("a", "f8")])),
    "a group": lambda f: f.create_group("time"),
}


@pytest.mark.parametrize("name", [*FILES, *ARRAYS])
def test_crafted_hdf5_is_refused_in_a_line(tmp_path: Path, name: str) -> None:
    path = hdf5(tmp_path / "log.h5")
    if name in FILES:
        FILES[name](path)
    else:
        with h5py.File(path, "a") as file:
            del file["force" if name.startswith("force") else "time"]
            ARRAYS[name](file)
    refused(path, tmp_path / "note")


def test_a_group_of_a_log_is_in_the_file_itself(tmp_path: Path) -> None:
    with h5py.File(hdf5(tmp_path / "log.h5"), "a") as file:
        file["elsewhere"] = h5py.ExternalLink(_pipe(tmp_path / "log.h5"), "/")
    for group in ("elsewhere", "time", "nothing", "group/nothing"):
        refused(tmp_path / "log.h5", tmp_path / "note", Conventions("tacgen", "wxyz", "mm", group=group))


def test_what_no_log_has_may_be_anything(tmp_path: Path) -> None:
    """Other arrays of the file are not read."""
    with h5py.File(hdf5(tmp_path / "log.h5"), "a") as file:
        file["other"], file["loop"] = h5py.SoftLink("/loop"), h5py.ExternalLink(_pipe(tmp_path / "x"), "/a")
        file.create_dataset("object", data=file.ref, dtype=h5py.ref_dtype)
    with zipfile.ZipFile(archive(tmp_path / "log.npz"), "a") as file:
        file.writestr("camera.npy", header("{'"))
    for kind in ("h5", "npz"):
        (log,) = log_file.read(tmp_path / f"log.{kind}", HOW)
        assert log.time == pytest.approx(arrays()["time"])


@pytest.mark.parametrize("kind", ["npz", "h5"])
def test_texts_may_be_bytes(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"log.{kind}"
    said = {"units": np.bytes_(b"m"), "quaternion": np.bytes_(b"xyzw")}
    if kind == "npz":
        np.savez(path, **arrays() | said | {"object_quaternion": np.tile([0, 0, 0, 1.0], (N, 1))})
    else:
        with h5py.File(path, "w") as file:
            file.update(arrays() | said | {"object_quaternion": np.tile([0, 0, 0, 1.0], (N, 1))})
    (log,) = log_file.read(path, Conventions())
    assert log.body[0, 2, 3] == pytest.approx(6000.0)


@pytest.mark.parametrize("row", ["0,0,0,1,1,0,0,0,0,0,1e308", "1e308,0,0,1,1,0,0,0,0,0,0", "0,0,0,\0,1,0,0,0,0,0,0"])
def test_tables_of_numbers_beyond_use_are_refused(tmp_path: Path, row: str) -> None:
    (tmp_path / "log.csv").write_text(f"{attempts.LOG_TABLE.splitlines()[0]}\n{row}\n")
    refused(tmp_path / "log.csv", tmp_path / "note", Conventions())


def test_a_nul_is_no_text_in_any_table(tmp_path: Path) -> None:
    (tmp_path / "presses.csv").write_bytes(b"file,force_n\npress\0.png,1\n")
    wrong: list[str] = []
    assert csv_table.rows(tmp_path / "presses.csv", ("file",), ("force_n",), wrong) == []
    assert wrong == [f"{tmp_path / 'presses.csv'}: is not a text file (UTF-8)"]
    assert np.isnan(csv_table.number("1e308"))


@pytest.mark.parametrize(
    "name", ["\N{GRINNING FACE} é", "two\nlines", "a\u2028b\x85c\x7fd", "$\\bad$ {x} 50%", '"quoted"']
)
def test_names_of_logs_and_recipes_are_any(tmp_path: Path, name: str) -> None:
    (here := tmp_path / name).mkdir()
    (recipe := here / f"{name}.yaml").write_text(f"{BALL}outputs: [force]\ntrajectory: [{{replay: {{file: x.csv}}}}]\n")
    path = archive(here / f"{name}.npz")
    made = replay.prepare([path], str(recipe), here / "out", HOW, replay.Choice())
    (row,) = plan.load(made.recipe).rows
    assert row.frames == len(made.logs[0])
    assert made.logs[0].name.isprintable()
    assert json.loads(json.dumps(row.document()))["trajectory"]


def test_a_name_that_is_no_text_is_refused(tmp_path: Path) -> None:
    here = Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff\xfe"))
    here.mkdir()
    (recipe := here / "r.yaml").write_text(f"{BALL}outputs: [force]\ntrajectory: [{{replay: {{file: x.csv}}}}]\n")
    with pytest.raises(UserError, match="is no text"):
        replay.prepare([archive(here / "a.npz")], str(recipe), here / "out", HOW, replay.Choice())
