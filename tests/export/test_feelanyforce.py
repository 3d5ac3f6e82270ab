"""FeelAnyForce's tables, read by the rules of its TacForceDataset, which joins paths as text."""

import csv
from pathlib import Path

import numpy as np
import pytest
from helpers.export_scenes import FRAMES, SENSOR, SHAPE, real
from helpers.synthetic import OUTPUTS, write
from PIL import Image

from tacgen.base.errors import UserError
from tacgen.bundle.bundle import Bundle
from tacgen.export import export

LOW, HIGH, BIAS = -8.311515796355053, 27.03226967220051, 5  # by which it scales depths


def rows(base: str, split: str) -> list[dict[str, str]]:
    with open(f"{base}TacForce_{split}_set.csv", encoding="utf-8") as file:
        return [{**row, "tactile": base + row["tactile"], "depth": base + row["depth"]} for row in csv.DictReader(file)]


@pytest.mark.slow
def test_its_loader_finds_pictures_depths_and_wrenches(folder: Path, scene: Bundle, tmp_path: Path) -> None:
    base = f"{tmp_path.parent / 'faf'}/"  # a path without the word it replaces
    export("feelanyforce", folder, Path(base))
    read = rows(base, "train")
    assert len(read) == 2 * FRAMES
    assert rows(base, "val") == rows(base, "test") == []
    for k in (0, 5, 11):
        row = read[FRAMES + k]
        assert np.array_equal(Image.open(row["tactile"]), scene.frame("/frames/rgb", k))
        plain = np.asarray(Image.open(row["tactile"].replace("tactile", "tactile_nobg"))).astype(int)
        assert np.array_equal(
            plain, np.clip(scene.frame("/frames/rgb", k) - scene["/reference/rgb"].astype(int) + 127, 0, 255)
        )
        numbers = np.array(row["FT"].split(" "), float)
        assert numbers[:3] == pytest.approx(-scene.frame("/frames/force", k), abs=1e-6)
        assert numbers[3:] == pytest.approx(-scene.frame("/frames/torque", k) / 1000, abs=1e-6)
        depth = np.load(row["depth"])
        assert (depth.shape, depth.dtype) == (SHAPE, np.float32)
        scaled = (depth - (LOW - BIAS)) / (2 * BIAS + HIGH - LOW)
        assert (scaled > 0).all()
        assert (scaled < 1).all()
        mm = depth.reshape(60, 4, 80, 4).mean((1, 3)) * SENSOR["camera"]["mm_per_px"]
        assert mm == pytest.approx(-scene.frame("/frames/height", k), abs=0.02)
        assert numbers[2] > 0
        assert depth.max() > 0
    assert np.array_equal(Image.open(f"{base}tactile/background.png"), scene["/reference/rgb"])


@pytest.mark.parametrize("kind", ["FeelAnyForce", "FEATS"])
def test_other_pictures_are_refused(tmp_path: Path, kind: str) -> None:
    write(tmp_path / "scene.h5", outputs=OUTPUTS, edit=real)
    with pytest.raises(UserError, match=f"{kind} takes images of 240 x 320 pixels, these have 48 x 64"):
        export(kind.lower(), tmp_path, tmp_path / "out")
