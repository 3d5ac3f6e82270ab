"""The kernels of the OpenBLAS that CVXOPT brings, chosen by what the processor can do.

Version 0.3.15 (2021) chooses by a list of processors. Processors not on it, such as Intel's since Alder Lake and
Sapphire Rapids, get its oldest kernels, for SSE3. On a Xeon of model 207 these multiply matrices at 6 Gflop/s, the
SkylakeX kernels at 76 Gflop/s; a Cholesky factorisation by CHOLMOD takes 0.30 s with the first, 0.11 s with the other.
"""

import os
import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

OPENBLAS_VARIABLE = "OPENBLAS_CORETYPE"  # environment variable, read when the library is loaded
KERNEL_INSTRUCTIONS = {  # instructions that kernels of OpenBLAS need, best kernels first
    "SkylakeX": {"avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl"},
    "Haswell": {"avx2", "fma"},
}


def kernels(vendor: str, flags: set[str]) -> str:
    """Name of the kernels for an Intel processor; empty: OpenBLAS's own choice, which knows AMD's since Zen."""
    if vendor != "GenuineIntel":
        return ""
    return next((name for name, needs in KERNEL_INSTRUCTIONS.items() if needs <= flags), "")


def _processor() -> tuple[str, set[str]]:
    """Vendor and instructions, as Linux lists them."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return "", set()
    fields = {key.strip(): value for key, _, value in (line.partition(":") for line in reversed(lines))}
    return fields.get("vendor_id", "").strip(), set(fields.get("flags", "").split())


@contextmanager
def _chosen() -> Iterator[None]:
    """Libraries that are loaded in this block use the kernels for this processor, unless the user has chosen some."""
    name = kernels(*_processor())
    if OPENBLAS_VARIABLE in os.environ or platform.machine() != "x86_64" or not name:
        yield
        return
    os.environ[OPENBLAS_VARIABLE] = name
    try:
        yield
    finally:
        del os.environ[OPENBLAS_VARIABLE]


@cache
def cvxopt() -> Any:
    """The package CVXOPT with its module `cholmod`."""
    with _chosen():
        import cvxopt
        import cvxopt.cholmod
    return cvxopt


def report(n: int = 600) -> str:
    """Version, kernels and speed of CVXOPT's BLAS in products of matrices of n rows, on one thread."""
    from threadpoolctl import ThreadpoolController, threadpool_limits

    package = cvxopt()
    import cvxopt.blas as blas

    at = str(Path(package.__file__).parent)
    ours = [
        one for one in ThreadpoolController().info() if one["filepath"].startswith(at)
    ]  # cvxopt.libs lies beside it
    name = ", ".join(f"{one['internal_api']} {one['version']}, {one.get('architecture', '?')}" for one in ours)
    a, c = package.matrix(1.0, (n, n)), package.matrix(0.0, (n, n))
    with threadpool_limits(1, user_api="blas"):
        seconds = []
        for _ in range(5):
            start = time.perf_counter()
            blas.gemm(a, a, c)
            seconds.append(time.perf_counter() - start)
    return f"{name or 'BLAS of the system'}, {2e-9 * n**3 / min(seconds):.0f} Gflop/s"
