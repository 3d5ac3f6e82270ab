"""The pages say what the program does: commands and options exist, recipes validate, links lead somewhere."""

import ast
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import click
import pytest
import trimesh
import typer
from helpers.command import told
from helpers.needs import needs
from helpers.program import ran
from helpers.synthetic import attributes, write

from tacgen import export
from tacgen.bundle import bundle
from tacgen.cli.main import app
from tacgen.recipe import assets, loading, model, plan
from tacgen.recipe.grasp_checks import GRIPPER_MOVES
from tacgen.recipe.indenters import INDENTER_SHAPES
from tacgen.recipe.trajectory import Segment
from tacgen.sensor import markers
from tacgen.sensor import model as sensor
from tacgen.sensor.base_model import Part
from tacgen.sensor.yaml_source import load

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
TUTORIAL = DOCS / "tutorial.md"
FENCE = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', re.M | re.S)
LINK = re.compile(r"(?<!`)\[[^\]\n]+\]\(([^)\s]+)\)")
WHOLE = ("tacgen: 1\n", "tacgen_sensor: 1\n", "extends: ")  # how a block begins that is a file by itself
# Files that pages speak of and a reader brings; another that will do stands in.
BROUGHT = {
    "parts/thing.stl": ROOT / "objects/ring/ring.stl",
    "rollout.csv": ROOT / "recipes/rollout.csv",
    "tool.csv": ROOT / "tests/helpers/tool.csv",
    "log.csv": ROOT / "tests/helpers/contact_log.csv",
}


class Block(NamedTuple):
    """A fenced block of a page."""

    language: str
    title: str
    text: str


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def blocks(page: Path, language: str = "") -> list[Block]:
    found = [Block(*match.groups(default="")) for match in FENCE.finditer(page.read_text(encoding="utf-8"))]
    return [block for block in found if language in ("", block.language)]


def commands(block: Block) -> Iterator[list[str]]:
    """The arguments of each line that starts with `tacgen`."""
    for line in block.text.replace("\\\n", " ").splitlines():
        if line.startswith("tacgen "):
            yield shlex.split(line, comments=True)[1:]


def parsed(arguments: list[str]) -> None:
    """Take arguments as the command line would, and run nothing. Raises click.ClickException."""
    group = typer.main.get_command(app)
    assert isinstance(group, click.Group)
    context = group.make_context("tacgen", list(arguments))
    called, command, rest = group.resolve_command(context, list(arguments))
    assert command is not None
    command.make_context(called, rest, parent=context)


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_commands_and_options_exist(page: Path) -> None:
    for block in blocks(page, "sh"):
        for arguments in commands(block):
            try:
                parsed(arguments)
            except click.ClickException as error:
                pytest.fail(f"tacgen {' '.join(arguments)}: {error.format_message()}")
        for target in re.findall(r"^make (\w[\w-]*)", block.text, re.M):
            assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.M), f"make {target}"
        for script in re.findall(r"^python (\S+)", block.text, re.M):
            assert (ROOT / script).is_file(), script


def test_the_check_of_commands_sees_a_wrong_option() -> None:
    with pytest.raises(click.UsageError):
        parsed(["run", "quickstart", "-o", "out", "--wokers", "2"])
    with pytest.raises(click.UsageError):
        parsed(["rum"])
    with pytest.raises(click.UsageError):
        parsed(["export", "feats", "out"])


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "yaml")], ids=name)
def test_recipes_and_sensor_files_validate(page: Path, tmp_path: Path) -> None:
    for place, source in BROUGHT.items():
        (tmp_path / place).parent.mkdir(exist_ok=True)
        shutil.copy(source, tmp_path / place)
    trimesh.creation.box(bounds=[[0, 0, 0], [14, 14, 4]]).export(tmp_path / "my_gel.stl")
    written = []
    for number, block in enumerate(blocks(page, "yaml")):
        if block.text.startswith(WHOLE):
            written.append(tmp_path / (block.title or f"block-{number}.yaml"))
            written[-1].write_text(block.text)
    for file in written:
        data = load(file).data
        assert isinstance(data, dict)
        if "tacgen_sensor" in data:
            loading.read_sensor(file)
        else:
            assert plan.load(file).rows


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python")], ids=name)
def test_python_blocks_import_what_there_is(page: Path) -> None:
    for block in blocks(page, "python"):
        for node in ast.walk(ast.parse(block.text)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "tacgen":
                module = import_module(node.module or "")
                for imported in node.names:
                    if not hasattr(module, imported.name):
                        import_module(f"{node.module}.{imported.name}")


def anchors(page: Path) -> set[str]:
    """The headings of a page as links name them."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    titles = re.findall(r"^#+ (.+)$", text, re.M)
    return {re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", title.lower())).strip("-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    for link in LINK.findall(text):
        if link.startswith(("http://", "https://")):
            continue
        place, _, anchor = link.partition("#")
        target = (page.parent / place).resolve() if place else page
        assert target.is_file(), link
        if page.is_relative_to(DOCS):
            assert target.is_relative_to(DOCS), f"{link}: not a page of the site"
        if anchor:
            assert anchor in anchors(target), link


def test_the_picture_of_the_house_has_every_folder() -> None:
    drawn = set(re.findall(r'font-weight="bold">(\w+)<', (DOCS / "house.svg").read_text()))
    folders = {path.parent.name for path in (ROOT / "tacgen").glob("*/__init__.py")}
    assert drawn == folders | {"torch"}


def test_every_page_is_in_the_navigation() -> None:
    def pages(entry: object) -> Iterator[str]:
        if isinstance(entry, str):
            yield entry
        elif isinstance(entry, dict | list):
            for inner in entry.values() if isinstance(entry, dict) else entry:
                yield from pages(inner)

    data = load(ROOT / "mkdocs.yml").data
    assert isinstance(data, dict)
    found = list(pages(data["nav"]))
    assert sorted(found) == sorted(page.relative_to(DOCS).as_posix() for page in DOCS.rglob("*.md"))


@pytest.mark.parametrize(
    ("part", "kind"),
    [
        ("`gel`", sensor.Gel),
        ("`camera`", sensor.Camera),
        ("`markers`", markers.GridMarkers),
        ("`markers`, hexagonal", markers.HexagonalMarkers),
        ("`plate`", sensor.Plate),
        ("`coating`", sensor.Coating),
        ("`walls`", sensor.Walls),
        ("`leds[i]`", sensor.Led),
    ],
)
def test_the_table_of_sensor_parts_names_every_key(part: str, kind: type[Part]) -> None:
    page = (DOCS / "cookbook/own_sensor.md").read_text()
    (line,) = (line for line in page.splitlines() if line.startswith(f"| {part} |"))
    must, _, may = line.split("|")[2].partition("(")
    needed = {name for name, field in kind.model_fields.items() if field.is_required()}
    assert set(re.findall(r"`(\w+)`", must)) == needed
    assert set(re.findall(r"`(\w+)`", may)) == kind.model_fields.keys() - needed - {"source"}


@pytest.mark.parametrize(
    ("script", "page"), [("bundle_page", "BUNDLE.md"), ("command_page", "COMMANDS.md"), ("sensor_page", "SENSOR.md")]
)
def test_pages_of_bundle_command_line_and_sensor_are_what_their_scripts_print(script: str, page: str) -> None:
    made = ran(ROOT / f"scripts/{script}.py", COLUMNS="50")
    assert (DOCS / page).read_text() == made, f"run scripts/{script}.py > docs/{page}"


def test_the_recipe_page_names_every_key_movement_and_quality() -> None:
    text = (DOCS / "RECIPE.md").read_text()
    keys = {*model.Recipe.model_fields, *Segment.model_fields} - {"tacgen"}
    assert not [key for key in keys if f"`{key}`" not in text]
    for preset, numbers in model.QUALITIES.items():
        assert f"| `{preset}` | {' | '.join(f'{number:g}' for number in numbers)} |" in text


def test_the_gallery_has_every_shape_object_movement_and_sensor() -> None:
    rows, single = plan.load(DOCS / "gallery" / "gallery.yaml").rows, {*Segment.model_fields} - {*GRIPPER_MOVES}
    moved: dict[str, set[str]] = {}
    for row in rows:
        indenter = row.recipe.indenter
        name = indenter.file if indenter.shape == "mesh" else indenter.shape
        moved.setdefault(name, set()).update(step.kind for step in row.recipe.trajectory)
    assert set(moved) == {*INDENTER_SHAPES, *assets.list_objects()} - {"mesh"}
    assert not [name for name, kinds in moved.items() if kinds != single]
    page = (DOCS / "gallery.md").read_text()
    assert not [name for name in moved if f"| {name} |" not in page]
    shown = {"paths.webp", *(f"{sensor}-{kind}.webp" for sensor in assets.list_sensors() for kind in single)}
    assert not [file for file in shown if f"(gallery/{file})" not in page]
    assert {file.name for file in (DOCS / "gallery").glob("*.webp")} == shown
    assert sum(file.stat().st_size for file in (DOCS / "gallery").iterdir()) < 4e6


@pytest.mark.slow
def test_the_gallery_is_drawn_from_bundles_and_names_what_was_rejected(tmp_path: Path) -> None:
    folder = tmp_path / "bundles" / "digit"
    folder.mkdir(parents=True)
    write(folder / "scene-00000.h5")
    punch = attributes()["recipe"] | {"indenter": {"shape": "cylinder", "radius_mm": 3.0}}
    write(folder / "scene-00001.h5", stop=3, recipe=punch)
    ran(ROOT / "scripts/gallery.py", folder.parent, "-o", tmp_path)
    page = (tmp_path / "gallery.md").read_text()
    assert "- cylinder, press, slide, hold, twist: frame 3 of 12: Newton's method stalled\n" in page
    for kind in ("press", "slide", "hold", "twist"):
        assert f"(gallery/digit-{kind}.webp)" in page
        assert (tmp_path / "gallery" / f"digit-{kind}.webp").stat().st_size > 5000


EXTENDING = re.findall(r"^\| `([^`]+)` \| (.+) \|$", (DOCS / "EXTENDING.md").read_text(), re.M)


@pytest.mark.parametrize(("file", "what"), EXTENDING, ids=[f"{i}-{file}" for i, (file, _) in enumerate(EXTENDING)])
def test_what_extending_names_is_there(file: str, what: str) -> None:
    place = ROOT / file
    if "<" in file:  # one's own
        assert place.parent.is_dir()
        return
    text = place.read_text()
    for word in re.findall(r"`(\w+)`", what):
        assert re.search(rf"\b{word}\b", text), word


def test_a_format_is_a_module_and_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def written(bundles: list[bundle.Bundle], out: Path) -> list[Path]:
        export.needs(bundles[0], ("/frames/force",), "force")
        made = out / "names.txt"
        made.write_text("\n".join(export.names(bundles)))
        return [made]

    monkeypatch.setitem(export.EXPORTERS, "names", "names of scenes")
    monkeypatch.setitem(sys.modules, "tacgen.export.names", SimpleNamespace(write=written))
    scene = write(tmp_path / "scene-00000.h5")
    told("export", "names", scene, "-o", tmp_path / "out")
    assert (tmp_path / "out" / "names.txt").read_text() == "scene-00000"


def run_page(page: Path, folder: Path, quality: str) -> int:
    """Write a page's files and run its commands and its Python in order, in an empty folder; how many ran."""
    count = 0
    for block in blocks(page):
        if block.title:
            (folder / block.title).write_text(block.text)
        lines = [["-c", block.text]] if block.language == "python" else []
        if block.language == "sh":
            lines = [["-m", "tacgen", *arguments] for arguments in commands(block)]
        for line in lines:
            if line[2:3] == ["run"]:
                line += ["--set", f"quality={quality}"]
            ran(*line, folder=folder)
            count += 1
    return count


@pytest.mark.slow
def test_the_tutorial_runs(tmp_path: Path) -> None:
    assert run_page(TUTORIAL, tmp_path, "draft") > 10
    for made in ("draft.png", "traction.png", "many/report.html", "packed/index.json"):
        assert (tmp_path / "out" / made).stat().st_size > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lit_sensor", "random_movements", "tilt_until_slip"])
def test_a_page_of_the_cookbook_runs(name: str, tmp_path: Path) -> None:
    assert run_page(DOCS / "cookbook" / f"{name}.md", tmp_path, "{edge_mm: 1.0, dhat_mm: 0.1}") > 1


@pytest.mark.slow
def test_the_site_is_built_without_warnings_and_fetches_nothing(tmp_path: Path) -> None:
    needs("mkdocs")
    ran("-m", "mkdocs", "build", "--strict", "--site-dir", tmp_path, folder=ROOT, NO_MKDOCS_2_WARNING="1")
    pages = sorted(tmp_path.rglob("*.html"))
    assert len(pages) > 15
    assert "var __index = " in (tmp_path / "search" / "search_index.js").read_text()[:20], "search needs no server"
    assert (tmp_path / "iframe-worker.js").is_file()
    remote = r"(?:<(?:script|img|iframe|source)\s[^>]*src|<link\s[^>]*rel=.(?:stylesheet|preconnect|icon)[^>]*href)"
    for page in pages:
        assert not re.findall(rf'{remote}=["\']?(?:https?:)?//', page.read_text()), page
