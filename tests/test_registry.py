"""Names that other packages add."""

from __future__ import annotations

import importlib.metadata
import os
from pathlib import Path

import pytest

from frenetic.errors import FreneticError
from frenetic.registry import DRIVERS, STRATEGIES, Entry


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of installed packages, still empty, which has not changed for long."""
    folder = tmp_path / "site"
    folder.mkdir()
    os.utime(folder, (0, 0))
    monkeypatch.syspath_prepend(str(folder))
    return folder


def install(site: Path, name: str, entries: str) -> None:
    """Installs a package with these entry points."""
    info = site / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(entries)


def test_a_package_that_is_installed_meanwhile_is_found(site: Path) -> None:
    names = [entry.name for entry in DRIVERS.entries()]
    assert "careful" not in names
    install(site, "careful-drivers", "[frenetic.drivers]\ncareful = careful:Driver\n")
    assert DRIVERS.entries()[-1] == Entry("careful", "careful:Driver", "careful-drivers")
    assert [entry.name for entry in DRIVERS.entries()[:-1]] == names
    assert "careful" not in [entry.name for entry in STRATEGIES.entries()]


def test_a_name_that_is_taken_is_refused_with_who_claims_it(site: Path) -> None:
    install(site, "other-drivers", "[frenetic.drivers]\nplanner = other:Driver\n")
    with pytest.raises(FreneticError, match=r"'planner': one is built in.* from other-drivers;"):
        DRIVERS.load("stanley")


def test_what_is_installed_is_read_once(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    del site  # new, so that nothing was read for it
    DRIVERS.load("stanley")
    monkeypatch.setattr(importlib.metadata, "entry_points", None)
    DRIVERS.load("planner")
