"""Pictures in linear light: what the bundle holds comes back from OpenEXR's own reader, to the bit."""

import errno
from io import FileIO
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from helpers import synthetic, whole_bundle
from helpers.small_recipe import PICTURE

from tacgen.base.errors import UserError
from tacgen.batch import pipeline
from tacgen.bundle import bundle
from tacgen.bundle.check import check
from tacgen.export import export
from tacgen.export.exr import write
from tacgen.optics import camera_response
from tacgen.optics.camera import PinholeCamera
from tacgen.recipe import plan

RECIPE = f"{PICTURE}outputs: [rgb, radiance, height, normals, material]\n"


def test_every_channel_comes_back(tmp_path: Path) -> None:
    (tmp_path / "light.yaml").write_text(RECIPE)
    row = plan.load(tmp_path / "light.yaml").rows[0]
    path = pipeline.run_scene(row, tmp_path / "out").path
    assert check(path) == []
    (made,) = export("exr", path, tmp_path / "exr")
    scene = bundle.read(path)
    with OpenEXR.File(str(made), separate_channels=True) as picture:
        found = {name: channel.pixels for name, channel in picture.channels().items()}
    assert set(found) == {"R", "G", "B", "Z", "N.X", "N.Y", "N.Z", "P.X", "P.Y"}
    light = np.stack([found[c] for c in "RGB"], -1)
    assert np.array_equal(light, scene["/frames/radiance"][0])
    assert np.array_equal(camera_response.develop(light.astype(float), row.sensor.camera), scene["/frames/rgb"][0])
    assert np.array_equal(found["Z"], scene["/frames/height"][0])
    assert np.array_equal(found["N.Z"], scene["/frames/normals"][0, ..., 2])
    rest = np.stack([found["P.X"], found["P.Y"]], -1)
    assert np.array_equal(rest, scene["/frames/material"][0])
    middle = np.array(row.sensor.camera.crop_mm)
    assert rest[24, 32] == pytest.approx(middle + 0.15, abs=0.05)  # the pixel right of and below the middle
    # the camera's scale holds on its axis; refraction in the thick plate makes it 5 % smaller at the edge
    assert 0.93 < (rest[24, 63, 0] - middle[0]) / (31.5 * 0.317) < 0.96
    camera = PinholeCamera.from_sensor(row.sensor)
    assert camera.project([[*rest[24, 63], 0.0]])[0] == pytest.approx([63.5, 24.5], abs=0.05)  # linear between nodes


def test_a_bundle_without_radiance_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="outputs need radiance"):
        export("exr", synthetic.write(tmp_path / "scene.h5"), tmp_path / "exr")


def test_a_full_disk_is_an_error_of_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenEXR itself says nothing of a disk that is full as it closes a small file."""
    scene = bundle.read(whole_bundle.write(tmp_path / "scene-00000.h5", frames=1))
    monkeypatch.setattr(Path, "open", lambda path, mode: FileIO("/dev/full", "w"))
    with pytest.raises(OSError, match="No space left") as caught:
        write([scene], tmp_path)
    assert caught.value.errno == errno.ENOSPC
