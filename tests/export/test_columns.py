"""The tables' columns are documented, and have the campaign's own names."""

from __future__ import annotations

import re
from pathlib import Path

from frenetic.campaign.record import FINISHED
from frenetic.export import TABLES
from frenetic.simulators import Trajectory

PAGE = Path(__file__).parents[2] / "docs" / "files.md"


def test_the_page_names_every_column_and_no_other() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for table, columns in TABLES.items():
        section = text[text.index(f"**{table}**, one row per") :]
        rows = re.findall(r"^\| (`.*?) \|", section.split("\n\n")[1], re.MULTILINE)
        named = {name for row in rows for name in re.findall(r"`(\w+)`", row)}
        assert named == {column.name for column in columns}


def test_columns_are_called_what_they_are_called_elsewhere() -> None:
    names = {table: [column.name for column in columns] for table, columns in TABLES.items()}
    assert names["trajectories"] == ["id", *Trajectory.names()]
    left_out = {"points", "told_share", "conditions"}  # these have a column each
    assert {column.name for column in FINISHED} - set(names["tests"]) == left_out
