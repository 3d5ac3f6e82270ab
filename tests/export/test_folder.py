"""An export's folder holds that export and nothing else; whatever else is in its place is left alone."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers.export_scenes import SENSOR, SHAPE, needs_package_of, real
from helpers.killing import DISK, calls
from helpers.synthetic import OUTPUTS, write

from tacgen.base.errors import UserError
from tacgen.export import EXPORTERS, export


def scene(folder: Path, number: int, frames: int) -> Path:
    def edit(index: int, arrays: dict) -> None:
        real(index, arrays)
        arrays["/frames/radiance"] = arrays["/frames/rgb"] / 255

    known = {"scene_index": number, "sensor_document": SENSOR}
    return write(folder / f"scene-{number:05d}.h5", shape=SHAPE, outputs=OUTPUTS, frames=frames, edit=edit, **known)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders `one`, of a scene, and `two`, of another two; in `long` the same, as Sparsh takes no short ones."""
    folder = tmp_path_factory.mktemp("data")
    for place, frames in ((folder, 2), (folder / "long", 6)):
        scene(place / "one", 7, frames)
        for number in range(2):
            scene(place / "two", number, frames)
    return folder


def content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.slow
@pytest.mark.parametrize("kind", EXPORTERS)
def test_nothing_of_an_earlier_and_larger_export_stays(data: Path, tmp_path: Path, kind: str) -> None:
    needs_package_of(kind)
    data = data / "long" if kind == "sparsh" else data
    export(kind, data / "one", tmp_path / "fresh")
    export(kind, data / "two", tmp_path / "used")
    made = export(kind, data / "one", tmp_path / "used")
    used, fresh = content(tmp_path / "used"), content(tmp_path / "fresh")
    assert used.keys() == fresh.keys()
    assert used == fresh or kind == "rerun"  # which numbers its rows by the clock
    assert all(path.is_file() and path.is_relative_to(tmp_path / "used") for path in made)
    assert sorted(os.listdir(tmp_path)) == ["fresh", "used"]


@pytest.mark.parametrize("stranger", ["notes.txt", "train/mine.npy", "empty/", "normalization.npy"])  # the last edited
def test_a_folder_with_a_strangers_file_is_refused_and_stays(data: Path, tmp_path: Path, stranger: str) -> None:
    out = tmp_path / "out"
    export("feats", data / "one", out)
    if stranger.endswith("/"):
        (out / stranger).mkdir()
    elif (out / stranger).exists():
        exported = (out / stranger).read_bytes()
        (out / stranger).write_bytes(exported[:-1] + bytes([exported[-1] ^ 1]))  # of the same size
    else:
        (out / stranger).write_text("mine")
    before = content(out)
    with pytest.raises(UserError, match=stranger.rstrip("/").split("/")[-1]) as caught:
        export("feats", data / "two", out)
    assert len(caught.value.lines) == 1
    assert content(out) == before
    assert sorted(os.listdir(tmp_path)) == ["out"]


def test_a_folder_of_other_things_or_of_another_format_is_refused(data: Path, tmp_path: Path) -> None:
    (tmp_path / "tar").mkdir()
    (tmp_path / "tar" / "shard-000000.tar").write_bytes(b"a stranger's")
    (tmp_path / "list").mkdir()
    (tmp_path / "list" / ".tacgen-export.json").write_text('{"files": 7}')
    export("univtac", data / "one", tmp_path / "other")
    (tmp_path / "file").write_text("mine")
    says = {"tar": "shard-000000.tar", "other": "univtac", "file": "not a folder", "list": "damaged: kind"}
    for name, words in says.items():
        with pytest.raises(UserError, match=words):
            export("feats", data / "one", tmp_path / name)
    with pytest.raises(UserError, match="not empty"):
        export("feats", data / "one", Path("/"))
    assert (tmp_path / "tar" / "shard-000000.tar").read_bytes() == b"a stranger's"
    assert (tmp_path / "file").read_text() == "mine"
    assert sorted(os.listdir(tmp_path)) == ["file", "list", "other", "tar"]


@pytest.mark.slow
def test_killed_at_any_moment_it_leaves_a_whole_one_or_what_the_next_run_removes(data: Path, tmp_path: Path) -> None:
    def run(moment: int, out: Path) -> int | None:
        return calls(lambda: export("feats", data / "one", out), moment, [*DISK, (np, "save")])

    fresh, old = ({}, {})
    for name, found in (("one", fresh), ("two", old)):
        export("feats", data / name, tmp_path / name)
        found.update(content(tmp_path / name))
    export("feats", data / "two", tmp_path / "count" / "out")
    count = run(0, tmp_path / "count" / "out") or 0
    assert count > 10
    for moment in {1, count // 2, *range(count - 5, count + 1)}:
        out = shutil.copytree(tmp_path / "two", tmp_path / str(moment) / "out")
        assert run(moment, out) is None
        there = content(out) if out.exists() else None
        kept = [content(path) for path in out.parent.iterdir() if path.is_dir()]
        assert there in (fresh, old) or (there is None and old in kept), moment
        export("feats", data / "one", out)
        assert content(out) == fresh, moment
        assert os.listdir(out.parent) == ["out"], moment


def test_an_export_without_its_name_leaves_the_old(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    export("feats", data / "two", out)
    before, real = content(out), Path.rename

    def rename(self: Path, target: Path) -> Path:
        if self.name.endswith("-new"):
            raise OSError(16, "Device or resource busy")
        return real(self, target)

    monkeypatch.setattr(Path, "rename", rename)
    with pytest.raises(OSError, match="busy"):
        export("feats", data / "one", out)
    assert content(out) == before
    assert os.listdir(tmp_path) == ["out"]
