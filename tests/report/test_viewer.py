"""The page to look at bundles, and a folder's: what they hold, that they need nothing else, what a browser shows."""

import base64
import io
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from helpers import small_recipe
from helpers.command import refused, told
from helpers.synthetic import attributes, write
from PIL import Image

from tacgen.batch import pipeline
from tacgen.bundle.bundle import read
from tacgen.report import scene_pages, viewer
from tacgen.report.field_figure import DRAWN_FIELDS
from tacgen.report.plane_cut import boundary

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")


def data(page: Path) -> Any:
    """What the page gives to its script."""
    (text,) = re.findall(r'<script type="application/json" id=viewed>(.*?)</script>', page.read_text(), re.S)
    return json.loads(text)


def levels(text: str) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(text))))


def array(text: str, kind: str, *shape: int) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), kind).reshape(-1, *shape)


def test_maps_are_levels_of_their_scale_and_nan_is_none(tmp_path: Path) -> None:
    def hole(index: int, arrays: dict[str, Any]) -> None:
        arrays["/frames/height"][0, 0] = np.nan

    path = write(tmp_path / "x.h5", edit=hole)
    viewer.write([path], tmp_path / "x.html")
    shown, bundle = data(tmp_path / "x.html"), read(path)
    assert shown["layers"] == ["camera", "markers", "pressure", "traction", "height", "stress"]
    scale, (only,) = shown["scales"]["pressure"], shown["bundles"]
    seen = levels(only["layers"]["pressure"]["pictures"][7])
    value = scale["low"] + (seen - 1.0) / 254 * (scale["high"] - scale["low"])
    assert value == pytest.approx(bundle.frame("/frames/pressure", 7), abs=0.51 * scale["high"] / 254)
    height = levels(only["layers"]["height"]["pictures"][3])
    assert np.argwhere(height == 0).tolist() == [[0, 0]]
    assert levels(only["layers"]["camera"]["pictures"][0]).shape == (48, 64, 3)
    assert only["force"][5] == pytest.approx(bundle["/frames/force"][5].tolist(), abs=1e-5)


def test_two_bundles_have_one_scale(tmp_path: Path) -> None:
    def harder(index: int, arrays: dict[str, Any]) -> None:
        arrays["/frames/pressure"] = arrays["/frames/pressure"] * 3

    paths = [write(tmp_path / "a.h5"), write(tmp_path / "b.h5", edit=harder, outputs=frozenset({"traction"}))]
    told("view", *paths, "-o", tmp_path / "x.html")
    both = data(tmp_path / "x.html")["bundles"]
    tops = [max(levels(map_).max() for map_ in b["layers"]["pressure"]["pictures"]) for b in both]
    assert tops[0] == pytest.approx(1 + 254 / 3, abs=1)
    assert tops[1] == 255
    assert "height" not in both[1]["layers"]
    assert both[1]["solid"] is None


def test_the_page_asks_for_no_file_and_names_are_text(tmp_path: Path) -> None:
    name = "</script><img src=//x.test/y onerror=alert(1)>"
    viewer.write([write(tmp_path / "x.h5", recipe=attributes()["recipe"] | {"name": name})], tmp_path / "x.html")
    page = (tmp_path / "x.html").read_text()
    assert "<img" not in page
    assert "default-src 'none'" in page
    assert page.count("<script") == page.count("</script") == 2
    script = page.rpartition("<script>")[2]
    assert not re.findall(r"https?:|//\w+\.|\bfetch|\bimport|XMLHttp|innerHTML", script)
    assert re.findall(r"\.src = (.{6})", script) == ["`data:"]
    assert data(tmp_path / "x.html")["bundles"][0]["name"] == f"{name}, x"


def test_long_scenes_are_thinned_and_empty_ones_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewer, "MAX_VIEWER_FRAMES", 4)
    viewer.write([write(tmp_path / "x.h5")], tmp_path / "x.html")
    assert data(tmp_path / "x.html")["bundles"][0]["frames"] == [0, 4, 5, 7, 11]  # 5: the largest force
    said = refused("view", write(tmp_path / "none.h5", stop=0), "-o", tmp_path / "y.html")
    assert said == f"{tmp_path}/none.h5: has no frames to show\n"


def test_a_mesh_with_missing_nodes_is_one_line(tmp_path: Path) -> None:
    path = write(tmp_path / "x.h5")
    with h5py.File(path, "a") as file:
        file["mesh/cells"][...] += 5
    said = refused("view", path, "-o", tmp_path / "x.html")
    assert said == f"{path}: damaged: /mesh/cells has values beyond 0 to 7\n"


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page of a ball really pressed into a small gel, with its stress."""
    folder = tmp_path_factory.mktemp("solved")
    row = small_recipe.row("press: {depth_mm: 0.4, frames: 2}", "outputs=[traction, stress]")
    viewer.write([pipeline.run_scene(row, folder / "out").path], folder / "page.html")
    return folder / "page.html"


def test_the_solid_is_the_deformed_gel(solved: Path) -> None:
    bundle, solid = read(next((solved.parent / "out").glob("*.h5"))), data(solved)["bundles"][0]["solid"]
    points, faces = array(solid["points"][1], "<f4", 3), array(solid["faces"], "<u4", 3)
    now = bundle["/mesh/points"] + bundle.frame("/fields/displacement", 1)
    assert points == pytest.approx(now[np.unique(boundary(bundle["/mesh/cells"]))], abs=1e-5)
    a, b, c = np.moveaxis(points[faces].astype(float), 1, 0)
    volume = float(np.einsum("ti,ti->", a, np.cross(b, c))) / 6  # of a closed surface seen from outside
    sides = np.ptp(bundle["/mesh/points"], axis=0)
    assert 0.9 < volume / np.prod(sides) < 1.02
    cut = array(solid["cuts"][1]["points"], "<f4", 3, 3)
    area = np.linalg.norm(np.cross(cut[:, 1] - cut[:, 0], cut[:, 2] - cut[:, 0]), axis=1).sum() / 2
    assert 0.85 < area / (sides[0] * sides[2]) < 1.0
    assert [len(base64.b64decode(text)) for text in solid["values"][1]] == [len(points)] * 3


def browser(page: Path, part: str, *wanted: str) -> str:
    assert CHROMIUM is not None
    command = [CHROMIUM, "--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    command += [f"--user-data-dir={page.parent / 'profile'}", "--window-size=640,760", "--hide-scrollbars"]
    command += ["--virtual-time-budget=4000", *wanted, f"{page.as_uri()}#{part}"]
    return subprocess.run(command, capture_output=True, text=True, timeout=200).stdout


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
def test_a_browser_shows_maps_and_the_solid(solved: Path) -> None:
    assert ">frame 1, press</p>" in browser(solved, "layer=pressure&frame=1", "--dump-dom")
    share = {}
    for layer in ("pressure", "traction", "stress"):
        browser(solved, f"layer={layer}&frame=1", f"--screenshot={solved.parent / layer}.png")
        seen = np.asarray(Image.open(solved.parent / f"{layer}.png").convert("RGB"), int)[150:520, 60:470]
        share[layer] = float((np.ptp(seen, axis=-1) > 60).mean())  # of strong colours
    assert share["pressure"] > 0.3  # viridis begins with dark violet
    assert 0.001 < share["stress"] < 0.3  # the stressed part of a pale gel


USED = """<script>setTimeout(() => {
  const slider = document.querySelector("input[type=range]"), force = document.querySelector("canvas.force");
  const texts = () => [...document.querySelectorAll(".viewer p")].map((p) => p.textContent).join("|");
  const at = (kind, target, x, y) => {
    const { left, top } = target.getBoundingClientRect();
    target.dispatchEvent(new PointerEvent(kind, { clientX: left + x, clientY: top + y, bubbles: true }));
  };
  slider.value = 7;
  slider.dispatchEvent(new Event("input"));
  document.querySelector("[value=pressure]").click();
  setTimeout(() => {
    at("pointermove", document.querySelectorAll(".stage canvas")[1], 250, 160);
    const said = [texts()];
    at("click", force, 55, 50);
    document.body.append(["USED", ...said, texts(), slider.value].join(";"));
  }, 500);
}, 300)</script></body>"""


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
def test_slider_pointer_and_force_plot_can_be_used(tmp_path: Path) -> None:
    viewer.write([write(tmp_path / "x.h5")], tmp_path / "x.html")
    page = (tmp_path / "x.html").read_text()
    (tmp_path / "used.html").write_text(page.replace("</body>", USED))
    shown = browser(tmp_path / "used.html", "", "--dump-dom").rpartition("USED;")[2].partition("<")[0]
    moved, clicked, slider = shown.split(";")
    assert moved.startswith(f"frame 7, {read(tmp_path / 'x.h5').segments[7]}|A sphere, radius 4 mm, on ")
    assert "|x 45" in moved
    assert moved.endswith("(pressure [MPa])")
    assert clicked.startswith("frame 0, press|")
    assert slider == "0"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "data").mkdir()
    write(tmp_path / "data/scene-00000.h5")
    write(tmp_path / "data/scene-00001.h5", stop=3)
    return tmp_path / "data"


def test_a_folder_is_a_list_with_a_page_of_each_scene(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "list.html"
    assert told("view", folder, "-o", out) == f"{out}\n"
    page = out.read_text()
    links = re.findall(r'<a target=scene href="([^"#]+)#frame=(\d+)">([^<]+) \(\d+\)</a>', page)
    found = {(Path(link).stem, what): int(frame) for link, frame, what in links}
    force = np.linalg.norm(read(folder / "scene-00000.h5")["/frames/force"], axis=1)
    assert found["scene-00000", "largest force"] == int(force.argmax())
    assert found["scene-00001", "last before rejection"] == 2
    assert ("scene-00000", "last before rejection") not in found
    for link, *_ in links:
        assert "id=viewed" in (tmp_path / link).read_text()
    assert 'data-state="rejected"' in page
    told("view", folder, "-o", out)  # its own pages are replaced


def test_pictures_of_a_report_lead_to_the_frame_that_they_show(folder: Path) -> None:
    told("report", folder)
    links = re.findall(r'<a target=scene href="([^"#]+)#frame=(\d+)"><img', (folder / "report.html").read_text())
    assert [Path(link).stem for link, _ in links] == ["scene-00000", "scene-00001"]
    for link, frame in links:
        assert int(frame) == viewer.marks(read(folder / f"{Path(link).stem}.h5"))[viewer.LARGEST_FORCE_LABEL]
        assert (folder / link).is_file()


def test_of_many_scenes_the_rejected_ones_have_pages_first(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_pages, "MAX_SCENE_PAGES", 1)
    out = folder.parent / "list.html"
    assert told("view", folder, "-o", out) == f"{out}: 1 scenes have no page\n"
    assert [page.name for page in (folder.parent / "list_scenes").iterdir()] == ["scene-00001.html"]


def test_show_draws_every_layer_of_the_viewer() -> None:
    assert {*viewer.LAYER_DATASETS} <= {*DRAWN_FIELDS}


@pytest.mark.parametrize("field", ["camera", "markers", "height"])
def test_a_layer_is_drawn(field: str, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "one.png"
    told("show", folder / "scene-00000.h5", "--field", field, "-o", out)
    assert out.stat().st_size > 10_000


FILTERED = """<script>
  const all = () => [...document.querySelectorAll(".scene")];
  const seen = () => all().filter((item) => !item.hidden).map((item) => item.dataset.index);
  const after = (name, value) => {
    const field = document.getElementById(name);
    field.value = value;
    field.dispatchEvent(new Event("input"));
    return `${seen()} (${document.getElementById("count").textContent})`;
  };
  const steps = [["state", "rejected"], ["state", ""], ["words", "SCENE-00000"], ["words", ""], ["movement", "press"],
    ["movement", ""]];
  document.body.append(["USED", ...steps.map(([name, value]) => after(name, value)), after("order", "peak")].join(";"));
</script></body>"""


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
@pytest.mark.parametrize("command", ["view", "report"])
def test_filters_choose_scenes_in_a_browser(command: str, folder: Path) -> None:
    def harder(index: int, arrays: dict[str, Any]) -> None:
        arrays["/frames/force"] = 3 * arrays["/frames/force"]

    write(folder / "scene-00002.h5", edit=harder)
    out = folder.parent / "list.html"
    told(command, folder, "-o", out)
    used = folder.parent / "used.html"
    used.write_text(out.read_text().rpartition("</body>")[0] + FILTERED)
    shown = browser(used, "", "--dump-dom").rpartition("USED;")[2].partition("<")[0].split(";")
    every = "0,1,2 (3 of 3)"
    assert shown == ["1 (1 of 3)", every, "0 (1 of 3)", every, "1 (1 of 3)", every, "2,0,1 (3 of 3)"]
