"""Tests whose packages are missing skip by the rule of helpers/needs.py: these packages are hidden, and tests run."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.needs import EXTRAS, OTHERS

TESTS = Path(__file__).parent
# a sitecustomize.py, which each Python process runs as it starts
HIDE = f"""import sys
from importlib.machinery import PathFinder

class Hiding(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return None if name.partition(".")[0] in {EXTRAS + OTHERS} else PathFinder.find_spec(name, path, target)

sys.meta_path[sys.meta_path.index(PathFinder)] = Hiding
"""
IMPORT_ALL = """import importlib, pathlib, sys, pytest
for path in map(pathlib.Path, sys.argv[1:]):
    try:
        importlib.import_module(".".join(path.with_suffix("").parts[1:]))
    except pytest.skip.Exception as why:
        print("skipped", path, why)
    except ModuleNotFoundError as error:
        print("failed", path, error)
"""


def hidden(folder: Path, *args: str, timeout: float) -> subprocess.CompletedProcess[str]:
    """A Python process, and what it starts, without these packages."""
    (folder / "sitecustomize.py").write_text(HIDE)
    path = os.pathsep.join(map(str, (folder, TESTS, TESTS.parent)))
    command, env = [sys.executable, *args], {**os.environ, "PYTHONPATH": path}
    return subprocess.run(command, capture_output=True, text=True, cwd=TESTS.parent, env=env, timeout=timeout)


def test_every_test_module_is_imported_or_skipped_without_optional_packages(tmp_path: Path) -> None:
    """Those that name such a package, or a helper that does: tacgen/ and benchmarks/ import them inside functions."""
    names = "|".join(EXTRAS + OTHERS)
    helpers = [path.stem for path in TESTS.rglob("[a-z]*.py") if re.search(names, path.read_text())]
    asks = re.compile("|".join((names, *(rf"^from .*\b{name}\b" for name in helpers))), re.M)
    modules = [path for path in sorted(TESTS.rglob("test_*.py")) if asks.search(path.read_text())]
    paths = [str(path.relative_to(TESTS.parent)) for path in modules]
    done = hidden(tmp_path, "-W", "ignore", "-c", IMPORT_ALL, *paths, timeout=200)
    assert done.returncode == 0, done.stderr
    assert [line for line in done.stdout.splitlines() if line.startswith("failed")] == []
    assert "skipped tests/tensor_engine/test_engine.py needs torch" in done.stdout


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_tests_that_name_an_optional_package_pass_or_skip_without_any(tmp_path: Path) -> None:
    others = [path for path in sorted(TESTS.rglob("test_*.py")) if path != Path(__file__)]
    asks = re.compile(r"^from helpers\.\w+ import .*\bneeds(_package_of)?\b", re.M)
    modules = [str(path) for path in others if asks.search(path.read_text())]
    flags = ("-m", "pytest", "-q", "-m", "not slow", "-p", "no:cacheprovider", f"--basetemp={tmp_path / 'tests'}")
    done = hidden(tmp_path, *flags, *modules, timeout=800)
    assert done.returncode == 0, done.stdout[-5000:]


def test_no_test_skips_for_a_package_by_a_rule_of_its_own() -> None:
    own = [path for path in TESTS.rglob("*.py") if "importorskip" in path.read_text() and path != Path(__file__)]
    assert own == [TESTS / "helpers" / "needs.py"]
