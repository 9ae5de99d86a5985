"""Campaigns with reports, shared by the tests of the HTML report."""

from __future__ import annotations

from pathlib import Path

import pytest
from html_campaigns import make_searched, make_sloping, make_swept, make_varied

from frenetic.report.html import write_report


@pytest.fixture(scope="session")
def searched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign with its report; no test changes it."""
    folder = make_searched(tmp_path_factory.mktemp("html") / "searched")
    write_report(folder)
    return folder


@pytest.fixture(scope="session")
def sloping(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign on roads of a class, with its report; no test changes it."""
    folder = make_sloping(tmp_path_factory.mktemp("html") / "sloping")
    write_report(folder)
    return folder


@pytest.fixture(scope="session")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep over radius and speed limit, with its report; no test changes it."""
    folder = make_swept(tmp_path_factory.mktemp("html") / "swept")
    write_report(folder)
    return folder


@pytest.fixture(scope="session")
def varied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign in a domain, with its report; no test changes it."""
    folder = make_varied(tmp_path_factory.mktemp("html") / "varied")
    write_report(folder)
    return folder
