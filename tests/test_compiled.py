"""Compiled code is kept for the next process, never used after a change, and compiled by one process at a time."""

import importlib
import os
import pkgutil
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from numba.core.dispatcher import Dispatcher

from tacgen import mechanics
from tacgen.base import compiled

PACKAGE = Path(mechanics.__file__).parents[1]
USE = """
import numpy as np
from tacgen.base import compiled
from tacgen.optics import probe
print(probe.twice(2.0), compiled.seconds() > 0)
"""

NEEDED = (
    "__init__",
    "base/__init__",
    "base/version",
    "base/compiled",
    "base/array_cache",
    "base/atomic_file",
    "base/regular_file",
    "base/errors",
)


def copied(folder: Path, factor: str) -> Path:
    """A package of the module under test, and of one compiled function that calls another file's."""
    (folder / "tacgen" / "optics").mkdir(parents=True, exist_ok=True)
    for name in NEEDED:
        to = folder / f"tacgen/{name}.py"
        to.parent.mkdir(exist_ok=True)
        shutil.copy(PACKAGE / f"{name}.py", to)
    head = "from tacgen.base.compiled import njit\n"
    (folder / "tacgen/optics/__init__.py").write_text("")
    called = f"@njit(cache=False)\ndef scaled(x):\n    return {factor} * x\n"
    (folder / "tacgen/optics/scale.py").write_text(head + called)
    text = "from tacgen.optics.scale import scaled\n\n@njit(cache=True)\ndef twice(x):\n    return scaled(x)\n"
    (folder / "tacgen/optics/probe.py").write_text(head + text)
    return folder


def used(folder: Path, cache: Path) -> str:
    """What the function gives, and whether it was compiled, in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run([sys.executable, "-c", USE], env=environment, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_code_is_kept_and_a_change_in_another_file_is_seen(tmp_path: Path):
    package, cache = copied(tmp_path / "package", "2"), tmp_path / "cache"
    assert used(package, cache) == "4.0 True"
    assert used(package, cache) == "4.0 False"
    assert used(copied(package, "3"), cache) == "6.0 True"
    assert used(copied(package, "2"), cache) == "4.0 False", "the older version's is still there"


def dispatcher(value: Any) -> Any:
    found = getattr(value, "_dispatcher", value)
    return found if isinstance(found, Dispatcher) else None


def test_what_compiled_functions_call_is_not_kept():
    """Else the code of a function depends on what was kept before: by a run that was killed, or by another at once."""
    callers, called = 0, set[str]()
    for package in compiled.COMPILED_PACKAGES:
        for module in pkgutil.walk_packages([str(PACKAGE / package)], f"tacgen.{package}."):
            for caller in filter(None, map(dispatcher, vars(importlib.import_module(module.name)).values())):
                callers += 1
                known, names = caller.py_func.__globals__, caller.py_func.__code__.co_names
                inner = filter(None, (dispatcher(known.get(name)) for name in names))
                called |= {one.py_func.__qualname__ for one in inner if isinstance(one._cache, compiled._Code)}
    assert callers > 40
    assert not called


POWERS = """
import re
import sys
import numpy as np
from tacgen.base.compiled import njit

@njit(cache=False)
def product(x):
    return x[1] * x[2]

for fast in map(int, sys.argv[1:]):
    @njit(cache=False, fastmath=bool(fast))
    def power(x):
        return np.abs(x[0]) ** 2 + np.sum(x) + product(x)

    power(np.ones(4))
    lines = re.findall(" = (f(?:mul|add)(?: fast)?) ", power.inspect_llvm(power.signatures[0]))
    print(fast, *(f"{line} {lines.count(line)}" for line in sorted(set(lines))))
"""


@pytest.mark.slow
def test_arithmetic_is_a_functions_own_whatever_was_compiled_before():
    """Numba compiles its own powers, and what functions call, once: with the arithmetic of the first caller."""
    found = [
        subprocess.run([sys.executable, "-c", POWERS, *order], capture_output=True, text=True, check=True).stdout
        for order in ("01", "10")
    ]
    one, other = (sorted(text.splitlines()) for text in found)
    assert one == other
    assert "fast" in one[1]
    assert "fast" not in one[0]


@pytest.mark.slow
def test_a_cache_that_cannot_be_written_compiles_again(tmp_path: Path):
    package, cache = copied(tmp_path / "package", "2"), tmp_path / "cache"
    cache.write_text("no folder")
    assert used(package, cache) == used(package, cache) == "4.0 True"
    assert not list(package.rglob("*.entry")), "nor is it kept in a place that nothing keeps up to date"


def double(x: float) -> float:
    return 2.0 * x


def triple(x: float) -> float:
    return 3.0 * x


def called(function: Callable[[float], float]) -> tuple[float, bool]:
    """What a function gives for 1, and whether it was compiled."""
    before = compiled.seconds()
    return compiled.njit(cache=True)(function)(1.0), compiled.seconds() > before


def test_damaged_code_is_compiled_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(compiled, "folder", lambda: tmp_path)
    assert called(double) == (2.0, True)
    for entry in [path for path in tmp_path.rglob("*") if path.is_file()]:
        whole = entry.read_bytes()
        flips = [whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :] for at in range(0, len(whole), len(whole) // 5)]
        for damaged in (*flips, whole[:-1], whole[:9], b""):
            assert called(double) == (2.0, False)
            entry.write_bytes(damaged)
            assert called(double) == (2.0, True), "and kept again"


def test_code_of_another_function_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(compiled, "folder", lambda: tmp_path)
    assert called(double) == (2.0, True)
    found = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    for path in found:
        path.unlink()
    assert called(triple) == (3.0, True)
    for path in [path for path in tmp_path.rglob("*") if path.is_file()]:
        (other,) = (code for old, code in found.items() if old.suffix == path.suffix)
        path.write_bytes(other)
    assert called(triple) == (3.0, True)


def test_one_process_compiles_and_others_wait(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(compiled, "folder", lambda: tmp_path)
    monkeypatch.setattr(compiled, "_writable", lambda: True)
    program = """
        import sys, time
        from pathlib import Path
        from tacgen.base import compiled
        compiled.folder, compiled._writable = lambda: Path(sys.argv[1]), lambda: True
        with compiled.once("solve"):
            print("in", flush=True)
            time.sleep(1.0)
    """
    command = [sys.executable, "-c", textwrap.dedent(program), str(tmp_path)]
    told: list[bool] = []
    with subprocess.Popen(command, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"in\n"
        with compiled.telling(lambda: told.append(True)), compiled.once("solve"):
            assert (tmp_path / "solve").exists(), "the other is done"
    assert told == [True]
    with compiled.telling(lambda: told.append(True)), compiled.once("solve"):
        pass
    assert told == [True], "nobody waits any more"


@pytest.mark.parametrize("threads", ["0", "many"])
def test_an_invalid_number_of_threads_means_one(threads: str):
    environment = {**os.environ, "NUMBA_NUM_THREADS": threads}
    asked = "import tacgen, numba; print(numba.get_num_threads())"
    done = subprocess.run([sys.executable, "-c", asked], env=environment, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("1\n", "")


ELEMENTS = """
import numpy as np
from tacgen.base import compiled
from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import HEX_CORNERS, elements
from tacgen.fem.materials import NeoHooke

one = Elastic(elements(HEX_CORNERS / 2, np.arange(8)[None]), NeoHooke(0.1, 1.0))
print(one.value(HEX_CORNERS), compiled.seconds() > 0)
"""


@pytest.mark.slow
def test_code_of_elements_is_kept_and_damaged_code_is_made_again(tmp_path: Path):
    def ran() -> list[str]:
        known = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
        done = subprocess.run([sys.executable, "-c", ELEMENTS], env=known, capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout.split()

    energy, made = ran()
    assert made == "True"
    assert ran() == [energy, "False"]
    (entry,) = tmp_path.rglob("tacgen.physics.entry")
    whole = entry.read_bytes()
    entry.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    assert ran() == [energy, "True"]
    assert entry.read_bytes()[-9:] == whole[-9:]
