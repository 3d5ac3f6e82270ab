"""Fixtures that many test modules share."""

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="module")
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A cache that starts empty and is this module's alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TACGEN_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        yield
