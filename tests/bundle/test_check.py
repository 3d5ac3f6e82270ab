"""Every finding can be provoked, and a sound bundle gives none."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from helpers.synthetic import OUTPUTS, attributes, write
from hostile.mutations import reseal

from tacgen.base.errors import UserError
from tacgen.bundle.check import check


def lines(path: Path) -> list[str]:
    return [f.message for f in check(path)]


@pytest.mark.parametrize("outputs", [OUTPUTS, *({name} for name in sorted(OUTPUTS))], ids=lambda o: "-".join(sorted(o)))
def test_a_sound_bundle_gives_no_findings(tmp_path: Path, outputs: set[str]) -> None:
    assert check(write(tmp_path / "x.h5", outputs=frozenset(outputs))) == []


def spoil(name: str, where: Any, value: Any):
    """Set part of one dataset in frame 3."""

    def edit(index: int, arrays: dict[str, Any]) -> None:
        if index == 3:
            array = np.array(arrays[f"/frames/{name}"])
            array[where] = value
            arrays[f"/frames/{name}"] = array

    return edit


TOUCHED = (6, 8)  # a sample of the 12 x 16 map under the ball


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (spoil("force", 1, np.nan), "/frames/force is not finite at (3, 1)"),
        (spoil("height", TOUCHED, np.inf), "/frames/height is not finite at (3, 6, 8)"),
        (spoil("pose", (0, 0), 1.1), "/frames/pose is no rigid motion (frame 3)"),
        (spoil("pose", (3, 0), 1e-3), "/frames/pose is no rigid motion (frame 3)"),
        (spoil("rgb", ..., 90), "/frames/rgb is one flat colour (frame 3)"),
        (spoil("pressure", (0, 0), -0.01), "/frames/pressure pulls: -0.01 MPa (frame 3)"),
        (spoil("traction", TOUCHED, 0.1), "/frames/traction exceeds 0.6 x pressure by 0.0932 MPa (frame 3)"),
        (spoil("traction", (0, 0), 1e-3), "/frames/traction exceeds 0.6 x pressure by 0.00141 MPa (frame 3)"),
        (spoil("slip", (0, 0), True), "/frames/slip is set where there is no contact (frame 3)"),
        (spoil("quality/force_balance", ..., 2e-3), "forces do not balance: 0.002 of the force (frame 3)"),
        (spoil("markers", (0, 1), 5), "/frames/marker_flow is not markers less reference, off by 2 px (frame 3)"),
    ],
)
def test_one_wrong_frame_is_one_finding(tmp_path: Path, edit: Any, message: str) -> None:
    path = write(tmp_path / "x.h5", edit=edit)
    found = check(path)
    assert [f.level for f in found] == ["error"]
    if "markers" in message:
        assert found[0].message.startswith(message.partition(", off")[0])
    else:
        assert found[0].message == message
    assert str(found[0]) == f"{path}: error: {found[0].message}"


def nearly_flat(index: int, arrays: dict[str, Any]) -> None:
    if index == 3:
        rgb = np.full((48, 64, 3), 90, np.uint8)
        rgb[::2] += 2
        arrays["/frames/rgb"] = rgb


def fading(index: int, arrays: dict[str, Any]) -> None:
    """A touch that is nearly over, and pulls a thousandth of the scene's peak too far along the face."""
    if index == 3:
        arrays["/frames/pressure"] = 1e-3 * arrays["/frames/pressure"]
        arrays["/frames/traction"] = np.zeros((12, 16, 2))
        arrays["/frames/traction"][TOUCHED] = 0.6 * arrays["/frames/pressure"][TOUCHED] + 3e-7, 0.0


def flowing(index: int, arrays: dict[str, Any]) -> None:
    """Flow may be nan, and not infinite."""
    arrays["/frames/flow"] = np.zeros((12, 16, 2))
    arrays["/frames/flow"][3, 4] = np.nan if index != 3 else np.inf


def closing(index: int, arrays: dict[str, Any]) -> None:
    arrays["/frames/quality/min_gap_mm"] = -1e-4 if index in (2, 5) else 0.01


@pytest.mark.parametrize(
    ("edit", "findings"),
    [
        (nearly_flat, ["/frames/rgb is one flat colour (frame 3)"]),
        (fading, []),
        (flowing, ["/frames/flow is not finite at (3, 3, 4, 0)"]),
        (closing, ["the gel is inside the indenter: smallest gap -0.0001 mm (frames 2, 5)"]),
        (spoil("pressure", (0, 0), -5e-5), []),  # of a peak of .09: what interpolation may do
    ],
)
def test_what_rounding_and_noise_may_do_hides_no_finding(tmp_path: Path, edit: Any, findings: list[str]) -> None:
    assert lines(write(tmp_path / "x.h5", edit=edit)) == findings


def test_maps_of_the_face_are_nan_where_the_camera_looks_past_the_gel(tmp_path: Path) -> None:
    past: Any = np.zeros((12, 16), bool)
    past[:, :3] = True

    def edit(index: int, arrays: dict[str, Any]) -> None:
        for name, size in (("height", ()), ("gap", ()), ("normals", (3,))):
            arrays[f"/frames/{name}"] = np.where(past.reshape(past.shape + (1,) * len(size)), np.nan, np.ones(size))

    assert lines(write(tmp_path / "x.h5", edit=edit, outputs=frozenset({"force", "height"}))) == []


def repeating(*names: str, at: int):
    """Frame `at` is given what frame `at - 1` had."""
    kept: dict[str, Any] = {}

    def edit(index: int, arrays: dict[str, Any]) -> None:
        if index == at:
            arrays.update(kept)
        kept.update({name: arrays[name] for name in names})

    return edit


ROWS = ("pressure_resultant", "traction_resultant", "force_map_resultant", "unseen_force")


@pytest.mark.parametrize(
    ("name", "value", "messages"),
    [
        ("pressure_resultant", 0.051, ["/frames/pressure does not add up to the force, by 0.051 of it (frame 11)"]),
        ("traction_resultant", 0.2, ["/frames/traction does not add up to the force, by 0.2 of it (frame 11)"]),
        ("force_map_resultant", 1.6, ["/frames/force_map does not add up to the force, by 1.6 of it (frame 11)"]),
        ("unseen_force", 0.3,
         ["pressure and traction do not show gel that is hidden or outside the picture: 0.3 of the normal forces"]),
        ("pressure_resultant", 0.049, []),
    ],
)  # fmt: skip
def test_maps_that_miss_the_force_are_noted(tmp_path: Path, name: str, value: float, messages: list[str]) -> None:
    """And not in frames of light contact, whose forces are a thousandth of the scene's."""

    def edit(index: int, arrays: dict[str, Any]) -> None:
        arrays["/frames/force"] *= 1e-3 if index == 0 else 1
        arrays |= {f"/frames/quality/{row}": value if row == name and index in (0, 11) else 0.0 for row in ROWS}

    found = check(write(tmp_path / "x.h5", edit=edit))
    assert [f.level for f in found] == ["note"] * len(messages)
    assert all(f.message.startswith(text) for f, text in zip(found, messages, strict=True)), found


def test_repeated_frames(tmp_path: Path) -> None:
    both = ("/frames/pose", "/frames/force")
    (line,) = lines(write(tmp_path / "a.h5", edit=repeating(*both, at=2)))
    assert line == "pose and force repeat the frame before (frame 2)"
    (line,) = lines(write(tmp_path / "b.h5", edit=repeating("/frames/rgb", at=2)))
    assert line == "/frames/rgb repeats the frame before although the gel moved (frame 2)"
    assert lines(write(tmp_path / "c.h5", edit=repeating("/frames/force", at=6))) == [], "the pose moved on"
    whole = [repeating(*both, "/frames/rgb", at=k) for k in (9, 10, 11)]
    path = write(tmp_path / "e.h5", edit=lambda *frame: [edit(*frame) for edit in whole])
    assert lines(path) == [], "each frame of the last movement turns by 360 degrees"
    held = repeating(*both, "/frames/rgb", at=8)
    assert lines(write(tmp_path / "d.h5", edit=held)) == [], "the synthetic trajectory holds there"


def test_an_image_may_repeat_where_nothing_is_touched(tmp_path: Path) -> None:
    def edit(index: int, arrays: dict[str, Any]) -> None:
        if index < 2:
            arrays["/frames/rgb"] = np.arange(48 * 64 * 3).reshape(48, 64, 3).astype("u1")
            arrays["/frames/force"] = np.zeros(3)

    assert lines(write(tmp_path / "x.h5", edit=edit, outputs=frozenset({"force", "rgb"}))) == []


def retype(file: h5py.File) -> None:
    values = file["frames/force"][...].astype("f4")
    attrs = dict(file["frames/force"].attrs)
    del file["frames/force"]
    file["frames/force"] = values
    file["frames/force"].attrs.update(attrs)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (retype, "/frames/force has type <f4, expected <f8"),
        (lambda file: file["frames/force"].attrs.update(units="lbf"), "/frames/force has units 'lbf', expected 'N'"),
        (lambda file: file["frames/force"].attrs.update(axes="frame"), "/frames/force has axes 'frame'"),
        (lambda file: file.create_dataset("frames/colour", data=[1.0]), "format 1 has no dataset /frames/colour"),
        (lambda file: file["frames/height"].resize(3, axis=0), "/frames/height has shape (3, 12, 16), expected"),
        (lambda file: file.attrs.update(frames_planned=13), "12 frames, 13 planned, but status is ok"),
        (lambda file: file.attrs.update(status="fine"), "status is 'fine', expected 'ok' or 'rejected'"),
    ],
    ids=["type", "units", "axes", "path", "shape", "frames", "status"],
)  # fmt: skip
def test_a_file_that_is_not_laid_out_as_the_table_says(tmp_path: Path, change: Any, message: str) -> None:
    with h5py.File(write(tmp_path / "x.h5"), "a") as file:
        change(file)
    reseal(tmp_path / "x.h5", "/")  # as a faulty writer would
    found = lines(tmp_path / "x.h5")
    assert any(message in line for line in found), found


def test_a_folder_is_checked_file_by_file(tmp_path: Path) -> None:
    write(tmp_path / "good.h5")
    write(tmp_path / "deep" / "rejected.h5", stop=2)
    (tmp_path / "junk.h5").write_bytes(b"junk")
    (tmp_path / "scene.h5.tacgen-part-123").write_bytes(b"")
    (tmp_path / "scene.timing.json").write_text("{}")
    found = {f.path.name: f.level for f in check(tmp_path)}
    assert found == {"rejected.h5": "rejected", "junk.h5": "error", "scene.h5.tacgen-part-123": "incomplete"}
    assert [f.level for f in check(tmp_path / "scene.h5.tacgen-part-123")] == ["incomplete"]


def test_nothing_to_check(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no bundles"):
        check(tmp_path)
    with pytest.raises(UserError, match="no such file or folder"):
        check(tmp_path / "x.h5")


RECIPE = attributes()["recipe"]
DEEP = {**RECIPE, "trajectory": [{"press": {"depth_mm": 0.7, "frames": 12}}]}
COLOURS = {"camera": {"exposure": 1.0, "gain": [0.8, 0.8, 0.8]}, "gel": {"layers": [{"name": "g"}]}}


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"trajectory[0].press.depth_mm": 0.7, "trajectory": [{"press": {"depth_mm": 0.2}}]}, ""),
        ({"sensor.camera.gain": 0.8, "sensor.gel": {"layers": [{"name": "g"}]}, "sensor": "gelsight_mini"}, ""),
        ({"dynamics": None}, ""),
        ({"trajectory[0].press.depth_mm": 0.5}, "trajectory[0].press.depth_mm is 0.5 among its values, and 0.7 in"),
        ({"trajectory": [{"press": {"depth_mm": 0.2}}]}, "trajectory is a list among its values, and a list in its"),
        ({"trajectory[4].press.depth_mm": 0.5}, "trajectory[4].press.depth_mm is 0.5 among its values, and nothing in"),
        ({"sensor.camera.exposure": 2.0}, "sensor.camera.exposure is 2 among its values, and 1 in its recipe"),
        ({"sensor": "digit"}, "sensor is 'digit' among its values, and 'gelsight_mini' in its recipe"),
    ],
)
def test_varied_values_are_those_of_the_resolved_recipe(tmp_path: Path, values: dict[str, Any], message: str) -> None:
    changes = {"recipe": DEEP, "values": values, "sensor_document": COLOURS}
    found = lines(write(tmp_path / "x.h5", outputs=frozenset({"force"}), **changes))
    assert [line.startswith(message) for line in found] == [True] * bool(message), found
