"""Fixtures that many test modules share."""

import gc
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.kept_workers import KeptWorkers

from tacgen.base.array_cache import cache_folder

pytest_plugins = ["helpers.processor_time"]
gc.set_threshold(100_000)  # by the usual 700, a twentieth of the tests' time goes into searching for garbage
# tests with caches of their own share the compiled code, and so do the processes that they start
os.environ.setdefault("TACGEN_CODE_DIR", str(cache_folder() / "code"))


@pytest.fixture(scope="session")
def _cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of all processes of this run of pytest."""
    base = tmp_path_factory.getbasetemp()
    return (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "cache"


@pytest.fixture(scope="module")
def own_cache(_cache: Path) -> Iterator[None]:
    """A cache that was empty when the tests began, so that none depends on what was kept before."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TACGEN_CACHE_DIR", str(_cache))
        yield


@pytest.fixture(scope="session")
def _workers() -> Iterator[KeptWorkers]:
    workers = KeptWorkers()
    yield workers
    workers.stop()


@pytest.fixture
def kept_workers(_workers: KeptWorkers, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs get the worker processes of earlier runs of this session: for tests that are not about these."""
    _workers.keep(monkeypatch)
