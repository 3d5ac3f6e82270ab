"""fTetWild (Hu et al. 2020) in a process of its own, so that the same input gives the same mesh.

fTetWild takes no seed. It seeds its shuffles from std::random_device, and later meshes of a process go on with the
random numbers of earlier ones. Here each mesh is made by a new process, whose std::random_device is C's rand(), which
always starts with the same number.
"""

import ctypes
import importlib.util
import os
import signal
import subprocess
import sys
from importlib.metadata import distribution, version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

Array = np.ndarray
RANDOM_DEVICE_SYMBOL = "_ZNSt13random_device9_M_getvalEv"  # a draw from std::random_device
PR_SET_PDEATHSIG = 1  # of prctl: the signal to a process whose parent has ended
NO_SEED_EXIT_CODE = 3  # exit code


class Unseeded(Exception):
    """The installed pytetwild draws its random numbers in another way: its meshes would differ from run to run."""


def tetrahedralised(*arguments: Any) -> tuple[Array, Array]:
    """Vertices (n, 3) and tets (e, 4) from the arguments of pytetwild's compiled `tetrahedralize_mesh`.

    Raises:
        Unseeded: see there.
    """
    with TemporaryDirectory() as folder:
        asked, made = Path(folder, "asked.npz"), Path(folder, "made.npz")
        np.savez(asked, *arguments)
        done = subprocess.run(
            [sys.executable, "-P", __file__, asked, made],
            env={**os.environ, "OMP_NUM_THREADS": "1"},
            capture_output=True,
            text=True,
        )
        if done.returncode == NO_SEED_EXIT_CODE:
            raise Unseeded(version("pytetwild"))
        if done.returncode:
            raise RuntimeError(f"fTetWild ended with exit code {done.returncode}: {done.stderr[-2000:]}")
        with np.load(made) as stored:
            return stored["arr_0"].astype(float), stored["arr_1"].astype(np.int64)


def main(asked: Path, made: Path) -> int:
    """The new process: the mesh of the arguments in `asked`, written to `made`."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    with np.load(asked) as stored:
        arguments = [stored[name] for name in stored.files]  # in the order of savez
    folder = Path(str(distribution("pytetwild").locate_file("pytetwild")))
    library = next(folder.glob("PyfTetWildWrapper*.so"))
    ftetwild = _loaded(library)
    if not _seeded(library):
        return NO_SEED_EXIT_CODE
    np.savez(made, *ftetwild.tetrahedralize_mesh(*(a if a.ndim else a.item() for a in arguments)))
    return 0


def _loaded(library: Path) -> Any:
    """The compiled module alone: the package would also import PyVista and VTK (0.6 GB)."""
    spec = importlib.util.spec_from_file_location("PyfTetWildWrapper", library)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _seeded(library: Path) -> bool:
    """Let a loaded library call C's rand() for std::random_device; False if it does not import that.

    The addresses of imported functions are in a writable table of the library; Python loads libraries with all of them
    resolved.
    """
    device, rand = (
        ctypes.cast(function, ctypes.c_void_p).value
        for function in (ctypes.CDLL("libstdc++.so.6")[RANDOM_DEVICE_SYMBOL], ctypes.CDLL(None)["rand"])
    )
    changed = 0
    for line in Path("/proc/self/maps").read_text().splitlines():
        if line.endswith(str(library.resolve())) and " rw" in line:
            start, end = (int(number, 16) for number in line.split()[0].split("-"))
            words = (end - start) // ctypes.sizeof(ctypes.c_size_t)
            table = np.ctypeslib.as_array((ctypes.c_size_t * words).from_address(start))
            there = table == device
            table[there] = rand
            changed += int(there.sum())
    return changed > 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2])))
