"""Fixtures of several files: a finished campaign, and a folder for the marks of processes."""

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
    """The folder of a finished campaign of the usual parts; nobody changes it."""
    folder = tmp_path_factory.mktemp("finished") / "c"
    campaign(folder).run()
    return folder


@pytest.fixture
def breaking(monkeypatch: pytest.MonkeyPatch) -> type[Breaking]:
    """The kind of all databases that are opened from now on."""
    kind = type("Breaking", (Breaking,), {})
    monkeypatch.setattr(sqlite3, "connect", partial(sqlite3.connect, factory=kind))
    return kind


@pytest.fixture
def marks(tmp_path: Path) -> Iterator[Marks]:
    """An empty folder for marks; the processes that left theirs there are ended."""
    folder = tmp_path / "marks"
    folder.mkdir()
    marks = Marks(folder)
    ours = os.getpid()
    with ending(lambda: set(marks.pids()) - {ours}):
        yield marks
