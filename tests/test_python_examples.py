"""The examples run at toy size, each writes its picture, and each is short."""

import struct
from pathlib import Path

import pytest
from helpers.program import loaded

PROGRAMS = {"baselines", "force_transfer"}  # of their own, with tests of their own
EXAMPLES = sorted(path for path in (Path(__file__).parents[1] / "examples").glob("*.py") if path.stem not in PROGRAMS)
COARSE = {"edge_mm": 0.75, "dhat_mm": 0.1, "spp": 4}
FEW = {"steps": 2, "frames_held": 2, "samples": 2, "sensors": ("gelsight_mini",)}
# several scenes each, images, and processes that start; the others cover the same calls
LONG = {"ball_sizes", "camera_image", "data_set", "expected_error", "gel_thickness", "material_laws", "stick_to_slip"}
LONG |= {"stress_section", "twist"}


@pytest.mark.parametrize(
    "path",
    [pytest.param(path, id=path.stem, marks=[pytest.mark.slow] * (path.stem in LONG)) for path in EXAMPLES],
)
def test_an_example_writes_its_picture(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MPLBACKEND", "Agg")
    main = loaded(path).main
    few = {name: value for name, value in FEW.items() if name in main.__code__.co_varnames[: main.__code__.co_argcount]}
    main(tmp_path, quality=COARSE, **few)
    picture = (tmp_path / f"{path.stem}.png").read_bytes()
    width, height = struct.unpack(">II", picture[16:24])
    assert min(width, height) >= 300
    assert len(picture) > 8000


def test_examples_are_many_and_short() -> None:
    assert len(EXAMPLES) >= 12
    for path in EXAMPLES:
        text = path.read_text()
        assert len(text.splitlines()) <= 40, path
        assert f"python examples/{path.name} [FOLDER]" in text.splitlines()[0]
        assert "from tacgen" not in text, f"{path}: the public names alone"
