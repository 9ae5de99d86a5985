"""The table of all tests in the HTML report of a campaign."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

import frenetic
from frenetic.analysis.clusters import distinct_failures
from frenetic.analysis.explained import explained_causes
from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.drivers import Planner
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.minimised_roads import minimised_drives, minimised_tests
from frenetic.search import Frenetic
from frenetic.segments.causes import as_text, cause_of
from frenetic.simulators import EmbeddedSimulator

pytest_plugins = ["reported_campaign"]


def data_of(folder: Path) -> Any:
    """Return the data of a campaign's report."""
    text = (folder / "report.html").read_text(encoding="utf-8")
    match = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    assert match is not None
    return json.loads(match[1])


def test_failures_have_cause_certainty_number_and_minimised_length(tmp_path: Path) -> None:
    folder = tmp_path / "searched"
    campaign = Campaign(
        strategy=Frenetic(seed=1),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=60),
        folder=folder,
    )
    frenetic.run(campaign)
    table = data_of(folder)["tests"]
    with CampaignStore.open(folder) as store:
        tests = list(store.tests(with_trajectory=True))
        clusters = distinct_failures(store)
        certainties = {
            cause.group.clusters[0].cause.kind: str(cause.certainty)  # type: ignore[union-attr]
            for cause in explained_causes(store, clusters)
        }
        minimised = minimised_drives(store, minimised_tests(folder))
    assert table["id"] == [test.id for test in tests]
    numbers = {i: number for number, cluster in enumerate(clusters, 1) for i in cluster.ids}
    assert table["distinct"] == [numbers.get(test.id) for test in tests]
    lengths = {i: round(test.road.length) for i, test in minimised.items()}
    assert lengths
    assert table["minimised"] == [lengths.get(test.id) for test in tests]
    for row, test in enumerate(tests):
        told = table["cause"][row], table["certainty"][row]
        if test.outcome is not Outcome.FAIL:
            assert told == (None, None)
            continue
        assert test.segment is not None
        cause = cause_of(test.segment)
        assert told == (as_text(*cause), certainties.get(cause.kind))
    assert not [name for name in table if name.startswith("condition_")]


def test_drives_have_their_own_conditions(varied: Path) -> None:
    data = data_of(varied)
    with CampaignStore.open(varied) as store:
        conditions = {test.id: test.candidate.conditions for test in store.tests()}
    titles = {column["column"]: column["title"] for column in data["conditions"]}
    assert titles["condition_gust"] == "gust (m/s)"
    assert [name for name in data["tests"] if name.startswith("condition_")] == [*titles]
    for name in titles:
        amounts = [conditions[i].get(name.removeprefix("condition_")) for i in data["tests"]["id"]]
        assert data["tests"][name] == amounts


def test_a_table_without_failures_lacks_the_columns_about_failures(tmp_path: Path) -> None:
    campaign = Campaign(
        strategy=Frenetic(seed=1),
        simulator=EmbeddedSimulator(),
        driver=Planner(lateral_acceleration=2.0),
        budget=Budget(simulations=5),
        folder=tmp_path / "safe",
    )
    frenetic.run(campaign)
    names = ["id", "outcome", "moobd", "side", "criteria", "length", "duration"]
    assert [*data_of(tmp_path / "safe")["tests"]] == names


@pytest.fixture
def failing_beyond_the_map(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A campaign of which the feature map and the clusters hold one failure each."""
    from frenetic.report.html import reading

    folder = tmp_path / "many"
    campaign = Campaign(
        strategy=Frenetic(seed=1),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=60),
        folder=folder,
    )
    campaign.run()
    monkeypatch.setattr(reading, "COMPARED", 1)
    monkeypatch.setattr(reading, "choose_mapped", lambda _: set())
    return folder


def test_failures_that_are_not_compared_have_a_cause_and_no_number(
    failing_beyond_the_map: Path,
) -> None:
    frenetic.report.html.write_report(failing_beyond_the_map)
    table = data_of(failing_beyond_the_map)["tests"]
    failed = [outcome == "FAIL" for outcome in table["outcome"]]
    assert [cause is not None for cause in table["cause"]] == failed
    assert [number for number in table["distinct"] if number is not None] == [1]
