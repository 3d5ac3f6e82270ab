"""The cache gives what was made, or makes it again: never what a damaged or exchanged file holds. It never waits."""

import os
from pathlib import Path

import numpy as np
import pytest

from tacgen.base import array_cache

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
