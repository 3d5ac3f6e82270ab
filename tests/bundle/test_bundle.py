"""Bundles: what is written is read, whole or not at all."""

import errno
import os
import pickle
import re
import resource
import time
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
import pytest
from helpers.killing import WRITES, calls
from helpers.synthetic import attributes, write
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tacgen.base import atomic_file
from tacgen.base.errors import UserError
from tacgen.bundle import schema
from tacgen.bundle.bundle import Unfinished, Writer, complete, read
from tacgen.bundle.check import check
from tacgen.bundle.chunks import rounded
from tacgen.bundle.hdf5_file import Damaged, add_attributes, attributes_of
from tacgen.outputs import LAYOUT

MAPS = ("/frames/normals", "/frames/radiance")
KEY = attributes()["input_key"]
QUICK = settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def random_array(rng: np.random.Generator, path: str, shape: tuple[int, ...], most: int) -> np.ndarray:
    kind = np.dtype(LAYOUT[path].dtype)
    if kind.kind == "f":
        return rounded(path, rng.normal(size=shape).astype(kind))
    return rng.integers(0, 2 if kind.kind == "b" else most, shape).astype(kind)


@st.composite
def contents(draw: st.DrawFn) -> tuple[int, int, dict[str, np.ndarray]]:
    """(frames planned, frames written, arrays by path), any part of the layout with a force, at any size."""
    planned = draw(st.integers(1, 4))
    written = draw(st.integers(0, planned))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    sizes = {name: draw(st.integers(0 if name == "*" else 1, 5)) for name in "HWhwMnmk*"} | {"N": written}
    sizes |= {"4|8|10": draw(st.sampled_from([4, 8, 10])), "3|4|6": draw(st.sampled_from([3, 4, 6]))}
    paths = draw(st.sets(st.sampled_from(sorted(LAYOUT)))) | {"/frames/force"}
    paths |= {"/mesh/points", "/mesh/surface/points"} if any(LAYOUT[path].below for path in paths) else set()
    arrays = {}
    for path in paths:
        shape = tuple(sizes[d] if isinstance(d, str) else d for d in LAYOUT[path].dims)
        name = path.replace("*", draw(st.sampled_from(["coated", "bonded"])))
        arrays[name] = random_array(rng, path, shape, sizes.get(LAYOUT[path].below, 100))
    return planned, written, arrays


@QUICK
@given(
    contents(), st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9), st.integers(0, 2**64 - 1)
)
def test_what_is_written_is_read(tmp_path: Path, content: tuple, text: str, seed: int) -> None:
    planned, written, arrays = content
    framed = {p: a for p, a in arrays.items() if p.startswith(("/frames/", "/fields/"))}
    path = tmp_path / "x.h5"
    with Writer(path, attributes(solver=text, seed=seed), planned) as writer:
        for name in arrays.keys() - framed.keys():
            writer.put(name, arrays[name])
        for k in range(written):
            writer.append({name: a[k] for name, a in framed.items()})
        if written == planned:
            writer.finish()
        else:
            writer.finish("rejected", f"frame {written} of {planned}: no")
    found = read(path)
    assert found.attrs["solver"] == text
    assert found.attrs["seed"] == seed
    assert found.recipe == attributes()["recipe"]
    assert set(found.shapes) == {name for name in arrays if name not in framed or written}
    for name in found.shapes:
        assert found[name].dtype == arrays[name].dtype
        np.testing.assert_array_equal(found[name], arrays[name])
    if framed and written:
        assert found.frames == written
        name = min(framed)
        np.testing.assert_array_equal(found.frame(name, written - 1), arrays[name][-1])
    assert complete(path, KEY)
    assert not complete(path, "another key")
    assert os.listdir(tmp_path) == ["x.h5"]


def test_the_same_inputs_give_the_same_bytes(tmp_path: Path) -> None:
    first = write(tmp_path / "a.h5").read_bytes()
    time.sleep(1.1)  # HDF5's time stamps count whole seconds
    assert write(tmp_path / "elsewhere" / "b.h5").read_bytes() == first
    assert write(tmp_path / "c.h5", seed=8).read_bytes() != first


def test_any_hdf5_reads_it_and_every_dataset_says_what_it_is(tmp_path: Path) -> None:
    with h5py.File(write(tmp_path / "x.h5")) as file:
        force = file["frames/force"]
        assert dict(force.attrs) == {"units": "N", "long_name": "force on the gel", "axes": "frame xyz"}
        assert file["frames/rgb"].chunks == (1, *file["frames/rgb"].shape[1:])
        assert file["frames/rgb"].compression == "gzip"
        assert file["frames/rgb"].shuffle
        assert file["frames/pressure"].attrs["rounding"] == "13 bits"
        assert file["frames/height"].attrs["rounding"] == "multiples of 2^-16"
        ours = read(tmp_path / "x.h5")
        for path in ours.shapes:  # by HDF5's own inflater, and by ours: of each dataset and of each frame
            np.testing.assert_array_equal(file[path][()], ours[path])
            if path.startswith(("/frames", "/fields")):
                np.testing.assert_array_equal(file[path][7], ours.frame(path, 7))


def test_attributes_are_stored_and_found_as_h5py_does(tmp_path: Path) -> None:
    ours = {"text": "\N{GREEK SMALL LETTER MU}", "none": "", "count": 3, "seed": 2**64 - 1, "part": 0.5, "whole": True}
    others = {"bytes": np.bytes_("ab"), "list": ["a", "b"], "row": np.arange(3.0), "empty": h5py.Empty("f8")}
    with h5py.File(tmp_path / "x.h5", "w") as file:
        add_attributes(file.id, ours)
        kinds = {name: file.attrs.get_id(name).get_type() for name in ours}
        assert dict(file.attrs) == ours
        file.attrs.update(ours)
        assert {name: file.attrs.get_id(name).get_type() for name in ours} == kinds
        file.attrs.update(others)
        file.attrs["no text"] = h5py.Empty(h5py.string_dtype())
        found = attributes_of(file)
        assert list(found) == list(file.attrs)
        for name, value in file.attrs.items():
            assert type(found[name]) is type(value)
            assert found[name] is value or np.array_equal(found[name], value)


def test_components_of_a_map_lie_apart(tmp_path: Path) -> None:
    rng, many = np.random.default_rng(3), (5, 40, 50, 3)
    normals, radiance = (rounded(path, rng.normal(size=many).astype("f4")) for path in MAPS)
    with Writer(tmp_path / "x.h5", attributes(), 5) as writer:
        for pair in zip(normals, radiance, strict=True):
            writer.append(dict(zip(MAPS, pair, strict=True)))
        writer.finish()
    with h5py.File(tmp_path / "x.h5") as file:
        assert file["frames/normals"].chunks == (1, 40, 50, 1)
        np.testing.assert_array_equal(file["frames/normals"][()], normals)
        np.testing.assert_array_equal(file["frames/radiance"][3, ..., 1], radiance[3, ..., 1])
    np.testing.assert_array_equal(read(tmp_path / "x.h5")["/frames/normals"], normals)
    np.testing.assert_array_equal(read(tmp_path / "x.h5").frame("/frames/radiance", 2), radiance[2])


def test_an_array_may_be_used_again_once_it_is_appended(tmp_path: Path) -> None:
    force, height = np.zeros(3), np.zeros((64, 64), "f4")
    with Writer(tmp_path / "x.h5", attributes(), 6) as writer:
        for _ in range(6):
            force += 1
            height += 0.5
            writer.append({"/frames/force": force, "/frames/height": height})
        writer.finish()
    found = read(tmp_path / "x.h5")
    assert found["/frames/force"][:, 0].tolist() == [1, 2, 3, 4, 5, 6]
    assert found["/frames/height"][:, 5, 5].tolist() == [0.5, 1, 1.5, 2, 2.5, 3]
    found.verify()


def test_a_bundle_whose_chunks_hdf5_packed_is_read(tmp_path: Path) -> None:
    """As h5py writes it, and an earlier tacgen did: unsplit, not rounded, with fletcher32."""
    path = write(tmp_path / "x.h5")
    with h5py.File(path, "a") as file:
        old = file["frames/height"]
        values, attrs = old[()], {name: value for name, value in old.attrs.items() if name != "rounding"}
        del file["frames/height"]
        new = file.create_dataset("frames/height", data=values, chunks=(1, *values.shape[1:]), compression="gzip",
                                  shuffle=True, fletcher32=True)  # fmt: skip
        new.attrs.update(attrs)
    np.testing.assert_array_equal(read(path)["/frames/height"], values)
    np.testing.assert_array_equal(read(path).frame("/frames/height", 3), values[3])
    with pytest.raises(UserError, match="digest"):  # of which the attribute is a part
        read(path).verify()


def test_a_bundle_pickles_and_points_out_a_dataset_named_as_in_h5py(tmp_path: Path) -> None:
    found = pickle.loads(pickle.dumps(read(write(tmp_path / "x.h5"))))
    assert found["/frames/force"].shape == (12, 3)
    assert found.segments == ("press",) * 4 + ("slide",) * 3 + ("hold",) * 2 + ("twist",) * 3
    with pytest.raises(KeyError, match="has no frames/force, did you mean /frames/force"):
        found["frames/force"]


# -- a writer that dies ------------------------------------------------------------------------------------------------


def test_a_killed_writer_leaves_nothing_that_looks_whole(tmp_path: Path) -> None:
    """Killed at some calls to the disk from first to last: the last ones sync, rename and sync the folder."""
    whole = write(tmp_path / "whole.h5", outputs=frozenset({"force", "rgb"})).read_bytes()

    def run(folder: Path, moment: int) -> int | None:
        folder.mkdir(parents=True)
        return calls(lambda: write(folder / "x.h5", outputs=frozenset({"force", "rgb"})), moment, WRITES)

    count = run(tmp_path / "k" / "0", 0) or 0
    for moment in {*range(1, count, count // 12), *range(count - 4, count + 1)}:
        assert run(tmp_path / "k" / str(moment), moment) is None
    folders = sorted((tmp_path / "k").iterdir(), key=lambda p: int(p.name))[1:]
    assert len(folders) > 15
    for folder in folders[:-1]:
        (left,) = folder.iterdir()
        assert atomic_file.is_part(left)
        assert [f.level for f in check(folder)] == ["incomplete"]
        assert not complete(folder / "x.h5", KEY)
        renamed = left.rename(folder / "y.h5")  # as a person might
        assert not complete(renamed, KEY) or renamed.read_bytes() == whole
        renamed.rename(left)
        with Writer(folder / "z.h5", attributes(), 1):  # the next writer sweeps
            assert not left.exists()
    assert (folders[-1] / "x.h5").read_bytes() == whole, "killed when only the folder was left to sync"


def test_files_of_users_whose_names_resemble_remains_are_not_swept(tmp_path: Path) -> None:
    mine, remains = ({tmp_path / name for name in names} for names in (
        ("notes.tacgen-claim", "x.tacgen-part-a", "tacgen-part-1"), (".x.h5.tacgen-claim", "x.h5.tacgen-part-1")
    ))  # fmt: skip
    for path in mine | remains:
        path.touch()
    assert set(atomic_file.sweep(tmp_path)) == remains
    assert set(tmp_path.iterdir()) == mine


def test_a_living_writer_is_not_swept_and_not_joined(tmp_path: Path) -> None:
    with Writer(tmp_path / "x.h5", attributes(), 1) as first:
        write(tmp_path / "y.h5")
        assert sorted(os.listdir(tmp_path)) == [f"x.h5.tacgen-part-{os.getpid()}", "y.h5"]
        with pytest.raises(UserError, match="another writer"), Writer(tmp_path / "x.h5", attributes(), 1):
            pass
        first.append({"/frames/force": [1, 2, 3]})
        first.finish()
    assert read(tmp_path / "x.h5").frames == 1


def test_leaving_without_finish_keeps_what_was_there(tmp_path: Path) -> None:
    before = write(tmp_path / "x.h5").read_bytes()
    with pytest.raises(ZeroDivisionError), Writer(tmp_path / "x.h5", attributes(), 1):
        _ = 1 / 0
    with Writer(tmp_path / "x.h5", attributes(), 1):
        pass
    assert os.listdir(tmp_path) == ["x.h5"]
    assert (tmp_path / "x.h5").read_bytes() == before


# -- a disk that is full -----------------------------------------------------------------------------------------------


@contextmanager
def file_size_limit(size: int):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("part", [0.0, 0.5, 0.999])
def test_a_file_that_may_not_grow(tmp_path: Path, part: float) -> None:
    size = write(tmp_path / "whole" / "x.h5").stat().st_size
    target = tmp_path / "full" / "x.h5"
    with file_size_limit(int(part * size)), pytest.raises(OSError, match="File too large") as caught:
        write(target)
    assert caught.value.errno == errno.EFBIG
    assert caught.value.filename == str(target)
    assert os.listdir(target.parent) == []


# -- a file that is not what it was ------------------------------------------------------------------------------------


def test_a_truncated_file_is_refused(tmp_path: Path) -> None:
    whole = write(tmp_path / "x.h5").read_bytes()
    for size in [0, 7, 8, 100, len(whole) // 2, len(whole) - 1]:
        (tmp_path / "x.h5").write_bytes(whole[:size])
        with pytest.raises(UserError) as caught:
            read(tmp_path / "x.h5").verify()
        assert len(caught.value.lines) == 1
        assert isinstance(caught.value, Damaged) == (size >= 8), "shorter, nobody can tell what it was"
        assert [f.level for f in check(tmp_path / "x.h5")] == ["error"]


def test_no_flipped_bit_goes_unseen(tmp_path: Path) -> None:
    """Where a flip falls into bytes that mean nothing, the file still reads as it was; anywhere else it is refused."""
    path = write(tmp_path / "x.h5", shape=(16, 16))
    whole, digest = path.read_bytes(), read(path).attrs["digest"]
    rng = np.random.default_rng(0)
    refused = 0
    for bit in rng.integers(0, 8 * len(whole), 60):
        spoilt = bytearray(whole)
        spoilt[bit // 8] ^= 1 << (bit % 8)
        path.write_bytes(spoilt)
        try:
            found = read(path)
            found.verify()
        except UserError:
            refused += 1
        else:
            assert found.attrs["digest"] == digest, bit
    assert refused > 30


@pytest.mark.parametrize(
    ("attrs", "message"),
    [
        ({"tacgen_format": 2}, r"bundle format 2, written by tacgen .*; this tacgen reads up to 1"),
        ({"complete": False}, "unfinished: its writer was stopped"),
        ({"seed": "seven"}, "damaged: attribute 'seed' is 'seven', expected int"),
        ({"recipe": "{"}, "damaged"),
        ({"solver": "a better one"}, "its contents do not match its digest"),
        ({}, "its contents do not match its digest"),  # one number of the data, with a checksum that is right
    ],
)
def test_changed_attributes_or_data_are_refused(tmp_path: Path, attrs: dict, message: str) -> None:
    with h5py.File(write(tmp_path / "x.h5"), "a") as file:
        file.attrs.update(attrs)
        if not attrs:
            file["frames/force"][3, 2] += 1e-9
    with pytest.raises(UserError, match=message) as caught:
        read(tmp_path / "x.h5").verify()
    assert len(caught.value.lines) == 1
    assert isinstance(caught.value, Unfinished) == ("complete" in attrs)
    assert [f.level for f in check(tmp_path / "x.h5")] == ["incomplete" if "complete" in attrs else "error"]


def test_an_invalid_bundle_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "text.h5").write_text("hello")
    h5py.File(tmp_path / "other.h5", "w").close()
    what = {"text.h5": "not an HDF5 file", "other.h5": "an HDF5 file, but no tacgen bundle"}
    for name, message in {**what, "none.h5": "No such file or directory", ".": "Is a directory"}.items():
        with pytest.raises(UserError, match=message) as caught:
            read(tmp_path / name)
        assert caught.value.lines == (f"{tmp_path / name}: {message}",)


# -- a caller with a bug -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"/frames/force": np.zeros(2)}, r"/frames/force has shape \(1, 2\), expected \(N, 3\)"),
        ({"/frames/rgb": np.zeros((4, 4, 3))}, "Cannot cast"),
        ({"/frames/colour": 1}, "format 1 has no dataset /frames/colour"),
        ({"/mesh/points": np.zeros((1, 3))}, "put"),
        ({"/frames/pressure": np.zeros((2, 3)), "/frames/height": np.zeros((3, 2))}, "expected"),
    ],
)
def test_arrays_that_do_not_fit_the_layout(tmp_path: Path, arrays: dict, message: str) -> None:
    with Writer(tmp_path / "x.h5", attributes(), 2) as writer, pytest.raises((ValueError, TypeError), match=message):
        writer.append(arrays)


def test_a_scene_is_not_ok_before_its_last_frame(tmp_path: Path) -> None:
    with Writer(tmp_path / "x.h5", attributes(), 2) as writer:
        writer.append({"/frames/force": np.zeros(3)})
        for bad in [("ok", ""), ("rejected", ""), ("fine", "because")]:
            with pytest.raises(ValueError, match="1 of 2 frames"):
                writer.finish(*bad)
        with pytest.raises(ValueError, match="other datasets"):
            writer.append({"/frames/torque": np.zeros(3)})


@pytest.mark.parametrize("attrs", [{"colour": "red"}, {"scene_index": "0"}, {"complete": True}])
def test_attributes_outside_the_table(tmp_path: Path, attrs: dict) -> None:
    with pytest.raises(ValueError, match=next(iter(attrs))):
        Writer(tmp_path / "x.h5", attributes(**attrs), 1)


def test_a_folder_in_a_files_place_is_named_not_the_part_that_was_written(tmp_path: Path) -> None:
    place = tmp_path / "README.md"
    place.mkdir()
    with pytest.raises(IsADirectoryError) as caught:
        atomic_file.write(place, b"text")
    assert caught.value.filename == str(place)
    assert list(tmp_path.iterdir()) == [place]


@pytest.mark.parametrize(
    ("written", "stored"),
    [
        (b".$", b"U"),  # of each write
        (b"^\x78\x01..", b"\x78\x01ab"),  # a chunk
        (b"force on the gel", b"force in the gel"),  # an attribute of a dataset
        (b"a solver", b"o solver"),  # one of the scene
    ],
)
def test_a_disk_that_lies_is_found_out_before_the_bundle_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, written: bytes, stored: bytes
) -> None:
    real, lies = os.pwrite, re.compile(written, re.DOTALL)
    monkeypatch.setattr(atomic_file.os, "pwrite", lambda h, data, at: real(h, lies.sub(stored, data, 1), at))
    with pytest.raises(OSError, match="does not read back") as caught:
        write(tmp_path / "x.h5", solver="a solver")
    assert caught.value.errno == errno.EIO
    assert os.listdir(tmp_path) == []
    assert schema.BUNDLE_FORMAT == 1
