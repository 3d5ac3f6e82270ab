"""Which Mitsuba variants really render on this machine.

Importing is no test: drjit 1.5 aborts the whole process when it compiles with LLVM_VARIANT 14 to 16 (Debian 12's own),
and when $HOME is missing. So a child process renders a tiny scene, only exit code 0 counts, and the answer is
remembered.
"""

import json
import os
import subprocess
import sys
import tempfile
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from tacgen.base import array_cache

CUDA_VARIANT, LLVM_VARIANT, SCALAR_VARIANT = "cuda_ad_rgb", "llvm_ad_rgb", "scalar_rgb"
LLVM_VERSIONS = (22, 21, 20, 19, 18, 17)  # newest first; older ones abort drjit 1.5
LIBRARY_FOLDERS = (
    "/usr/lib/x86_64-linux-gnu",
    "/usr/lib/aarch64-linux-gnu",
    "/usr/lib64",
    "/usr/lib",
    "/usr/local/lib",
)
PROBE_TIMEOUT_S = 120  # a probe that takes longer has failed

PROBE_PROGRAM = """
import sys, mitsuba as mi
mi.set_variant(sys.argv[1])
scene = mi.load_dict({"type": "scene", "integrator": {"type": "path", "max_depth": 3}, "light": {"type": "constant"},
    "ball": {"type": "sphere"}, "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 4, "height": 4},
    "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 5], target=[0, 0, 0], up=[0, 1, 0])}})
import numpy as np
picture = np.array(mi.render(scene, spp=2))
sys.exit(0 if np.isfinite(picture).all() and picture.max() > 0 else 3)
"""


class VariantProbe(NamedTuple):
    """The outcome of one try."""

    variant: str
    library: str  # the LLVM_VARIANT library given to drjit, "" if none
    works: bool
    note: str


def environment(library: str = "") -> dict[str, str]:
    """The environment Mitsuba needs: a $HOME that exists, and the LLVM_VARIANT library of choice."""
    made = dict(os.environ)
    if not Path(made.get("HOME") or "/nonexistent").is_dir():
        made["HOME"] = tempfile.gettempdir()
    if library:
        made["DRJIT_LIBLLVM_PATH"] = library
    return made


def libraries() -> list[str]:
    """LLVM libraries worth a try: DRJIT_LIBLLVM_PATH first, then the newest found on the system."""
    paths = [os.environ["DRJIT_LIBLLVM_PATH"]] if os.environ.get("DRJIT_LIBLLVM_PATH") else []
    for number in LLVM_VERSIONS:
        folders = (*LIBRARY_FOLDERS, f"/usr/lib/llvm-{number}/lib")
        names = (f"libLLVM-{number}.so", f"libLLVM.so.{number}.1", f"libLLVM.so.{number}.0")
        here = [str(Path(f, n)) for f in folders for n in names if Path(f, n).is_file()]
        paths += here[:1]
    return list(dict.fromkeys(paths))


def probe(variant: str, library: str = "") -> VariantProbe:
    """Render a tiny scene in a child process; whatever kills that child costs this process nothing."""
    try:
        ran = subprocess.run(
            [sys.executable, "-c", PROBE_PROGRAM, variant],
            check=False,
            env=environment(library),
            capture_output=True,
            text=True,
            errors="replace",
            timeout=PROBE_TIMEOUT_S,
        )
    except (subprocess.TimeoutExpired, OSError) as error:
        return VariantProbe(variant, library, False, f"{type(error).__name__}")
    if ran.returncode == 0:
        return VariantProbe(variant, library, True, "renders")
    said = [line.strip() for line in ran.stderr.splitlines() if line.strip()]
    ended = f"killed by signal {-ran.returncode}" if ran.returncode < 0 else f"exit code {ran.returncode}"
    return VariantProbe(variant, library, False, f"{ended}{': ' + said[-1][:160] if said else ''}")


def variants() -> list[VariantProbe]:
    """Every variant of interest, best first, with the LLVM_VARIANT library it takes; answers are kept between runs."""
    return [_cuda(), _llvm(), _remembered(SCALAR_VARIANT, "")]


def best() -> VariantProbe:
    """The first variant that works: CUDA_VARIANT, then LLVM_VARIANT, then scalar (which is taken on trust)."""
    for attempt in (_cuda, _llvm):
        fastest = attempt()
        if fastest.works:
            return fastest
    return VariantProbe(SCALAR_VARIANT, "", True, "always there")


def _cuda() -> VariantProbe:
    if not any(Path(p).exists() for p in ("/dev/nvidiactl", "/dev/nvidia0", "/dev/dxg")):
        return VariantProbe(CUDA_VARIANT, "", False, "no NVIDIA device")
    return _remembered(CUDA_VARIANT, "")


def _llvm() -> VariantProbe:
    tries = [_remembered(LLVM_VARIANT, library) for library in libraries()]
    works = [t for t in tries if t.works]
    if works:
        return works[0]
    if tries:
        return tries[0]
    return VariantProbe(LLVM_VARIANT, "", False, "no LLVM 17 or newer found (Debian, Ubuntu: apt install libllvm19)")


def key(variant: str, library: str) -> str:
    """The key of an answer: versions, and the library's path and time stamp."""
    stamp = Path(library).stat().st_mtime_ns if library and Path(library).is_file() else 0
    return f"{variant} drjit-{version('drjit')} mitsuba-{version('mitsuba')} {library} {stamp}"


@cache
def _asked(question: str, variant: str, library: str, folder: str) -> VariantProbe:
    """`folder` is the cache's: another one, another answer."""

    def asked() -> bytes:
        return json.dumps(probe(variant, library)).encode()

    return VariantProbe(*json.loads(array_cache.kept_bytes("variants", array_cache.digest([question]), asked)))


def _remembered(variant: str, library: str) -> VariantProbe:
    return _asked(key(variant, library), variant, library, str(array_cache.cache_folder()))
