"""Tests of what works on this machine."""

import os
import platform
import shutil
import sys
import tempfile
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple

NEEDED_PACKAGES = (
    *("numpy", "scipy", "warp-lang", "h5py", "deflate", "pydantic", "ruamel.yaml", "typer", "click"),
    *("rich", "platformdirs", "threadpoolctl", "matplotlib", "pillow", "trimesh", "networkx", "libigl"),
    *("pytetwild", "mitsuba", "drjit", "OpenEXR"),
)
REPLACEABLE_PACKAGES = ("cvxopt", "pymetis")  # optional: without them another linear solver is used
MIN_FREE_DISK_GB = 1.0  # free disk below which a warning is given [GB]
WARM_TRAJECTORY = "trajectory=[{press: {depth_mm: 0.2, frames: 1}}]"
WARM_OUTPUTS = "force, traction, force_map, height, normals, gap, flow, material, rgb, stress"


class Diagnosis(NamedTuple):
    """The result of one test."""

    name: str
    ok: bool
    note: str
    needed: bool = True  # tacgen does not work without it


def examine() -> list[Diagnosis]:
    """Run all tests; one that fails is a finding, never an exception."""
    diagnoses: list[Diagnosis] = []
    for trial in (_python, _packages, _solvers, _rendering, _hdf5, _threads, _disk):
        try:
            diagnoses += list(trial())
        except Exception as error:  # any error is a diagnosis
            said = f"{type(error).__name__}: {error}".split("\n")[0]
            diagnoses.append(Diagnosis(trial.__name__.strip("_"), False, said))
    return diagnoses


def warm() -> Iterator[Diagnosis]:
    """Compile all code and fill the caches, so that later runs start at once: press a ball on each shipped sensor with
    all outputs, and note the time or what went wrong."""
    from tacgen.base.errors import UserError
    from tacgen.base.machine import cores
    from tacgen.batch.local import Pool
    from tacgen.recipe import assets, plan

    recipe = assets.recipe_path("quickstart")
    with tempfile.TemporaryDirectory() as folder, Pool(min(2, cores())) as pool:
        for sensor in assets.list_sensors():
            try:
                (row,) = plan.load(recipe, [f"sensor={sensor}", "outputs=[force]", WARM_TRAJECTORY]).rows
                outputs = WARM_OUTPUTS if row.sensor.markers is None else f"{WARM_OUTPUTS}, markers"
                (row,) = plan.load(recipe, [f"sensor={sensor}", f"outputs=[{outputs}]", WARM_TRAJECTORY]).rows
            except UserError as error:  # its images need a package that is not installed
                yield Diagnosis(sensor, False, error.lines[0])
                continue
            (result,) = pool.run([row], Path(folder) / sensor)
            seconds = sum(result.seconds.values())
            took = f"{seconds:.0f} s, {result.seconds.get('compile', 0.0):.0f} s of them compiling"
            yield Diagnosis(sensor, result.status == "ok", result.reason or took)


def _python() -> Iterator[Diagnosis]:
    fits = (3, 11) <= sys.version_info[:2] < (3, 14)
    yield Diagnosis("python", fits, f"{platform.python_version()} ({sys.executable}); 3.11 to 3.13 are supported")


def _packages() -> Iterator[Diagnosis]:
    for name in (*NEEDED_PACKAGES, *REPLACEABLE_PACKAGES):
        needed = name in NEEDED_PACKAGES
        try:
            yield Diagnosis(name, True, version(name), needed)
        except PackageNotFoundError:
            yield Diagnosis(name, False, "is not installed", needed)


def _solvers() -> Iterator[Diagnosis]:
    from tacgen.mechanics import linear_solvers as linear

    names = linear.available()
    yield Diagnosis("linear solvers", bool(names), ", ".join(names) or "none can be imported")
    if "cholmod" in names:
        from tacgen.mechanics import blas_kernels

        yield Diagnosis("CHOLMOD's BLAS", True, blas_kernels.report(), needed=False)


def _rendering() -> Iterator[Diagnosis]:
    from tacgen.render import mitsuba_variants

    tried = mitsuba_variants.variants()
    for one in tried:
        yield Diagnosis(one.variant, one.works, f"{one.note} {one.library}".strip(), needed=False)
    working = [one.variant for one in tried if one.works]
    yield Diagnosis("rendering", bool(working), f"uses {working[0]}" if working else "no Mitsuba variant renders")


def _hdf5() -> Iterator[Diagnosis]:
    import h5py
    import numpy as np

    from tacgen.base import atomic_file
    from tacgen.bundle import hdf5_file

    data = np.arange(12.0).reshape(3, 4)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trial.h5"
        with atomic_file.published(path) as sink, hdf5_file.written_file(sink) as file:
            file.create_dataset("data", data=data, compression="gzip", shuffle=True, fletcher32=True)
        with hdf5_file.opened(path) as file:
            same = bool(np.array_equal(file["data"][()], data))
    yield Diagnosis("HDF5", same, f"round trip with HDF5 {h5py.version.hdf5_version}")


def _threads() -> Iterator[Diagnosis]:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1  # macOS has none
    yield Diagnosis("threads", True, f"{cores} cores; BLAS has 1 thread in every scene")


def _disk() -> Iterator[Diagnosis]:
    for name, folder in (("disk here", Path.cwd()), ("disk for scratch", Path(tempfile.gettempdir()))):
        free = shutil.disk_usage(folder).free / 1e9
        yield Diagnosis(name, free > MIN_FREE_DISK_GB, f"{free:.1f} GB free", needed=False)
