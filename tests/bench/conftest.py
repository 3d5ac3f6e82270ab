"""The machine is measured once for all pages of results."""

from collections.abc import Iterator
from functools import cache

import pytest

from benchmarks import results_page


@pytest.fixture(scope="session", autouse=True)
def measured_once() -> Iterator[None]:
    """Each page would start two processes that measure its speed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(results_page, "made", cache(results_page.made))
        yield
