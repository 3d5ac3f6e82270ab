"""What is public: the names of `tacgen.__all__` and the page docs/API.md, each documented; importing them is cheap."""

import ast
import doctest
import inspect
import re
import sys
from importlib import import_module
from pathlib import Path

import pytest
from helpers.program import ran

import tacgen

ROOT = Path(__file__).parents[2]
INIT = ROOT / "tacgen" / "__init__.py"
PAGE = (ROOT / "docs/API.md").read_text()
PAGES = re.findall(r"^::: (tacgen[\w.]*)$", PAGE, re.M)
PYTHON = re.compile(r"^```python(?: title=\S+)?\n(.*?)^```$", re.M | re.S)


@pytest.mark.parametrize("name", tacgen.__all__)
def test_a_public_name_exists_and_is_documented(name: str) -> None:
    found = getattr(tacgen, name)
    text = inspect.getdoc(found) or ""
    assert text[:1].isupper(), name
    assert text.splitlines()[0].endswith((".", ":", ",", ";")) or "\n" in text, name
    assert f"tacgen.{name}" in PAGES
    assert name in dir(tacgen)


def test_the_page_names_public_names_and_modules_alone() -> None:
    for name in PAGES:
        assert name.removeprefix("tacgen.") in tacgen.__all__ or import_module(name)
    named = {name.removeprefix("tacgen.") for name in PAGES if "." not in name.removeprefix("tacgen.")}
    assert named - {"torch"} == {*tacgen.__all__}


def test_type_checkers_see_the_same_names() -> None:
    for node in ast.parse(INIT.read_text()).body:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            seen: dict[str, set[str]] = {}
            for one in node.body:
                assert isinstance(one, ast.ImportFrom)
                seen.setdefault(str(one.module), set()).update(alias.name for alias in one.names)
            assert seen == {module: {*names} for module, names in tacgen._HOMES.items()}
            assert {*tacgen.__all__} == {name for names in tacgen._HOMES.values() for name in names}
            return
    pytest.fail("no names for type checkers")


def test_pages_and_examples_take_private_names_from_pages_alone() -> None:
    modules = {name for name in PAGES if name not in {f"tacgen.{each}" for each in tacgen.__all__}}
    for path in [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", *(ROOT / "examples").glob("*.py")]:
        text = path.read_text()
        for block in PYTHON.findall(text) if path.suffix == ".md" else [text]:
            for node in ast.walk(ast.parse(block)):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("tacgen"):
                    for alias in node.names:
                        assert {node.module, f"{node.module}.{alias.name}"} & modules, f"{path}: {node.module}"


def test_importing_it_loads_nothing_else() -> None:
    ask = "import sys; before = {*sys.modules}; import tacgen; dir(tacgen); print(*sorted({*sys.modules} - before))"
    names = ran("-c", ask).split()
    assert {name.split(".")[0] for name in names} - sys.stdlib_module_names == {"tacgen"}
    ours = {name for name in names if name.startswith("tacgen.")}
    assert ours == {"tacgen.base", "tacgen.base.version"}


def test_a_misspelt_name_says_what_was_meant() -> None:
    with pytest.raises(AttributeError, match="'Shpere', did you mean Sphere"):
        _ = tacgen.Shpere  # type: ignore[attr-defined]
    assert not hasattr(tacgen, "__wrapped__")


def test_the_ten_lines_are_the_same_everywhere_and_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    texts = ((ROOT / "docs/python.md").read_text(), (ROOT / "README.md").read_text(), PAGE)
    first, second, third = (PYTHON.findall(text)[0] for text in texts)
    assert first == second == third
    assert len(first.splitlines()) <= 10
    monkeypatch.chdir(tmp_path)
    coarse = "friction=0.6, quality={'edge_mm': 1.2, 'dhat_mm': 0.1},"
    exec(first.replace("friction=0.6,", coarse).replace("=5)", "=1)"), {})
    assert (tmp_path / "press.png").stat().st_size > 20_000


@pytest.mark.parametrize("module", ["tacgen", "tacgen.api.simulation", "tacgen.api.frames"])
def test_examples_in_docstrings_are_true(module: str) -> None:
    found = doctest.testmod(import_module(module))
    assert found.attempted > 2
    assert found.failed == 0


@pytest.mark.slow
def test_the_page_on_python_runs(tmp_path: Path) -> None:
    (tmp_path / "objects").symlink_to(ROOT / "objects")
    for block in PYTHON.findall((ROOT / "docs/python.md").read_text()):
        (tmp_path / "block.py").write_text(block)
        ran("block.py", folder=tmp_path)
    assert len([*(tmp_path / "out/batch").glob("*.h5")]) > 1
