"""One hostile input, one reader, one child process: what became of it."""

import io
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import h5py
import numpy as np
from helpers import whole_bundle
from helpers.scenes import make, make_plan
from helpers.synthetic import OUTPUTS, write

from hostile.resealed import MUTATIONS
from tacgen.base.errors import LeftOut, UserError
from tacgen.bundle import dataset, pack
from tacgen.bundle.check import check
from tacgen.bundle.journal import Journal, write_plan
from tacgen.cli.common import writing
from tacgen.export import EXPORTERS
from tacgen.recipe import plan_table
from tacgen.replay import log_file
from tacgen.replay.contact_log import Conventions
from tacgen.report import dataset_card
from tacgen.report.field_figure import DRAWN_FIELDS

SECONDS = 20  # of processor time that a reader may take
WAIT_S = 120.0  # that pass until one that waits for something is given up; other work may keep it from the processor
MEMORY = 3 * 2**30  # bytes of address space beyond what the process has
GOOD = ("accepted", "refused")
OUTCOMES = (*GOOD, "lost", "wrong", "traceback", "hung", "died")
CODES = {name: 20 + i for i, name in enumerate(OUTCOMES)}


@dataclass(frozen=True)
class Attempt:
    """What was spoilt, who read it, and how that ended."""

    kind: str
    seed: int
    said: str
    outcome: str
    detail: str = ""

    def __str__(self) -> str:
        return f"{self.kind} {self.seed}: {self.said}: {self.outcome} {self.detail}"


def base(folder: Path) -> Path:
    """`loose` and `packed`: three small scenes with plan, journal and times, and the same in shards; `whole`: one with
    every dataset."""
    loose = folder / "loose"
    plan = make_plan(folder, 3)
    for row in plan.rows:
        known = {"input_key": row.key, "seed": row.seed, "scene_index": row.index, "values": row.values}
        more = {"sensor_document": row.sensor_document(), "notes": ["a note"], "recipe": row.document()}
        path = write(loose / f"{row.name}.h5", outputs=OUTPUTS, shape=(16, 16), **known, **more)
        path.with_suffix(".timing.json").write_text('{"frames": 12, "seconds": {"solve": 1.5, "mesh": 0.25}}')
    write_plan(plan_table.as_json(plan), loose, None)
    with Journal(loose, None) as journal:
        for row in plan.rows:
            journal.write({"event": "scene", "scene": row.name, "status": "failed", "reason": "a reason"})
    dataset_card.write(loose)
    pack.pack(dataset.scenes(loose), folder / "packed", 0.04)
    sensor = make_plan(folder, 1).rows[0].sensor_document()
    whole_bundle.write(folder / "whole" / "scene-00000.h5", sensor_document=sensor, values={"a": 1.0}, notes=["a note"])
    return folder


RECIPE = """
tacgen: 1
name: input
sensor: sensor.yaml
indenter: {shape: mesh, file: ball.stl, size_mm: 5}
trajectory:
  - replay: {file: poses.csv, units: mm}
outputs: [rgb]
render: {background: photo.png}
"""


def log_arrays() -> dict[str, Any]:
    """A ball that comes down to the gel, as a simulator records it: four rows in mm, quaternions w x y z."""
    position = np.zeros((4, 3))
    position[:, 2] = (6.0, 4.2, 3.8, 3.6)  # of the centre of a ball of 4 mm
    turn = np.tile([1.0, 0, 0, 0], (4, 1))
    known = {"units": "mm", "quaternion": "wxyz", "force": position}
    return {"time": 0.1 * np.arange(4), "object_position": position, "object_quaternion": turn} | known


LOG_TABLE = "time_s,x_mm,y_mm,z_mm,qw,qx,qy,qz,force_x_n,force_y_n,force_z_n\n" + "".join(
    f"{t},0,0,{z},1,0,0,0,0,0,{-t}\n" for t, z in enumerate((6, 4.2, 3.8, 3.6))
)


def logs(folder: Path) -> None:
    """The same log as a table, an archive and an HDF5 file."""
    folder.mkdir()
    (folder / "log.csv").write_text(LOG_TABLE)
    np.savez_compressed(folder / "log.npz", **log_arrays())
    with h5py.File(folder / "log.h5", "w") as file:
        file.update(log_arrays())


def _logs(folder: Path) -> None:
    for path in sorted(folder.glob("log.*")):
        log_file.read(path, Conventions())


def inputs(folder: Path) -> Path:
    """`inputs`: a recipe, its sensor file, pose table, photograph, and a ball in three formats; `logs`."""
    import trimesh
    from PIL import Image

    from tacgen.recipe import assets

    logs(folder / "logs")
    here = folder / "inputs"
    here.mkdir()
    (here / "recipe.yaml").write_text(RECIPE)
    shutil.copy(assets.sensor_path("gelsight_mini"), here / "sensor.yaml")
    rows = [f"{t / 10},0.1,0,{-0.05 * t},1,0,0,0" for t in range(4)]
    (here / "poses.csv").write_text("\n".join(["time_s,x,y,z,qw,qx,qy,qz", *rows]) + "\n")
    Image.new("RGB", (320, 240), (90, 80, 70)).save(here / "photo.png")
    ball = trimesh.creation.icosphere(subdivisions=1, radius=2.0)
    for kind in ("stl", "obj", "ply"):
        ball.export(here / f"ball.{kind}")
    return folder


def read_inputs(folder: Path) -> None:
    """Validate the recipe; read the meshes that it does not name as well."""
    from tacgen.geometry import mesh_import

    for kind in ("obj", "ply"):
        mesh_import.sizes(folder / f"ball.{kind}", "+z", 1.0)
    command("validate", str(folder / "recipe.yaml"))


def command(*args: str) -> None:
    """A command in this process. Raises what it does not turn into an exit code."""
    from typer.testing import CliRunner

    from tacgen.cli import main as cli

    done = CliRunner().invoke(cli.app, list(args))
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    if done.exit_code == 2:
        raise UserError(done.stderr)
    assert done.exit_code in (0, 1), done.exit_code
    if "\x1b" in done.output or "\x07" in done.output:
        raise AssertionError("control characters reach the terminal")


def load(folder: Path) -> None:
    from tacgen.torch import TactileDataset

    data = TactileDataset(folder, ("rgb", "force", "height"), subtract_reference=True)
    for index in range(0, len(data), 5):
        data[index]


def resume(folder: Path) -> None:
    """A run that goes on: its scenes come from closed formulas."""
    for row in make_plan(folder.parent, 3).rows:
        make(row, folder)


def card(folder: Path) -> None:
    with writing(folder):  # as `run` writes it
        dataset_card.write(folder)


def exported(kind: str) -> Callable[[Path], None]:
    return lambda folder: command("export", kind, str(folder), "-o", str(folder.parent / f"exported-{kind}"))


def first(folder: Path) -> str:
    """The first bundle of a folder, or a packed folder itself."""
    return str(next(iter(sorted(folder.glob("scene*.h5"))), folder))


def drawn(*how: str) -> Callable[[Path], None]:
    return lambda folder: command("show", first(folder), *how[:-1], str(folder.parent / how[-1]))


READERS: dict[str, Callable[[Path], None]] = {
    "check": lambda folder: command("check", str(folder)),
    "status": lambda folder: command("status", str(folder)),
    "show": lambda folder: command("show", str(folder)),
    "show one": lambda folder: command("show", first(folder)),
    "view one": lambda folder: command("view", first(folder), "-o", str(folder.parent / "view.html")),
    "report": lambda folder: command("report", str(folder), "-o", str(folder.parent / "report.html")),
    "pack": lambda folder: command("pack", str(folder), "-o", str(folder.parent / "again")),
    "card": card,
    "torch": load,
    "resume": resume,
    "show picture": drawn("-o", "picture.png"),
    "show film": drawn("--animate", "film.gif"),
    **{f"show {field}": drawn("--field", field, "-o", "field.png") for field in DRAWN_FIELDS},
    **{f"export {kind}": exported(kind) for kind in EXPORTERS},
}


def warm(source: Path) -> None:
    """Every reader once in this process, but of the drawn fields one, so that no child has to import anything."""
    for reader in [name for name in READERS if name not in [f"show {field}" for field in list(DRAWN_FIELDS)[1:]]]:
        with tempfile.TemporaryDirectory() as scratch, redirect_stdout(io.StringIO()), suppress(UserError):
            shutil.copytree(source / "whole", Path(scratch) / "whole")
            READERS[reader](Path(scratch) / "whole")


@dataclass(frozen=True)
class Content:
    """Digests of all scenes, each read through, and what `check` says of them."""

    digests: list[str]
    findings: list[str]

    @classmethod
    def of(cls, folder: Path) -> "Content":
        """Raises UserError."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LeftOut)
            found = dataset.scenes(folder)
        for bundle in found:
            bundle.verify()
        return cls([bundle.attrs["digest"] for bundle in found], [finding.message for finding in check(folder)])


sound = cache(Content.of)  # of a folder that nobody spoils


def attempt(kind: str, seed: int, source: Path) -> Attempt:
    """Spoil a copy of `source` (made by `base`) by a mutation of this kind, and have a reader read it."""
    rng, other = Random(f"{kind} {seed}"), Random(f"{kind} {seed}, reader")  # damage is the same with other readers
    which, reader = other.choice(("loose", "packed")), other.choice(sorted(READERS))
    if kind == "resealed":
        which = "whole"
    if kind in ("inputs", "numbers", "logs"):
        which = reader = "logs" if kind == "logs" else "inputs"
    with tempfile.TemporaryDirectory() as scratch:
        folder, note = Path(scratch) / which, Path(scratch) / "note"
        shutil.copytree(source / which, folder)
        said = f"{MUTATIONS[kind](rng, folder)}, {which}, {reader}"
        wanted = sound(source / which) if kind == "bytes" else None
        code = contained(lambda: _read(reader, folder, wanted), note)
        return Attempt(kind, seed, said, code, note.read_text() if note.exists() else "")


def _read(reader: str, folder: Path, wanted: Content | None) -> str:
    """What is no longer what it was is wrong, unless `check` says so."""
    ({**READERS, "inputs": read_inputs, "logs": _logs})[reader](folder)
    if wanted is not None and reader == "check":
        try:
            found = Content.of(folder)
        except UserError:
            return "accepted"  # check has said it in findings
        if found.digests != wanted.digests and found.findings == wanted.findings:
            return "wrong"
    return "accepted"


def contained(work: Callable[[], str], note: Path) -> str:
    """Run in a child with little memory and time: "accepted" or what else `work` says, and what it raises."""
    sys.stdout.flush()
    child = os.fork()
    if not child:
        os._exit(_child(work, note))
    deadline = time.monotonic() + WAIT_S
    while time.monotonic() < deadline:
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            if os.WIFSIGNALED(status):
                note.write_text(f"signal {os.WTERMSIG(status)}")
                return "hung" if os.WTERMSIG(status) == signal.SIGXCPU else "died"
            return next((name for name, code in CODES.items() if code == os.WEXITSTATUS(status)), "died")
        time.sleep(0.005)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return "hung"


def _child(work: Callable[[], str], note: Path) -> int:
    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 1))
    warnings.simplefilter("ignore", LeftOut)
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            return CODES[work()]
    except UserError as error:
        bad = [line for line in error.lines if not line.isprintable() and "\t" not in line]
        return CODES["refused"] if error.lines else note.write_text(str(bad)) * 0 + CODES["traceback"]
    except BaseException as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        ours = [f for f in traceback.extract_tb(error.__traceback__) if "/tacgen/" in f.filename]
        place = ours[-1] if ours else where
        note.write_text(f"{type(error).__name__}: {str(error)[:100]!r} at {Path(place.filename).name}:{place.lineno}")
        return CODES["traceback"]
