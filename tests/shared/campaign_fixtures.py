"""Shared fixtures: a finished campaign, a breaking database, a folder for marks of processes."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from campaigns import campaign
from faulty import Marks
from pids import ending
from small_disk import Breaking


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a finished campaign of simple parts; no test changes it."""
    folder = tmp_path_factory.mktemp("finished") / "c"
    campaign(folder).run()
    return folder


@pytest.fixture
def breaking(monkeypatch: pytest.MonkeyPatch) -> type[Breaking]:
    """The class of all databases that are opened from now on; a test sets when they break."""
    kind = type("Breaking", (Breaking,), {})
    monkeypatch.setattr(sqlite3, "connect", partial(sqlite3.connect, factory=kind))
    return kind


@pytest.fixture
def marks(tmp_path: Path) -> Iterator[Marks]:
    """An empty folder for marks; after the test, the processes that left marks are ended."""
    folder = tmp_path / "marks"
    folder.mkdir()
    marks = Marks(folder)
    this_process = os.getpid()
    with ending(lambda: set(marks.pids()) - {this_process}):
        yield marks
