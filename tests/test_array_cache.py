"""Arrays and machine code are kept for the next process, and never used when damaged or exchanged."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

from tacgen.base import array_cache, compiled

pytestmark = pytest.mark.usefixtures("own_cache")
MADE = np.arange(6.0)


def entry(name: str) -> Path:
    """Store an array and return the file it is in."""
    array_cache.kept_one("kind", name, lambda: MADE)
    return next(path for path in (array_cache.cache_folder() / "kind").iterdir() if path.stem == name)


def again(name: str) -> np.ndarray:
    return array_cache.kept_one("kind", name, lambda: -MADE)  # a remade one is told from one that was read


def test_no_flipped_bit_is_read():
    file = entry("flipped")
    whole = file.read_bytes()
    for place in range(0, len(whole), 7):
        file.write_bytes(whole[:place] + bytes([whole[place] ^ 16]) + whole[place + 1 :])
        assert np.array_equal(again("flipped"), -MADE), place
        file.write_bytes(whole)
        assert np.array_equal(again("flipped"), MADE), "a sound entry is read"


def test_neither_another_entry_nor_a_foreign_array_is_read():
    file = entry("mine")
    file.write_bytes(entry("other").read_bytes())
    assert np.array_equal(again("mine"), -MADE)
    with file.open("wb") as opened:
        np.save(opened, np.full(6, np.nan))
    assert np.array_equal(array_cache.kept_one("kind", "mine", lambda: MADE), MADE)


def test_an_invalid_file_is_passed_over_at_once():
    file = entry("pipe")
    file.unlink()
    os.mkfifo(file)
    assert np.array_equal(again("pipe"), -MADE)
    assert np.array_equal(array_cache.kept_one("kind", "pipe", lambda: MADE), -MADE), "it is an entry again"
    file.unlink()
    file.mkdir()
    assert np.array_equal(again("pipe"), -MADE)


def test_what_has_to_be_made_is_told_before():
    told: list[str] = []
    with array_cache.telling(told.append):
        for _ in range(2):
            array_cache.kept_one("slow", "key", lambda: np.full(1, len(told)))
    assert told == ["slow"]
    assert array_cache.kept_one("slow", "key", lambda: MADE)[0] == 1
    entry("after")
    assert told == ["slow"]


@pytest.fixture(autouse=True)
def _own_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TACGEN_CODE_DIR", str(tmp_path / "code"))


def asked(code: bytes, name: str = "one", key: str = "key") -> tuple[bytes, bool]:
    """What is kept, and whether it was made."""
    made: list[bytes] = []

    def make() -> bytes:
        made.append(code)
        return code

    return compiled.kept(name, key, make), bool(made)


def test_code_is_kept_by_its_name_and_key_and_damaged_code_is_made_again() -> None:
    assert asked(b"a" * 50) == (b"a" * 50, True)
    assert asked(b"b") == (b"a" * 50, False)
    assert asked(b"b", key="another") == (b"b", True)
    assert asked(b"c", name="another") == (b"c", True)
    for entry in list(compiled.folder().glob("one-*.entry")):
        whole = entry.read_bytes()
        for damaged in (whole[:-1], whole[:9], b"", whole[:20] + bytes([whole[20] ^ 1]) + whole[21:]):
            entry.write_bytes(damaged)
    assert asked(b"d") == (b"d", True)
    assert asked(b"e") == (b"d", False), "and kept again"


def test_the_time_of_compiling_is_counted_and_said() -> None:
    told: list[str] = []
    before = compiled.seconds()
    with array_cache.telling(told.append):
        asked(b"a")
        between = compiled.seconds()
        asked(b"a")
    assert told == [compiled.COMPILED_ENTRY]
    assert compiled.seconds() == between > before


def test_without_a_folder_that_can_be_written_it_is_made_each_time(tmp_path: Path) -> None:
    (tmp_path / "code").write_text("no folder")
    assert asked(b"a") == asked(b"a") == (b"a", True)


def test_one_process_compiles_and_others_wait(tmp_path: Path) -> None:
    program = """
        import time
        from tacgen.base import compiled
        def make():
            print("in", flush=True)
            time.sleep(1.0)
            return b"theirs"
        compiled.kept("one", "key", make)
    """
    command = [sys.executable, "-c", textwrap.dedent(program)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"in\n"
        assert asked(b"mine") == (b"theirs", False)


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
def test_code_of_elements_is_kept_and_compiled_once(tmp_path: Path) -> None:
    """Warp keeps none of its own: code for another launch than ours would be compiled beside ours."""

    def ran() -> list[str]:
        known = {**os.environ, "TACGEN_CACHE_DIR": str(tmp_path / "cache")}
        done = subprocess.run([sys.executable, "-c", ELEMENTS], env=known, capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout.split()

    energy, made = ran()
    assert made == "True"
    assert ran() == [energy, "False"]
    assert not list((tmp_path / "cache").rglob("*.o"))
