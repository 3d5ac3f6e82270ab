"""Pictures of bundles: something is drawn, and only what is there."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command import refused, told
from helpers.synthetic import OUTPUTS, attributes, write
from matplotlib.image import imread

from tacgen.base.errors import UserError
from tacgen.bundle.bundle import read
from tacgen.bundle.force_error import ERROR_BY_MESH, ForceError
from tacgen.optics.camera import PinholeCamera
from tacgen.recipe import assets, loading
from tacgen.report import bundle_figure, frame_curves


def drawn(path: Path, **scene: Any) -> Any:
    """The figure of a bundle that is written there."""
    return bundle_figure.figure(read(write(path, **scene)))


def pixels(figure: Any, path: Path) -> np.ndarray:
    bundle_figure.save(figure, path)
    return np.asarray(imread(path))[..., :3]


def test_a_picture_has_frames_from_first_to_last_with_y_down_and_is_not_blank(tmp_path: Path) -> None:
    figure = drawn(tmp_path / "x.h5")
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert (len(titles), titles[0], titles[-1]) == (5, "frame 0\npress", "frame 11\ntwist")
    first = figure.axes[0]
    assert (first.get_xlim(), first.get_ylim()) == ((0, 64), (48, 0))
    (camera,) = first.get_images()
    assert camera.origin == "upper"
    assert [c.angles for c in first.collections if type(c).__name__ == "Quiver"] == ["xy"]
    seen = pixels(figure, tmp_path / "x.png")
    assert seen.shape[0] > 800
    assert 1200 < seen.shape[1] < 1400  # at a page's width, some 900 pixels, its text is still read
    assert len(np.unique((seen * 255).astype(int).reshape(-1, 3), axis=0)) > 200
    assert 0.1 < (seen < 0.99).any(axis=-1).mean() < 0.9


@pytest.mark.parametrize(
    ("outputs", "rows"),
    [
        ({"force"}, []),
        ({"force", "rgb"}, ["camera"]),
        ({"markers"}, ["camera"]),
        ({"height"}, ["height", "change of z [mm]"]),
        ({"traction"}, ["pressure", "pressure [MPa]", "traction", "traction [MPa]"]),
        (OUTPUTS, ["camera", "pressure", "pressure [MPa]", "traction", "traction [MPa]", "height", "change of z [mm]"]),
    ],
)  # fmt: skip
def test_only_what_is_there_is_drawn(tmp_path: Path, outputs: set[str], rows: list[str]) -> None:
    labels = (axes.get_ylabel() for axes in drawn(tmp_path / "x.h5", outputs=frozenset(outputs)).axes)
    found = [label.partition("\n")[0] for label in labels if label]  # the rows, their colour bars and the force plot
    assert sorted(found) == sorted([*rows, "force on gel [N]"])


def test_no_text_lies_over_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of those in the force's panel and below."""
    error = lambda bundle: ForceError(np.full(bundle.frames, 0.04), ERROR_BY_MESH)  # noqa: E731
    monkeypatch.setattr(frame_curves, "force_error", error)
    figure = drawn(tmp_path / "x.h5")
    figure.canvas.draw()
    panel = next(axes for axes in figure.axes if "force" in axes.get_ylabel())
    texts = [*figure.texts, *panel.texts, panel.xaxis.label, panel.yaxis.label]
    assert any("largest force" in text.get_text() for text in texts)
    boxes = [(text.get_text(), text.get_window_extent()) for text in texts]
    over = [(a, b) for i, (a, one) in enumerate(boxes) for b, other in boxes[:i] if a != b and one.overlaps(other)]
    assert over == []


def test_markers_alone_use_the_camera_of_the_sensor(tmp_path: Path) -> None:
    document = loading.read_sensor(assets.sensor_path("gelsight_mini"))[0].model_dump(mode="json", exclude_none=True)
    document["camera"] |= {"width_px": 640, "height_px": 480}
    figure = drawn(tmp_path / "x.h5", outputs=frozenset({"markers"}), sensor_document=document)
    assert figure.axes[0].get_xlim() == (0, 640)


def test_height_is_its_change_on_a_scale_of_its_own_beside_holes(tmp_path: Path) -> None:
    def edit(index: int, arrays: dict[str, Any]) -> None:
        arrays["/frames/height"][0, 0] = np.nan

    (image,) = drawn(tmp_path / "x.h5", outputs=frozenset({"height"}), edit=edit).axes[4].get_images()
    assert image.norm.vmin == pytest.approx(np.nanmin(read(tmp_path / "x.h5")["/frames/height"]))
    assert np.ptp(image.to_rgba(image.get_array())[..., 0]) > 0.5


def test_a_dome_is_drawn_by_what_has_changed(tmp_path: Path) -> None:
    dome = -np.hypot(*np.mgrid[-6:6, -8:8]) / 2

    def edit(index: int, arrays: dict[str, Any]) -> None:
        arrays["/frames/height"] = dome - 0.1 * index

    known = {"outputs": frozenset({"height"}), "reference_height": dome}
    (image,) = drawn(tmp_path / "x.h5", edit=edit, **known).axes[4].get_images()
    assert np.asarray(image.get_array()) == pytest.approx(-1.1, abs=2**-16)  # stored heights are rounded


def test_axes_are_in_mm_of_the_untouched_face(tmp_path: Path) -> None:
    """As the sensor's camera sees it, cropped and off the middle."""
    sensor = loading.read_sensor(assets.sensor_path("digit"))[0]
    moved = {"center_mm": (0.3, -0.2), "crop_mm": (0.1, 0.4), "tilt_deg": (0.0, 0.0), "width_px": 64, "height_px": 48}
    sensor = sensor.model_copy(update={"camera": sensor.camera.model_copy(update=moved)})
    known = {"outputs": frozenset({"rgb"}), "sensor_document": sensor.model_dump_json()}
    panel = drawn(tmp_path / "x.h5", **known).axes[0]
    assert panel.get_ylabel().endswith("y [mm]")
    assert panel.get_xlabel() == "x [mm]"
    camera = PinholeCamera.from_sensor(sensor)
    for axis, lines in enumerate((panel.xaxis, panel.yaxis)):
        assert len(lines.get_ticklocs()) >= 2
        for tick, text in zip(lines.get_ticklocs(), lines.get_ticklabels(), strict=True):
            at = np.zeros((1, 3))
            at[0, axis] = float(text.get_text().replace("\N{MINUS SIGN}", "-"))
            assert camera.project(at)[0, axis] == pytest.approx(tick, abs=0.05)  # rays bend


def test_a_folder_of_one_scene_is_drawn_and_of_several_is_asked_about(tmp_path: Path) -> None:
    write(tmp_path / "scene-00000.h5")
    told("show", tmp_path, "-o", tmp_path / "x.png")
    assert (tmp_path / "x.png").stat().st_size > 5000
    write(tmp_path / "scene-00001.h5")
    several = f"{tmp_path}: holds 2 bundles; draw one, such as {tmp_path}/scene-00000.h5, or all: tacgen"
    assert several in refused("show", tmp_path, "-o", tmp_path / "y.png")


@pytest.mark.parametrize("stop", [0, 1])
def test_a_rejected_scene_says_so(tmp_path: Path, stop: int) -> None:
    figure, why = drawn(tmp_path / "x.h5", stop=stop), f"frame {stop} of 12: Newton's method stalled"
    assert f"rejected: {why}" in [text.get_text() for text in figure.texts]
    assert pixels(figure, tmp_path / "x.png").std() > 0.01
    assert f"status    rejected ({why})" in bundle_figure.summary(tmp_path / "x.h5").splitlines()


def test_no_picture_without_a_bundle_or_of_an_unknown_kind(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no such file"):
        bundle_figure.only(tmp_path / "x.h5")
    with pytest.raises(UserError, match=r"^\.doc: unknown kind of picture, use one of .*\.png"):
        bundle_figure.save(drawn(tmp_path / "x.h5"), tmp_path / "x.doc")


def test_the_summary_names_the_peaks(tmp_path: Path) -> None:
    lines = bundle_figure.summary(write(tmp_path / "x.h5")).splitlines()
    assert lines[0].endswith("x.h5: synthetic, gelsight_mini, sphere, radius 4 mm")
    assert "frames    12 of 12: press 4, slide 3, hold 2, twist 3" in lines
    assert "force     largest in frame 5: Fx 0.648, Fy 0.000, Fz -1.200 N on the gel" in lines
    assert any(line.startswith("pressure  largest in frame ") and line.endswith(" MPa") for line in lines)
    assert not any(line.startswith("note") for line in lines)
    assert "note      sharp" in bundle_figure.summary(write(tmp_path / "y.h5", notes=["sharp"])).splitlines()


def test_the_summary_of_a_mesh_keeps_words_and_columns_apart(tmp_path: Path) -> None:
    recipe = attributes()["recipe"] | {"indenter": {"shape": "mesh", "file": "gear", "up": "+z", "scale": 2.0}}

    def longer(index: int, arrays: dict[str, Any]) -> None:
        arrays["/frames/quality/pressure_oscillation"] = 0.1

    lines = bundle_figure.summary(write(tmp_path / "x.h5", recipe=recipe, edit=longer)).splitlines()
    assert lines[0].endswith("gear, scale 2")
    rows = [line for line in lines if line.startswith(("/frames/", "/mesh/"))]
    assert len(rows) > 10
    assert len({line.rindex("  ") for line in rows}) == 1


def test_a_single_frame_fills_the_page_and_shows_its_force(tmp_path: Path) -> None:
    figure = drawn(tmp_path / "x.h5", frames=1)
    places = [axes.get_position() for axes in figure.axes if axes.get_images()]
    assert len({round(place.y0, 6) for place in places}) == 1  # side by side
    assert all(a.x1 < b.x0 for a, b in pairwise(places))
    assert (places[0].x0 < 0.1, places[-1].x1 > 0.85) == (True, True)
    (forces,) = [axes for axes in figure.axes if "force" in axes.get_ylabel()]
    points = [line for line in forces.lines if line.get_marker() == "o"]
    assert [len(line.get_xdata()) for line in points] == [1, 1, 1]


def test_a_grasp_shows_its_lift_and_its_fall(tmp_path: Path) -> None:
    lift, fall = np.linspace(0, 5, 12), np.linspace(0, 0.5, 12)

    def grasped(index: int, arrays: dict[str, Any]) -> None:
        sensor, body = np.eye(4), np.eye(4)
        sensor[2, 3], body[2, 3] = lift[index], lift[index] - fall[index] - 5
        arrays |= {"/frames/grasp/sensor": sensor, "/frames/grasp/object": body}
        arrays["/frames/grasp/mode"] = 2 if index > 9 else 1

    (panel,) = [axes for axes in drawn(tmp_path / "x.h5", edit=grasped).axes if "lift" in axes.get_ylabel()]
    fingers, body, falls = (np.array(line.get_xydata()) for line in panel.lines)
    assert fingers[:, 1] == pytest.approx(lift)
    assert body[:, 1] == pytest.approx(lift - fall)
    assert falls[:, 0].tolist() == [10, 11]
