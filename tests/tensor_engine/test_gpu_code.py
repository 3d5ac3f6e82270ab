"""Code for a GPU, which is compiled on a machine without one too."""

from pathlib import Path

import warp as wp
from helpers.needs import needs

from tacgen.physics import elimination, runtime

needs("torch")  # as the engine does that runs it


def test_numbers_of_an_elimination_stay_in_registers(tmp_path: Path) -> None:
    """Rows whose index the compiler does not know, and functions that it does not inline, would be in a memory in which
    an elimination takes eight times as long."""
    (path,) = wp.compile_aot_module(runtime.ELIMINATION, arch=90, module_dir=tmp_path, use_ptx=True)
    code = Path(path).read_text()
    assert code.count(".entry") == sum(isinstance(part, wp.Kernel) for part in vars(elimination.ON_GPU).values())
    assert ".local" not in code
    assert "call.uni" not in code
