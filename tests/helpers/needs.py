"""The one rule for packages that need not be installed: the test, or the test module, that asks for one is skipped."""

from types import ModuleType

import pytest

# what the extras bring, by the names that are imported
EXTRAS = ("dask_jobqueue", "distributed", "mkdocs", "mujoco", "numcodecs", "pyarrow", "pymeshlab", "rerun", "torch")
EXTRAS += ("webdataset", "zarr")
# what tests alone use: simulators, a measure of pictures, and others' readers of what is exported
OTHERS = ("cv2", "datasets", "felupe", "lerobot", "pypardiso", "skimage", "vtk")


def needs(name: str) -> ModuleType:
    """The module `name` of one of these packages; where that is missing, the test that calls is skipped.

    Called at the top of a test module, before what imports the package, it skips the whole module.
    """
    package = name.partition(".")[0]
    assert package in EXTRAS + OTHERS, f"{package} is not in tests/helpers/needs.py"
    found: ModuleType = pytest.importorskip(name, reason=f"needs {package}, which is not installed")
    return found
