"""A folder in the viewer: a list of its scenes with filters, a page of each, and links to telling frames."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command import told
from helpers.synthetic import write

from report.test_viewer import CHROMIUM, browser
from tacgen.bundle.bundle import read
from tacgen.report import scene_pages, viewer
from tacgen.report.field_figure import DRAWN_FIELDS


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
