"""The pytest plug-in: it registers the marks of drivers' tests, and shows the tests' notices."""

from __future__ import annotations

import sys
from collections.abc import Generator
from typing import Final

import pytest

_PROPERTY: Final = "frenetic"
"""Name of the property that holds a test's notices, in its report and in JUnit files."""


_MARKS: Final = {
    "keeps_lane": "a driver's test that searches for failing roads, by Frenetic",
    "steers_well": "a driver's test that drives random roads within limits, by Frenetic",
}
"""Mark of drivers' tests -> description."""


def pytest_configure(config: pytest.Config) -> None:
    """Register the marks of drivers' tests."""
    for mark, description in _MARKS.items():
        config.addinivalue_line("markers", f"{mark}: {description}")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """Move a test's notices to its report, which reaches the main process from any worker."""
    try:
        return (yield)
    finally:
        # Looked up, not imported: most sessions have no such test.
        if lane_test := sys.modules.get("frenetic.testing.lane_test"):
            item.user_properties += [(_PROPERTY, text) for text in lane_test.NOTICES]
            lane_test.NOTICES.clear()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Show the errors of `lane_test.SHOWN` as a message, without a traceback."""
    report = yield
    lane_test = sys.modules.get("frenetic.testing.lane_test")
    is_ours = any(item.get_closest_marker(mark) for mark in _MARKS)
    if lane_test and call.when == "call" and is_ours and call.excinfo:
        error = call.excinfo.value
        if isinstance(error, lane_test.SHOWN):
            report.longrepr = str(error)
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Show the notices of all tests, each once."""
    reports = [report for reports in terminalreporter.stats.values() for report in reports]
    properties = [
        user_property
        for report in reports
        for user_property in getattr(report, "user_properties", ())
    ]
    texts = dict.fromkeys(str(text) for name, text in properties if name == _PROPERTY)
    if texts:
        terminalreporter.section(_PROPERTY)
        for text in texts:
            terminalreporter.write_line(text)
