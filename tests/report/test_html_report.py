"""Card, report and summary say what a folder holds, what it lacks and why, from the bundles themselves."""

import re
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from batch.test_local import TASK, spoil
from helpers.command import refused, told
from helpers.scenes import make_plan
from helpers.synthetic import attributes, write

from tacgen import batch
from tacgen.bundle import dataset, pack, run_status
from tacgen.bundle.bundle import Bundle, read
from tacgen.report import dataset_card, dataset_summary, html_report
from tacgen.sensor.yaml_source import shortest_ends


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six planned scenes: four done, one failed, one rejected; forces and pictures in them."""
    out = tmp_path_factory.mktemp("report") / "out"
    plan = make_plan(out.parent, 6)
    spoil(out, "scene-00003", "refuse")
    batch.run(plan, out, task=TASK)
    for k in (0, 4):
        row = plan.rows[k]
        known = {"input_key": row.key, "seed": row.seed, "scene_index": k, "values": row.values}
        write(out / f"{row.name}.h5", stop=7 if k == 4 else None, **known)
    timing = '{"frames": 12, "seconds": {"foresee": 1.5, "solve": 3.0, "render": 6.0}}'  # foresee: presolve's old name
    (out / "scene-00000.timing.json").write_text(timing)
    return out


class Links(HTMLParser):
    """Opening and closing tags must match; every link is kept."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img", "br", "input"):
            self.open.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_the_card_tells_of_maps_that_do_not_add_up_to_the_force(tmp_path: Path) -> None:
    for number, worst in enumerate((0.01, 0.3, 0.46)):

        def edit(index: int, arrays: dict[str, Any], worst: float = worst) -> None:
            arrays["/frames/quality/pressure_resultant"] = worst if index == 5 else 0.0

        write(tmp_path / f"{number}.h5", edit=edit, scene_index=number)
    limits = dataset_card.text(dataset_summary.look(tmp_path)).partition("## Known limits")[2]
    assert "| 2 | /frames/pressure does not add up to the force, by up to 0.46 of it |" in limits
    assert "traction does not" not in limits


def test_the_report_is_one_page_that_needs_nothing_else(folder: Path, tmp_path: Path):
    page = html_report.write(folder, tmp_path / "r.html").read_text()
    parser = Links()
    parser.feed(page)
    assert parser.open == []
    assert parser.links
    assert all(link.startswith(("data:image/jpeg;base64,", "r_scenes/scene-", "#")) for link in parser.links)
    assert {link[1:] for link in parser.links if link[0] == "#"} == set(re.findall(r"<h2 id=(\w+)>", page))
    assert "<h1>many: 6 scenes, 48 frames</h1>" in page
    assert "this cannot be made" in page
    assert "frame # of #: Newton&#x27;s method stalled" in page
    assert "start.x_mm" in page
    assert all(stage in page for stage in ("foresee", "1.5 s", "6.0 s"))
    assert "A scene frame by frame</h2><div class=viewer>" in page
    coverage = page[page.index("<h2 id=Coverage") : page.index("<h2 id=Forces")]
    assert "<circle" not in coverage  # one varied number has no pair to be plotted against


def test_pairs_of_varied_numbers_are_plotted_a_point_a_scene(tmp_path: Path):
    for i in range(4):
        values = {"a": 0.04 + i / 3, "b": i * 2.0, "name": "x<y"}
        values |= {"sensor.leds[0].power": 1, "sensor.leds[1].power": "low"}
        write(tmp_path / f"scene-{i:05d}.h5", outputs=frozenset({"force"}), values=values)
    page = html_report.page(dataset_summary.look(tmp_path))
    coverage = page[page.index("<h2 id=Coverage") : page.index("<h2 id=Forces")]
    assert len(re.findall(r"<circle", coverage)) == 12
    assert "x&lt;y (4)" in coverage
    (plot,) = re.findall(r"<svg(?:(?!<svg).)*>a</text><text transform[^>]*>b</text></svg>", coverage)
    assert re.findall(r">([-\d.]+)</text>", plot) == ["0.5", "1", "0", "2", "4", "6"]  # ticks of a and b
    assert "<x" not in page


def test_forces_are_curves_by_movement_and_shape_and_points_where_there_is_one_frame(tmp_path: Path):
    torus = {"shape": "torus", "radius_mm": 3.0, "tube_radius_mm": 1.0}
    ring = {"recipe": attributes()["recipe"] | {"indenter": torus}}
    for k, (count, more) in enumerate(((12, {}), (12, ring), (1, ring))):
        write(tmp_path / f"scene-{k:05d}.h5", outputs=frozenset({"force"}), frames=count, **more)
    page = html_report.page(dataset_summary.look(tmp_path))
    forces = page[page.index("<h2 id=Forces") : page.index("<h2 id=Scenes")]
    rows = {row.partition("</h3>")[0]: row for row in forces.split("<h3>")[1:]}
    together, alone = rows["press, slide, hold, twist: 2 scenes"], rows["press: 1 scene"]
    lines = [re.findall(r'<path class="line (\w+)"', plot) for plot in together.split("</svg>")]
    points = [re.findall(r'<circle class="dot (\w+)"', plot) for plot in alone.split("</svg>")]
    assert (lines, points) == ([["c0", "c1"]] * 3 + [[]], [["c1"]] * 3 + [[]])
    assert 'class="line' not in alone
    for axis in "xyz":
        assert f">F{axis} [N]<" in alone


def test_an_overview_opens_each_bundle_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Opening them is most of the time that a large folder takes."""
    opened = Counter[str]()

    def counted(path: Path, *rest: Any, **options: Any) -> Bundle:
        opened[path.name] += 1
        return read(path, *rest, **options)

    for module in (run_status, dataset):
        monkeypatch.setattr(module, "read", counted)
    assert len(dataset_summary.look(folder).bundles) == 4
    assert opened
    assert set(opened.values()) == {1}


def test_indenters_are_told_in_words_and_counted() -> None:
    balls = [{"shape": "sphere", "radius_mm": 3.0}] * 2 + [{"shape": "mesh", "file": "gear", "scale": 1.0}]
    assert dataset_summary.spread(balls) == "sphere, radius 3 mm (2); gear (1)"
    assert dataset_summary.spread(balls[:1]) == "sphere, radius 3 mm"
    moves = [{"press": {"depth_mm": 0.8, "frames": 3}}, {"slide": {"x_mm": 0.5, "frames": 3}}]
    assert dataset_summary.spread([moves]) == "pressed 0.8 mm deep, slid 0.5 mm along x"
    assert dataset_summary.phrase("start.x_mm", -2.391) == "start.x -2.391 mm"
    assert dataset_summary.phrase("youngs_modulus_mpa", 0.3) == "youngs modulus 0.3 MPa"
    assert dataset_summary.phrase("quality", {"edge_mm": 0.5, "spp": 64}) == "quality edge 0.5 mm, spp 64"
    many = [f"sensor {k}" for k in range(15)]
    assert dataset_summary.spread(many).endswith("sensor 11 (1), and 3 more")


def test_captions_tell_what_was_varied_apart(tmp_path: Path):
    values = {"sensor.leds[0].power": 1.0, "sensor.leds[1].power": 1.25, "contact.friction": 0.5}
    write(tmp_path / "scene-00000.h5", values=values)
    page = html_report.page(dataset_summary.look(tmp_path))
    assert "<p class=soft>friction 0.5, leds[0].power 1, leds[1].power 1.25</p>" in page
    assert shortest_ends(["a.b", "b", "c.a.b"]) == {"a.b": "a.b", "b": "b", "c.a.b": "c.a.b"}


def test_causes_leave_numbers_out_and_count(folder: Path):
    found = html_report.causes(dataset_summary.look(folder).scenes)
    assert {key: len(names) for key, names in found.items()} == {
        ("failed", "this cannot be made"): 1,
        ("rejected", "frame # of #: Newton's method stalled"): 1,
    }


def test_the_card_says_how_many_what_it_cost_and_whose_it_is(folder: Path):
    text = dataset_card.write(folder).read_text()
    assert "| Scenes | 6 (4 ok, 1 rejected, 1 failed) |" in text
    assert "| Frames | 48 |" in text
    assert "| render | 6.0 | 0.500 |" in text
    assert "| scene-00003 | failed | this cannot be made |" in text
    assert "| `start.x_mm` |" in text
    assert "claim no rights" in text
    assert "## Splits" in text
    assert "## Known limits" in text
    again = re.search(r"`([0-9a-f]{64})`", text)
    assert again
    write(folder.parent / "other" / "scene-00000.h5")
    assert again.group(1) not in dataset_card.text(dataset_summary.look(folder.parent / "other"))


def test_the_card_counts_what_scenes_say_of_themselves(tmp_path: Path):
    for i in range(3):
        write(tmp_path / f"scene-{i:05d}.h5", outputs=frozenset({"force"}), notes=["a | sharp edge"] if i else [])
    text = dataset_card.text(dataset_summary.look(tmp_path))
    assert "| 2 | a \\| sharp edge |" in text
    for i in range(3):
        far = f"the indenter touches the gel in no frame, closest approach {i + 1} mm: check its start"
        write(tmp_path / f"scene-{i:05d}.h5", outputs=frozenset({"force"}), notes=[far])
    text = dataset_card.text(dataset_summary.look(tmp_path))
    assert "| 3 | the indenter touches the gel in no frame |" in text


def test_an_object_brings_its_licence(tmp_path: Path):
    recipe = {**attributes()["recipe"], "indenter": {"shape": "mesh", "file": "key"}}
    write(tmp_path / "scene-00000.h5", outputs=frozenset({"force"}), recipe=recipe)
    assert "Object `key`: Licence: Apache-2.0" in dataset_card.text(dataset_summary.look(tmp_path))


def test_a_pack_is_looked_at_as_the_folder_it_was_made_from(folder: Path, tmp_path: Path):
    packed = pack.pack(dataset.scenes(folder), tmp_path / "p").folder
    loose, there = dataset_summary.look(folder), dataset_summary.look(packed)
    assert there.frames == loose.frames
    assert there.datasets == loose.datasets
    assert [s.values for s in there.scenes] == [s.values for s in loose.scenes if s.state == "ok"]


def test_commands_print_and_write(folder: Path, tmp_path: Path):
    assert told("show", folder).splitlines()[1] == "scenes    4 ok, 1 rejected, 1 failed"
    assert told("report", folder) == f"{folder}/report.html\n"
    assert (folder / "report.html").exists()
    assert "is a file, and a report is of a folder" in refused("report", next(folder.glob("*.h5")))
    said = told("pack", folder, "-o", tmp_path / "p", "--size-mb", "0.1")
    assert re.search(r"4 scenes in \d shards?, 48 frames; left out 1 rejected scene$", said.strip())
    assert told("check", tmp_path / "p").endswith("nothing found wrong\n")
