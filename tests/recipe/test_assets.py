"""Shipped files are found by name, in a checkout and in a wheel."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tacgen.base.errors import UserError
from tacgen.recipe import assets

ROOT = Path(__file__).parents[2]


def test_paths_start_at_the_recipe(tmp_path: Path):
    file = tmp_path / "mine.yaml"
    file.write_text("")
    assert assets.sensor_path("./mine.yaml", tmp_path) == file
    assert assets.sensor_path(str(file), Path("elsewhere")) == file


@pytest.mark.parametrize(
    ("find", "name", "says"),
    [
        (assets.sensor_path, "gelsight_mimi", "no sensor is called 'gelsight_mimi'; did you mean gelsight_mini?"),
        (assets.sensor_path, "gelsight", "'gelsight'; did you mean gelsight_mini or gelsight_r15 or gelsight_wedge?"),
        (assets.sensor_path, "zzz", "no sensor is called 'zzz'; there are: "),
        (assets.sensor_path, "no/such.yaml", "no/such.yaml: no such sensor file"),
        (assets.sensor_path, "x" * 5000 + ".yaml", "no such sensor file"),
        (assets.recipe_path, "press.yml", "press.yml: no such recipe file; did you mean press.yaml?"),
        (assets.recipe_path, "other.yaml", "no such recipe file: a relative path starts at the folder"),
        (assets.mesh_path, "press.obj", "no such object file; did you mean press.stl?"),
        (assets.mesh_path, "./notes.txt", "/notes.txt: must be a mesh file (.stl"),
        (assets.mesh_path, "./empty", "/empty: holds no mesh ("),
    ],
)
def test_what_is_not_there_or_is_no_mesh_is_reported_in_one_line(find: Any, name: str, says: str, tmp_path: Path):
    for file in ("press.yaml", "press.stl", "notes.txt"):
        (tmp_path / file).write_text("")
    (tmp_path / "empty").mkdir()
    with pytest.raises(UserError) as caught:
        find(name, tmp_path)
    (line,) = caught.value.lines
    assert says in line


def test_solid_gels_are_those_that_the_script_draws(tmp_path: Path):
    subprocess.run([sys.executable, ROOT / "scripts/make_gels.py", "-o", tmp_path], check=True, timeout=60)
    made = sorted(tmp_path.iterdir())
    assert [path.name for path in made] == sorted(path.name for path in (ROOT / "sensors").glob("*.obj"))
    assert all(path.read_bytes() == (ROOT / "sensors" / path.name).read_bytes() for path in made)


def test_an_installed_package_looks_inside_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "data" / "sensors").mkdir(parents=True)
    (tmp_path / "data" / "sensors" / "other.yaml").write_text("")
    monkeypatch.setattr(assets, "PACKAGE_FOLDER", tmp_path)
    assert assets.list_sensors() == ["other"]
    assert assets.list_objects() == []


@pytest.mark.slow
def test_a_wheel_brings_its_sensors_and_recipes(tmp_path: Path):
    def pip(*args: str) -> None:
        subprocess.run([sys.executable, "-m", "pip", "-q", *args], check=True, cwd=ROOT, timeout=240)

    pip("wheel", "--no-deps", "--wheel-dir", str(tmp_path / "wheel"), ".")
    (wheel,) = (tmp_path / "wheel").iterdir()
    pip("install", "--no-deps", "--target", str(tmp_path / "site"), str(wheel))
    code = "import tacgen.cli.main, sys; print(tacgen.cli.main.__file__); tacgen.cli.main.app()"
    listed = subprocess.run(
        [sys.executable, "-c", code, "list"],
        env={"PYTHONPATH": str(tmp_path / "site"), "PATH": "/usr/bin:/bin"},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    ).stdout
    assert listed.startswith(str(tmp_path / "site"))
    assert "gelsight_mini" in listed
    assert "quickstart" in listed
