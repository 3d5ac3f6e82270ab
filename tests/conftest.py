"""Fixtures that many test modules share."""

import gc
import os
from collections.abc import Iterator

import pytest
from helpers.kept_workers import KeptWorkers

from tacgen.array_cache import cache_folder

pytest_plugins = ["helpers.processor_time"]
gc.set_threshold(100_000)  # by the usual 700, a twentieth of the tests' time goes into searching for garbage
# tests with caches of their own share the compiled code, and so do the processes that they start
os.environ.setdefault("NUMBA_CACHE_DIR", str(cache_folder() / "compiled"))


@pytest.fixture(scope="module")
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A cache that starts empty and is this module's alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TACGEN_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def _workers() -> Iterator[KeptWorkers]:
    workers = KeptWorkers()
    yield workers
    workers.stop()


@pytest.fixture
def kept_workers(_workers: KeptWorkers, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs get the worker processes of earlier runs in this module: for tests that are not about these."""
    _workers.keep(monkeypatch)
