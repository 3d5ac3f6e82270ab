"""Processor seconds of tests, with those of the processes that they start: the slowest ten, and the whole suite's.

A process counts once it has ended: workers that tests of a module share, for the last of these tests.
"""

import os
from collections import Counter
from collections.abc import Generator

import pytest

SLOWEST = 10  # tests told at the end
_spent: Counter[str] = Counter()  # [s], by test
_before = 0.0


def _now() -> float:
    """Processor seconds of this process and of those that it started and that ended [s]."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol() -> Generator[None, object, object]:
    """The clock starts before a test's fixtures are made."""
    global _before
    _before = _now()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """A report of a phase, set up to torn down, carries its processor seconds, also from one process to another."""
    global _before
    report = yield
    before, _before = _before, _now()
    report.processor_s = _before - before  # type: ignore[attr-defined]
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    _spent[report.nodeid] += getattr(report, "processor_s", 0.0)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if sum(_spent.values()) > 60:
        terminalreporter.section(f"processor seconds: {_now():.0f} in all")
        for name, seconds in _spent.most_common(SLOWEST):
            terminalreporter.write_line(f"{seconds:6.1f}  {name}")
