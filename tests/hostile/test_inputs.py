"""Files that a person names: pipes, devices, bombs and damage end in a line, soon and without much memory."""

import os
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import trimesh
from PIL import Image

from hostile import attempts
from tacgen.geometry import mesh_file
from tacgen.recipe import assets, plan, pose_table
from tacgen.render import photograph
from tacgen.sensor import yaml_source

READERS: dict[str, Callable[[Path], object]] = {
    "recipe.yaml": yaml_source.load,
    "ball.stl": mesh_file.read,
    "ball.obj": mesh_file.read,
    "ball.ply": mesh_file.read,
    "poses.csv": pose_table.read,
    "photo.png": photograph.read,
    "any": assets.sha256,
}


@pytest.fixture(scope="module", autouse=True)
def warm(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Read sound files in this process, so that no child has to import what it reads with."""
    attempts.read_inputs(attempts.inputs(tmp_path_factory.mktemp("sound")) / "inputs")


def outcome(work: Callable[[], object], tmp_path: Path) -> str:
    """How a child with a bounded memory ends, with what it raised."""
    note = tmp_path / "note"
    found = attempts.contained(lambda: (work(), "accepted")[1], note)
    return found + (f": {note.read_text()}" if note.exists() else "")


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "huge"])
def test_only_regular_files_of_a_bounded_size_are_read(tmp_path: Path, name: str, kind: str) -> None:
    path = tmp_path / name
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    else:
        with path.open("wb") as file:
            file.truncate(2**43)
    assert outcome(lambda: READERS[name](path), tmp_path) == "refused"


def test_a_mesh_opens_no_other_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    box = trimesh.creation.box((1, 1, 1)).export(file_type="obj")
    (tmp_path / "ball.obj").write_text(f"mtllib pipe\nusemtl a\n{box}")
    assert outcome(lambda: mesh_file.read(tmp_path / "ball.obj"), tmp_path) == "accepted"


def test_a_picture_that_unpacks_to_gigabytes_is_refused_by_its_head(tmp_path: Path) -> None:
    Image.new("1", (13_000, 13_000)).save(tmp_path / "photo.png")
    assert (tmp_path / "photo.png").stat().st_size < 200_000
    assert outcome(lambda: photograph.read(tmp_path / "photo.png"), tmp_path) == "refused"


MESHES = {
    "stl promises": ("a.stl", bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(100)),
    "ply promises": (
        "a.ply",
        b"ply\nformat binary_little_endian 1.0\nelement vertex 100000000000\nproperty float x\nproperty float y\n"
        b"property float z\nelement face 100000000000\nproperty list uchar int vertex_indices\nend_header\n" + bytes(9),
    ),
    "ply bad index": (
        "a.ply",
        b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n",
    ),
    "obj bad index": ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"),
    "obj negative index": ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -1 -2 -9\n"),
    "two columns": ("a.obj", b"v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n"),
    "no area": ("a.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"),
    "all one point": ("a.obj", b"v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\nf 3 2 1\n"),
    "back to back": ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 3 2 1\n"),
    "a point far away": ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1e8 0 0\nf 1 2 3\nf 1 2 3\nf 1 2 4\nf 2 1 4\n"),
    "book": ("a.obj", b"v 0 0 0\nv 0 0 1\n" + b"".join(b"v %d %d 0\n" % (k, k * k) for k in range(2, 40))
             + b"".join(b"f 1 2 %d\n" % k for k in range(3, 41))),
    "tiny": ("a.obj", b"v 0 0 0\nv 1e-300 0 0\nv 0 1e-300 0\nv 0 0 1e-300\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"),
    "one face": ("a.stl", b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
                 b"endloop\nendfacet\nendsolid a\n"),
}  # fmt: skip


@pytest.mark.parametrize("name", MESHES)
def test_crafted_meshes_are_refused(tmp_path: Path, name: str) -> None:
    file, content = MESHES[name]
    (tmp_path / file).write_bytes(content)
    assert outcome(lambda: mesh_file.read(tmp_path / file), tmp_path) == "refused"


@pytest.mark.parametrize("number", ["0x" + "f" * 5000, "9" * 5000, "-0x" + "f" * 5000, "0b" + "1" * 20000])
def test_endless_numbers_are_refused(tmp_path: Path, number: str) -> None:
    (tmp_path / "a.yaml").write_text(f"tacgen: 1\nindenter: {{shape: sphere, radius_mm: {number}}}\n")
    assert outcome(lambda: plan.load(tmp_path / "a.yaml"), tmp_path) == "refused"


BEYOND = (
    *("start.yaw_deg=1e300", "trajectory[2].twist.angle_deg=-1e300", "sensor.markers.columns=100000000"),
    "sensor.markers={layout: hexagonal, rings: 100000, pitch_mm: 1.0e-4, diameter_mm: 1.0e-5, albedo: 0.1}",
    *("sensor.camera.width_px=1000000000", "sensor.gel.width_mm=1e300", "trajectory[0].press.frames=1000000000"),
    "vary={method: grid, over: {" + ", ".join(f"a{i}: {{linspace: [0, 1, 1000000]}}" for i in range(200)) + "}}",
    *("indenter={shape: mesh, file: ~nosuchuser/x.stl}", 'indenter={shape: mesh, file: "~a\\0b/x.stl"}'),
    *("trajectory=[{replay: {file: ~nosuchuser/x.csv}}]", "sensor=~nosuchuser/x.yaml"),
    'render={background: "~a\\0b.png"}',
)


@pytest.mark.parametrize("override", BEYOND, ids=lambda text: text[:40])
def test_numbers_and_names_beyond_use_are_refused(tmp_path: Path, override: str) -> None:
    sets = [override, "outputs=[rgb]"]
    assert outcome(lambda: plan.load(assets.recipe_path("quickstart"), sets), tmp_path) == "refused"


@pytest.mark.parametrize(("kind", "count"), [("inputs", 8), ("numbers", 8), ("logs", 15)])
def test_damaged_inputs(tmp_path: Path, kind: str, count: int) -> None:
    source = attempts.inputs(tmp_path)
    found = [attempts.attempt(kind, seed, source) for seed in range(count)]
    assert [str(a) for a in found if a.outcome not in attempts.GOOD] == []
    assert {a.outcome for a in found} == {"accepted", "refused"}


@pytest.mark.parametrize("said", [b"", b"\0\0\0\4abc"])
def test_a_worker_whose_parent_is_gone_ends_without_a_word(said: bytes) -> None:
    import socket

    ours, theirs = socket.socketpair()
    command = [sys.executable, "-m", "tacgen.batch.worker_main", str(theirs.fileno()), str(os.getpid())]
    worker = subprocess.Popen(command, pass_fds=[theirs.fileno()], stderr=subprocess.PIPE)
    theirs.close()
    ours.sendall(said)
    ours.close()
    assert worker.communicate(timeout=60)[1] == b""
    assert worker.returncode == 1
