"""The kernels of pictures compile for the H100, sm_90, on a machine that has no GPU."""

import importlib
from pathlib import Path

import warp as wp

from tacgen.physics.runtime import KERNEL_FILES, OPTICS


def test_kernels_of_pictures_compile_for_a_gpu(tmp_path: Path) -> None:
    for name in KERNEL_FILES[OPTICS]:
        importlib.import_module(f"tacgen.physics.{name}")
    (path,) = wp.compile_aot_module(OPTICS, arch=90, module_dir=tmp_path, use_ptx=True)
    for kernel in ("light", "projected", "counted", "outputs"):
        assert f"{kernel}_" in path.read_text()
