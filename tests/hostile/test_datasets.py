"""Spoilt and crafted datasets end every reader in a line, or are read as they were; here a few of each kind.

`make torture` tries many more.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from helpers.needs import needs
from helpers.synthetic import attributes, write

from hostile import attempts, kills
from hostile.mutations import reseal
from hostile.resealed import MUTATIONS, put, rewritten
from tacgen.base.errors import UserError
from tacgen.bundle import dataset
from tacgen.bundle.bundle import read
from tacgen.bundle.check import check
from tacgen.bundle.journal import Journal
from tacgen.bundle.run_status import survey
from tacgen.recipe import assets
from tacgen.report import dataset_card, dataset_summary, field_figure, html_report

INPUTS = 9  # of each kind
TESTS = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return attempts.base(tmp_path_factory.mktemp("hostile"))


@pytest.fixture(scope="module")
def warm(source: Path) -> None:
    attempts.warm(source)


@pytest.mark.slow
@pytest.mark.usefixtures("warm")
@pytest.mark.parametrize("kind", sorted(MUTATIONS.keys() - {"inputs", "numbers", "logs"}))
def test_a_few_of_each_kind(source: Path, kind: str) -> None:
    found = [attempts.attempt(kind, seed, source) for seed in range(INPUTS)]
    assert [str(a) for a in found if a.outcome not in attempts.GOOD] == []
    assert {a.outcome for a in found} == {"accepted", "refused"}


CRAFTED: dict[str, Callable[[Any], Any]] = {
    "a shape that is no text": lambda file: rewritten(file, indenter={"shape": 5}),
    "a file that is no text": lambda file: rewritten(file, indenter={"shape": "mesh", "file": {"a": 1}}),
    "cells of 7 nodes": lambda file: put(file, "mesh/cells", np.zeros((1, 7), "<i4")),
    "cells without nodes": lambda file: put(file, "mesh/cells", np.zeros((1, 0), "<i4")),
    "nodes that are not there": lambda file: put(file, "mesh/cells", file["mesh/cells"][()] + 1),
    "facets below zero": lambda file: put(file, "mesh/facets/coated", file["mesh/facets/coated"][()] - 2),
    "layers without cells": lambda file: put(file, "mesh/layer", np.array([2**31 - 1], "<i4")),
    "poses that are not numbers": lambda file: put(file, "frames/pose", np.nan * file["frames/pose"][()]),
    "nodes far away": lambda file: put(file, "mesh/points", 1e300 * file["mesh/points"][()]),
    "maps without samples": lambda file: put(file, "reference/height", file["reference/height"][:0]),
    "fewer frames than planned": lambda file: file.attrs.update(frames_planned=9),
}


def all_of(path: Path) -> list[np.ndarray]:
    bundle = read(path)
    return [bundle[name] for name in bundle.shapes]


@pytest.mark.parametrize("name", CRAFTED)
def test_a_crafted_bundle_is_refused_where_it_is_read(source: Path, tmp_path: Path, name: str) -> None:
    """Not by each of its readers: opening it or reading the dataset says so, and `check` finds it."""
    path = tmp_path / "scene-00000.h5"
    shutil.copy(source / "whole" / path.name, path)
    with h5py.File(path, "a") as file:
        CRAFTED[name](file)
    reseal(path, "/")
    with pytest.raises(UserError, match="damaged: "):
        all_of(path)
    assert any("damaged: " in finding.message for finding in check(path))


@pytest.mark.parametrize("indenter", [{"shape": "spheroid"}, {"shape": "sphere", "radius_mm": -1}, {}])
def test_an_indenter_of_a_later_version_is_not_drawn(source: Path, tmp_path: Path, indenter: dict[str, Any]) -> None:
    path = tmp_path / "scene-00000.h5"
    shutil.copy(source / "whole" / path.name, path)
    with h5py.File(path, "a") as file:
        rewritten(file, indenter=indenter)
    attempts.command("view", str(path), "-o", str(tmp_path / "view.html"))
    assert (tmp_path / "view.html").stat().st_size


def test_a_mesh_that_a_bundle_names_is_drawn_only_if_it_is_the_one_of_its_recipe(tmp_path: Path) -> None:
    """A crafted bundle cannot put another file of the reader's into a page."""
    ball = attempts.inputs(tmp_path) / "inputs" / "ball.stl"
    for sha256, there in (("0" * 64, False), (None, False), (assets.sha256(ball), True)):
        recipe = attributes()["recipe"] | {"indenter": {"shape": "mesh", "file": str(ball), "sha256": sha256}}
        scene = read(write(tmp_path / "scene.h5", outputs=frozenset({"force"}), recipe=recipe))
        assert (field_figure.indenter_surface(scene, 5.0) is not None) == there


@pytest.mark.slow
@pytest.mark.usefixtures("warm")
def test_a_few_kills(source: Path) -> None:
    needs("webdataset")
    seeds = {kills.work(seed): seed for seed in reversed(range(40))}  # one of each work
    assert seeds.keys() == kills.WORKS.keys()
    found = [kills.kill(seed, source) for seed in seeds.values()]
    assert [str(a) for a in found if a.outcome != "accepted"] == []


def test_a_zeroed_heap_of_strings_is_refused(tmp_path: Path) -> None:
    """HDF5 1.14 never returns from an unused piece without a length."""
    path = write(tmp_path / "scene.h5", outputs=frozenset({"force"}))
    data = bytearray(path.read_bytes())
    at = data.index(b"GCOL")
    while at >= 0:
        data[at + 16 : at + 200] = bytes(184)
        at = data.find(b"GCOL", at + 4)
    path.write_bytes(data)
    # in a child, since only a signal's default action ends a loop of HDF5's
    assert attempts.contained(lambda: str(read(path)), tmp_path / "note") == "refused"


def test_a_bundle_in_another_s_place_is_found(source: Path, tmp_path: Path) -> None:
    sound = attempts.sound(source / "loose")
    shutil.copytree(source / "loose", tmp_path / "loose")
    shutil.copy(tmp_path / "loose" / "scene-00000.h5", tmp_path / "loose" / "scene-00002.h5")
    (new,) = set(attempts.Content.of(tmp_path / "loose").findings) - set(sound.findings)
    assert new == "scene-00002.h5 is a copy of scene-00000.h5: one of them was replaced"


def test_names_leave_no_folder(source: Path, tmp_path: Path) -> None:
    index = json.loads((source / "packed" / "index.json").read_text())
    for name in ("../loose/scene-00000.h5", "/etc/passwd", "..", "", "a\x1b[2Jb", "\ud800"):
        spoilt = {**index, "shards": [{**index["shards"][0], "file": name}, *index["shards"][1:]]}
        (tmp_path / "index.json").write_text(json.dumps(spoilt))
        (finding,) = check(tmp_path)
        assert "damaged" in finding.message, name
    plan = {"name": "x", "scenes": [{"scene": "../../x", "frames": 1, "seed": 0, "key": "", "values": {}}]}
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    with pytest.raises(UserError, match=r"scenes\.0\.scene: Value error, must be the name"):
        survey(tmp_path)


def test_numbers_that_are_not_finite_or_beyond_use_are_refused(source: Path, tmp_path: Path) -> None:
    stored = json.loads((source / "loose" / "plan.json").read_text())
    for number in ("1e999", "-1e308", f"1{400 * '0'}", '[0.1, {"x": 1e999}]'):
        plan = json.dumps(stored).replace(json.dumps(stored["scenes"][1]["values"]["start.x_mm"]), number)
        (tmp_path / "plan.json").write_text(plan)
        with pytest.raises(UserError, match=r"scenes\.1\.values\.start\.x_mm: .* finite number below 1e\+100"):
            survey(tmp_path)


def test_forces_that_are_not_finite_are_left_out_of_the_report(tmp_path: Path) -> None:
    for k in range(3):
        path = write(tmp_path / f"scene-0000{k}.h5")
        if k:
            with h5py.File(path, "a") as file:
                file["frames/force"][...] = np.inf
    assert "1 scene" in html_report.page(dataset_summary.look(tmp_path))


def test_external_links_and_storage_are_refused(tmp_path: Path) -> None:
    secret = write(tmp_path / "secret.h5")
    for kind in ("link", "storage", "virtual", "soft"):
        with h5py.File(write(tmp_path / f"{kind}.h5"), "a") as file:
            shape = file["frames/force"].shape
            del file["frames/force"]
            if kind == "link":
                file["frames/force"] = h5py.ExternalLink("secret.h5", "/frames/force")
            elif kind == "soft":
                file["frames/force"] = h5py.SoftLink("/frames/torque")
            elif kind == "storage":
                file.create_dataset("frames/force", shape, "<f8", external=[(str(secret), 0, h5py.h5f.UNLIMITED)])
            else:
                layout = h5py.VirtualLayout(shape, "<f8")
                layout[...] = h5py.VirtualSource(str(secret), "/frames/force", shape)
                file.create_virtual_dataset("frames/force", layout)
        with pytest.raises(UserError, match=r"/frames/force is (a link|not stored in this file)"):
            read(tmp_path / f"{kind}.h5")


def test_names_are_text_in_the_report_and_the_card(tmp_path: Path) -> None:
    name = "<script>alert(1)</script>|\n<img src=x>"
    recipe = attributes()["recipe"] | {"name": name, "indenter": {"shape": name}}
    write(tmp_path / "scene-00000.h5", recipe=recipe, sensor=name, values={name: name, f"{name} 2": 1.0})
    page = html_report.page(dataset_summary.look(tmp_path))
    card = dataset_card.write(tmp_path).read_text()
    for text in (page, card):
        assert "alert(1)" in text
        assert "<script>alert" not in text  # the page has a script of its own
        assert "<img src=x" not in text
    for line in card.splitlines():
        if line.startswith("| "):
            assert len(re.findall(r"(?<!\\)\|", line)) in (3, 4), line  # two or three cells, as in the head


def test_a_folder_that_may_not_be_read_is_no_empty_one(source: Path, tmp_path: Path) -> None:
    if os.geteuid():
        pytest.skip("only root may become another user")
    check(source / "loose")  # imports what the other user may not
    there = Path(tempfile.mkdtemp())
    there.chmod(0o777)
    shutil.copytree(source / "loose", there / "in" / "loose")
    for closed in (there / "in", there / "in" / "loose"):
        closed.chmod(0)

        for work, folder in ((dataset.scenes, there / "in" / "loose"), (check, there / "in")):

            def by_another(work: Callable[[Path], object] = work, folder: Path = folder) -> str:
                os.setuid(65534)
                return str(work(folder))

            assert attempts.contained(by_another, there / "note") == "refused", (closed, work)
        closed.chmod(0o755)
    shutil.rmtree(there)


def test_a_journal_that_is_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "journal.jsonl")

    def write_it() -> str:
        with pytest.raises(OSError, match="No such device"), Journal(tmp_path, None):
            pass
        return "accepted"

    assert attempts.contained(write_it, tmp_path / "note") == "accepted"


@pytest.mark.slow
def test_torture_writes_its_table(tmp_path: Path) -> None:
    flags = ("--inputs", str(len(MUTATIONS)), "--kills", "2", "-o", tmp_path)
    command = [sys.executable, "-W", "ignore", "-m", "benchmarks.torture", *flags]
    here = {**os.environ, "PYTHONPATH": f"{TESTS}{os.pathsep}{TESTS.parent}"}
    subprocess.run(command, env=here, check=True, timeout=300, stdout=subprocess.DEVNULL)
    (table,) = json.loads((tmp_path / "results" / "torture.json").read_text())["tables"]
    assert [row[:2] for row in table["rows"]] == [[kind, 1] for kind in sorted(MUTATIONS)] + [["kill", 2]]
    assert "## Torture" in (tmp_path / "RESULTS.md").read_text()
