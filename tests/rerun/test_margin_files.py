"""Margins in files: what is read is what was written, and which studies a report shows."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from made_up_margins import DELAY, limits, margins

from frenetic import EmbeddedSimulator, Planner
from frenetic.campaign import Budget, Campaign, RoadTester
from frenetic.errors import CampaignError
from frenetic.rerun.margin import measure_margins
from frenetic.rerun.margin_files import FILE, campaign_margins, read_margins, write_margins
from frenetic.rerun.margin_quantities import measured_quantities
from frenetic.rerun.margin_results import ConditionMargin
from frenetic.search import RandomSearch


def test_margins_are_read_as_they_were_written(tmp_path: Path) -> None:
    """Also infinite usual amounts, roads that fail as usual, and roads that never fail."""
    written = margins(tmp_path)
    write_margins(written)
    read = read_margins(tmp_path)
    assert read == written
    assert read is not None
    assert read.as_json() == written.as_json()
    moved = tmp_path / "moved"
    moved.mkdir()
    (tmp_path / FILE).rename(moved / FILE)
    assert read_margins(moved) == replace(written, folder=moved)
    assert read_margins(tmp_path) is None


def test_margins_that_are_there_are_not_written_again(tmp_path: Path) -> None:
    write_margins(margins(tmp_path))
    (tmp_path / FILE).chmod(0o444)
    before = (tmp_path / FILE).stat().st_mtime_ns
    write_margins(margins(tmp_path))
    assert (tmp_path / FILE).stat().st_mtime_ns == before
    write_margins(replace(margins(tmp_path), drives=10))
    read = read_margins(tmp_path)
    assert read is not None
    assert read.drives == 10


def without_roads(document: dict[str, Any]) -> None:
    document["margins"][0]["roads"] = []


def without_margins(document: dict[str, Any]) -> None:
    document["margins"] = []


def unknown(document: dict[str, Any]) -> None:
    document["margins"][0]["condition"] = "moonlight"


def without_drives(document: dict[str, Any]) -> None:
    del document["drives"]


@pytest.mark.parametrize(
    ("damage", "problem"),
    [
        (without_roads, "more delay has no road"),
        (without_margins, "it has no margin"),
        (unknown, "moonlight"),
        (without_drives, "drives"),
    ],
)
def test_a_damaged_file_is_refused_and_replaced(
    tmp_path: Path, damage: Callable[[dict[str, Any]], None], problem: str
) -> None:
    document = margins().as_json()
    damage(document)
    (tmp_path / FILE).write_text(json.dumps(document))
    with pytest.raises(CampaignError, match=rf"is damaged: .*{problem}.*; remove it, or run fren"):
        read_margins(tmp_path)
    write_margins(margins(tmp_path))
    assert read_margins(tmp_path) == margins(tmp_path)


def test_a_campaign_keeps_what_its_studies_measured(tmp_path: Path) -> None:
    """Of the same quantities the study on most roads counts, of equally many the latest."""
    folder = tmp_path / "c"
    Campaign(
        strategy=RandomSearch(seed=1),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=2),
        folder=folder,
    ).run()
    assert campaign_margins(folder) == ()
    tester = RoadTester(EmbeddedSimulator(), Planner())
    delay, load = (measured_quantities(tester, {name: None}) for name in ("delay", "load"))
    first, larger, other, smaller = (
        measure_margins(tester, quantities, roads=roads, seed=seed, campaign=folder)
        for quantities, roads, seed in ((delay, 2, 0), (delay, 3, 1), (load, 1, 0), (delay, 2, 2))
    )
    assert campaign_margins(folder) == (larger, other)
    assert campaign_margins(first.folder) == (first,)
    (smaller.folder / FILE).write_text("{}")
    with pytest.raises(CampaignError, match="is damaged"):
        campaign_margins(folder)


def test_a_folder_of_drives_shows_its_own_margins(tmp_path: Path) -> None:
    shorter = replace(margins(tmp_path), margins=(ConditionMargin(DELAY, limits(DELAY, 0.3)),))
    write_margins(shorter)
    assert campaign_margins(tmp_path) == (shorter,)
