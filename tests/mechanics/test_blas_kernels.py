"""CVXOPT's BLAS has kernels for what the processor can do, also on processors that it does not know."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tacgen.mechanics import blas_kernels
from tacgen.mechanics.linear_solvers import available

AVX2, AVX512 = {"avx2", "fma", "sse4_2"}, {"avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl"}


@pytest.mark.parametrize(
    ("vendor", "flags", "name"),
    [
        ("GenuineIntel", AVX2 | AVX512, "SkylakeX"),  # Sapphire Rapids and later
        ("GenuineIntel", AVX2, "Haswell"),  # Alder Lake and later
        ("GenuineIntel", AVX2 | {"avx512f"}, "Haswell"),
        ("GenuineIntel", {"sse4_2"}, ""),
        ("AuthenticAMD", AVX2 | AVX512, ""),
        ("", set(), ""),
    ],
)
def test_kernels_fit_the_processor(vendor: str, flags: set[str], name: str) -> None:
    assert blas_kernels.kernels(vendor, flags) == name


def test_the_choice_is_of_cvxopt_alone_and_a_user_s_own_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blas_kernels, "_processor", lambda: ("GenuineIntel", AVX2))
    monkeypatch.delenv(blas_kernels.OPENBLAS_VARIABLE, raising=False)
    with blas_kernels._chosen():
        assert os.environ[blas_kernels.OPENBLAS_VARIABLE] == "Haswell"
    assert blas_kernels.OPENBLAS_VARIABLE not in os.environ
    monkeypatch.setenv(blas_kernels.OPENBLAS_VARIABLE, "Nehalem")
    with blas_kernels._chosen():
        assert os.environ[blas_kernels.OPENBLAS_VARIABLE] == "Nehalem"
    assert os.environ[blas_kernels.OPENBLAS_VARIABLE] == "Nehalem"


@pytest.mark.skipif("cholmod" not in available(), reason="no CVXOPT")
def test_the_library_takes_the_choice(tmp_path: Path) -> None:
    """In a process of its own: what is loaded stays. Nehalem's kernels run on any processor of 64 bit since 2008."""
    program = (
        "from tacgen.mechanics import blas_kernels as b\n"
        "b.KERNEL_INSTRUCTIONS = {'Nehalem': set()}\nb._processor = lambda: ('GenuineIntel', set())\nprint(b.report())"
    )
    environment = {name: value for name, value in os.environ.items() if name != blas_kernels.OPENBLAS_VARIABLE}
    said = subprocess.check_output([sys.executable, "-c", program], text=True, env=environment, cwd=Path.cwd())
    assert ", Nehalem, " in said
    assert float(said.split()[-2]) > 0
