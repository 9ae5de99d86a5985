"""The pytest plug-in: it knows the mark ``keeps_lane``, and shows what its tests have to say."""

from __future__ import annotations

import sys
from collections.abc import Generator
from typing import Final

import pytest

_NAME: Final = "frenetic"
"""Name of the property of a test's report, also in JUnit files."""


def pytest_configure(config: pytest.Config) -> None:
    """Register the mark."""
    config.addinivalue_line(
        "markers", "keeps_lane: a driver's test that searches for failing roads, by Frenetic"
    )


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """Move a test's notices to its report, which reaches the main process from any worker."""
    try:
        return (yield)
    finally:
        # Imported only by those who use it.
        if lane_test := sys.modules.get("frenetic.testing.lane_test"):
            item.user_properties += [(_NAME, text) for text in lane_test.NOTICES]
            lane_test.NOTICES.clear()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Show only the message of a failure that Frenetic raised, without Python's traceback."""
    report = yield
    lane_test = sys.modules.get("frenetic.testing.lane_test")
    if lane_test and call.when == "call" and item.get_closest_marker("keeps_lane") and call.excinfo:
        error = call.excinfo.value
        if isinstance(error, lane_test.SHOWN):
            report.longrepr = str(error)
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Show the notices."""
    reports = [report for reports in terminalreporter.stats.values() for report in reports]
    properties = [
        user_property
        for report in reports
        for user_property in getattr(report, "user_properties", ())
    ]
    texts = dict.fromkeys(str(text) for name, text in properties if name == _NAME)
    if texts:
        terminalreporter.section(_NAME)
        for text in texts:
            terminalreporter.write_line(text)
