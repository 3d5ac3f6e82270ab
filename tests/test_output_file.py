"""What a command writes with -o never replaces an input, a file of somebody's, a pipe or a device."""

import os
import shutil
from pathlib import Path

import pytest
from helpers.command import refused, tacgen_
from helpers.synthetic import write

from tacgen.base import output_file
from tacgen.base.errors import UserError


def made(*words: object) -> None:
    done = tacgen_(*words)
    assert (done.exit_code, done.stderr) == (0, "")


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("source")
    for number in range(2):
        write(folder / f"scene-{number:05d}.h5", frames=3, scene_index=number)
    return folder


@pytest.fixture
def data(source: Path, tmp_path: Path) -> Path:
    return shutil.copytree(source, tmp_path / "data")


@pytest.mark.parametrize("more", [(), ("--overwrite",)])
@pytest.mark.parametrize(
    "words",
    [
        "view SCENE -o SCENE",
        "show SCENE -o SCENE",
        "show SCENE --animate SCENE",
        "show SCENE -o LINK",
        "report DATA -o SCENE",
        "view SCENE -o FIFO",
        "report DATA -o FIFO",
        "export vtkhdf SCENE -o FIFO",
        "calibrate material --sensor gelsight_mini --recipe quickstart --data FORCES -o FORCES",
        "calibrate material --sensor gelsight_mini --recipe quickstart --data FORCES --plot FORCES",
        "calibrate optics --sensor SENSOR --images DATA -o SENSOR",
        "init FIFO",
    ],
)
def test_inputs_and_pipes_are_refused_whatever_is_asked(data: Path, words: str, more: tuple[str, ...]) -> None:
    scene = data / "scene-00000.h5"
    (forces := data.parent / "f.csv").write_text("depth_mm,force_n\n0.1,0.1\n0.5,1.0\n")
    (sensor := data.parent / "mine.yaml").write_text("tacgen_sensor: 1\n")
    (link := data.parent / "picture.h5").symlink_to(scene)
    os.mkfifo(fifo := data.parent / "fifo.vtkhdf")
    before = {path: path.read_bytes() for path in (scene, forces, sensor)}
    places = {"SCENE": scene, "DATA": data, "FORCES": forces, "SENSOR": sensor, "LINK": link, "FIFO": fifo}
    said = refused(*(places.get(word, word) for word in words.split()), *more)
    assert any(text in said for text in ("is an input", "belongs to the data set", "is a pipe")), said
    assert len(said.splitlines()) == 1
    assert {path: path.read_bytes() for path in before} == before


@pytest.mark.parametrize(
    "words",
    [
        "view SCENE -o out.html",
        "show SCENE -o out.png",
        "show SCENE --field pressure -o out.png",
        "show SCENE --animate out.gif",
        "report DATA -o out.html",
        "export vtkhdf SCENE -o out.vtkhdf",
        "init out.yaml",
    ],
)
def test_files_are_replaced_on_request_only(
    data: Path, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    args = [{"SCENE": data / "scene-00000.h5", "DATA": data}.get(word, word) for word in words.split()]
    (target := Path(words.split()[-1])).write_text("mine")
    assert refused(*args).endswith(f"{target}: is there already; --overwrite replaces it\n")
    assert target.read_text() == "mine"
    made(*args, "--overwrite")
    assert target.read_bytes() != b"mine"
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


def test_pages_of_tacgen_are_replaced_until_somebody_changes_them(data: Path) -> None:
    page = data / "report.html"
    made("report", data)
    first = page.read_bytes()
    made("report", data)
    assert page.read_bytes() == first
    page.write_bytes(first.replace(b"<h1>", b"<h1>My ", 1))
    refused("report", data)
    assert b"<h1>My " in page.read_bytes()


def test_what_fails_leaves_nothing_and_keeps_what_was_there(tmp_path: Path) -> None:
    (target := tmp_path / "x.txt").write_text("old")

    def fail() -> None:
        with output_file.written(target, overwrite=True) as path:
            path.write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == ["x.txt"]
    with pytest.raises(OSError, match=r"x\.txt'$"), output_file.written(target, overwrite=True) as path:
        raise OSError(28, "No space left on device", str(path))


def test_a_link_stays_one(tmp_path: Path) -> None:
    (there := tmp_path / "there.txt").write_text("old")
    (link := tmp_path / "link.txt").symlink_to(there)
    with output_file.written(link, overwrite=True) as path:
        path.write_text("new")
    assert (link.is_symlink(), there.read_text()) == (True, "new")


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="is a folder"):
        output_file.refuse(tmp_path)
