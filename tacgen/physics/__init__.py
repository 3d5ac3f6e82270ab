"""Each formula of the solver once, as Warp functions and kernels for a core and for a GPU."""

import os
import tempfile
from pathlib import Path

import warp as wp

from tacgen.base import array_cache, terminal


def _folder() -> str:
    """Where Warp keeps code for GPUs; it does not start without a folder that it can write."""
    folder = array_cache.cache_folder() / "warp"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return str(Path(tempfile.gettempdir()) / "tacgen-warp")
    return str(folder if os.access(folder, os.W_OK) else Path(tempfile.gettempdir()) / "tacgen-warp")


# Inlining up to 1000 instructions doubles the speed of tangents; Warp's own limit, 9000, compiles for a minute.
COMPILER_FLAGS = "-march=native -mllvm=-inline-threshold=1000 -mllvm=-slp-recursion-max-depth=4"
MAX_UNROLLED_STEPS = 3  # of a loop; more compiles for longer and runs no faster

wp.config.quiet, wp.config.log_level = True, wp.LOG_WARNING
wp.config.kernel_cache_dir = _folder()
with terminal.silent_errors():  # that there is no GPU
    wp.init()
# options of these modules alone: other simulators that are written in Warp may run in this process
for _name in ("tacgen.physics", "tacgen.batches", "tacgen.elimination", "tacgen.elimination_on_core", "tacgen.optics"):
    wp.set_module_options(
        {"max_unroll": MAX_UNROLLED_STEPS, "enable_backward": False, "cpu_compiler_flags": COMPILER_FLAGS},
        wp.get_module(_name),
    )
