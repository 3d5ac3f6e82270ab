"""Packed scenes: the same data in fewer files, read by everything that reads bundles, and refused when incomplete."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from helpers.synthetic import write

from tacgen import export
from tacgen.base.errors import UserError
from tacgen.bundle import dataset, pack, resume
from tacgen.bundle.check import check
from tacgen.report import dataset_summary

COUNT = 5


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`loose`: scenes, of which the last was rejected; `packed`: the others in shards."""
    folder = tmp_path_factory.mktemp("source")
    for i in range(COUNT):
        write(folder / "loose" / f"scene-{i:05d}.h5", scene_index=i, seed=i, values={"start.x_mm": i / 10})
    write(folder / "loose" / "scene-00009.h5", stop=3)
    found = pack.pack(dataset.scenes(folder / "loose"), folder / "packed", 0.2)
    assert (found.scenes, found.left_out) == (COUNT, ("scene-00009",))
    assert len(found.shards) > 1
    return folder


@pytest.fixture
def loose(source: Path, tmp_path: Path) -> Path:
    return shutil.copytree(source / "loose", tmp_path / "loose")


@pytest.fixture
def packed(source: Path, tmp_path: Path) -> Path:
    return shutil.copytree(source / "packed", tmp_path / "packed")


def test_scenes_are_the_same_in_and_out_of_shards(loose: Path, packed: Path):
    there = dataset.scenes(packed)
    assert check(packed) == []
    for before, after in zip(dataset.scenes(loose), there, strict=False):
        assert before.attrs == after.attrs
        assert before.shapes == after.shapes
        assert before.verify() == after.verify()
        assert np.array_equal(before.frame("/frames/rgb", 3), after.frame("/frames/rgb", 3))
    assert len(export.bundles(packed)) == COUNT
    assert len(set(export.names(there))) == COUNT
    index = json.loads((packed / "index.json").read_text())
    assert index["scenes"][2]["values"] == {"start.x_mm": 0.2}


def test_packing_twice_gives_the_same_bytes_and_a_pack_can_be_packed_again(loose: Path, packed: Path, tmp_path: Path):
    two = pack.pack(dataset.scenes(loose), tmp_path / "two", 0.2).folder
    for path in [*packed.glob("shard-*"), packed / "index.json"]:  # frames.h5 carries the time at which HDF5 made it
        assert path.read_bytes() == (two / path.name).read_bytes(), path.name
    whole = pack.pack(dataset.scenes(packed), tmp_path / "whole").folder
    assert len(list(whole.glob("shard-*"))) == 1
    assert [b.attrs["digest"] for b in dataset.scenes(whole)] == [b.attrs["digest"] for b in dataset.scenes(packed)]


def test_all_frames_as_one_dataset_from_any_folder(packed: Path):
    program = """
import sys, h5py, json
with h5py.File(sys.argv[1]) as f:
    i = int(sys.argv[2])
    print(json.dumps([f["frames/force"].shape[0], f["frames/rgb"][i].sum().item(), f["frames/force"][i].tolist(),
                      f["scenes"][f["scene"][i]].decode(), int(f["frame"][i])]))
"""
    n = dataset.scenes(packed)[0].frames
    command = [sys.executable, "-c", program, str(packed / "frames.h5"), str(2 * n + 4)]
    total, bright, force, name, frame = json.loads(subprocess.check_output(command, cwd="/"))
    third = dataset.scenes(packed)[2]
    assert (total, name, frame) == (COUNT * n, "scene-00002", 4)
    assert force == third.frame("/frames/force", 4).tolist()
    assert bright == third.frame("/frames/rgb", 4).sum() > 0


def test_a_shard_that_is_missing_or_cut_is_named_by_every_reader_and_joined_by_none(packed: Path):
    first, second = sorted(packed.glob("shard-*"))[:2]
    second.write_bytes(second.read_bytes()[:-1])
    os.unlink(first)
    for reader in (dataset.scenes, export.bundles, pack.join):
        with pytest.raises(UserError) as caught:
            reader(packed)
        assert [line.partition(": ")[0] for line in caught.value.lines] == [str(first), str(second)]
    assert [f.level for f in check(packed)] == ["error", "error"]
    with h5py.File(packed / "frames.h5") as file:
        assert not file["frames/force"][0].any()  # why readers look first: HDF5 itself makes zeros of it


def test_scenes_come_in_the_plans_order_beyond_five_digits(tmp_path: Path):
    names = ["scene-00002.h5", "scene-99999.h5", "scene-100000.h5"]
    for name in names:
        (tmp_path / name).touch()
    assert [path.name for path in dataset.files(tmp_path)] == names


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("{}", "tacgen_pack: Field required"),
        ("[1", "damaged"),
        ('{"tacgen_pack": 2}', "pack format 2; this tacgen reads"),
    ],
)
def test_a_foreign_or_newer_index_is_one_line(packed: Path, content: str, says: str):
    (packed / "index.json").write_text(content)
    with pytest.raises(UserError, match=says) as caught:
        dataset.scenes(packed)
    assert len(caught.value.lines) == 1


def test_what_cannot_be_packed_is_reported(loose: Path, packed: Path, tmp_path: Path):
    with pytest.raises(UserError, match="is not empty"):
        pack.pack(dataset.scenes(loose), loose)
    write(loose / "more" / "scene-00001.h5")
    with pytest.raises(UserError, match="have the same name"):
        pack.pack(dataset.scenes(loose, merge=True), tmp_path / "out")
    with pytest.raises(UserError, match="no finished scene to pack"):
        pack.pack([b for b in dataset.scenes(loose, merge=True) if b.attrs["status"] != "ok"], tmp_path / "out")
    with pytest.raises(UserError, match="no tacgen bundle: it holds packed scenes; give the folder it is in"):
        dataset.scenes(min(packed.glob("shard-*")))


@pytest.mark.slow
def test_a_folder_that_holds_its_own_pack_is_two_datasets(loose: Path):
    inside = pack.pack(dataset.scenes(loose), loose / "packed", 0.2).folder
    loose_scenes = dataset.scenes(loose)
    assert {bundle.group for bundle in loose_scenes} == {"/"}
    assert len(loose_scenes) == COUNT + 1
    assert len(export.bundles(loose)) == COUNT
    assert {f.level for f in check(loose)} == {"rejected"}
    assert dataset_summary.summary(loose).splitlines()[1] == f"scenes    {COUNT} ok, 1 rejected"
    again = pack.pack(dataset.scenes(loose), loose.parent / "again", 0.2)
    assert (again.folder / "index.json").read_bytes() == (inside / "index.json").read_bytes()
    shard = min(inside.glob("shard-*"))
    shard.write_bytes(shard.read_bytes()[:-1])
    assert {f.path for f in check(loose) if f.level == "error"} == {inside}, "check looks into packs below as well"
    for path in loose.glob("*.h5"):
        path.unlink()
    with pytest.raises(UserError, match=f"no bundles.*packed scenes are in {inside}"):
        dataset.scenes(loose)


def test_no_scene_is_made_among_packed_ones(packed: Path):
    with pytest.raises(UserError, match="holds packed scenes; choose another folder"):
        resume.existing([], packed)
