"""The folder in which the processes of a test leave marks."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from faulty import Marks
from pids import ending


@pytest.fixture
def marks(tmp_path: Path) -> Iterator[Marks]:
    """An empty folder for marks; the processes that left theirs there are ended."""
    folder = tmp_path / "marks"
    folder.mkdir()
    marks = Marks(folder)
    ours = os.getpid()
    with ending(lambda: set(marks.pids()) - {ours}):
        yield marks
