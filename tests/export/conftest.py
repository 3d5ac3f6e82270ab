"""Two finished scenes and a rejected one, which all exports read."""

from pathlib import Path

import pytest
from helpers.export_scenes import SENSOR, SHAPE, real
from helpers.synthetic import OUTPUTS, write

from tacgen.bundle.bundle import Bundle, read


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("export") / "loose"
    for i in range(2):
        known = {"scene_index": i, "values": {"start.x_mm": i / 2}, "sensor_document": SENSOR}
        write(out / f"scene-{i:05d}.h5", shape=SHAPE, outputs=OUTPUTS, edit=real, **known)
    write(out / "scene-00009.h5", stop=3)
    return out


@pytest.fixture(scope="session")
def scene(folder: Path) -> Bundle:
    return read(folder / "scene-00001.h5")
