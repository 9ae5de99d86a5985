"""Files of failing roads, and the choice of the failures that are listed."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from frenetic.analysis.clusters import distinct_failures, representative_failures
from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.campaign.counts import Counts
from frenetic.cli.failure_tables import print_failures
from frenetic.errors import CampaignError
from frenetic.oracle.outcome import Outcome
from frenetic.report.failures import road_document, write_failures
from frenetic.road.files import read_road
from frenetic.search import RandomSearch
from frenetic.testing import DummyDriver, DummySimulator


@pytest.fixture
def store(tmp_path: Path) -> Iterator[CampaignStore]:
    """A campaign in which the sharper half of the roads fails, and some are refused."""
    Campaign(
        strategy=RandomSearch(seed=2, max_redraws=0),
        simulator=DummySimulator(lambda road: 4.0 if abs(road.curvatures).max() > 0.06 else 0.5),
        driver=DummyDriver(),
        budget=Budget(simulations=40),
        folder=tmp_path / "c",
    ).run()
    with CampaignStore.open(tmp_path / "c") as opened:
        yield opened


def test_representative_failures_are_examples_of_causes_then_the_worst_of_each_cluster(
    store: CampaignStore,
) -> None:
    clusters = distinct_failures(store)
    failures = [record.id for record in store.tests(Outcome.FAIL)]
    assert sorted(i for cluster in clusters for i in cluster.ids) == failures
    representatives = representative_failures(store, 1000)
    examples = [cause.example for cause in clusters.causes]
    assert [record.id for record in representatives[: len(examples)]] == examples
    problems = [clusters.of(record.id) for record in representatives]
    assert sorted(problem.ids for problem in problems) == sorted(
        cluster.ids for cluster in clusters
    )
    after_examples = representatives[len(examples) :]
    assert [record.id for record in after_examples] == [
        problem.most_severe for problem in problems[len(examples) :]
    ]
    moobds = [record.moobd or 0.0 for record in after_examples]
    assert moobds == sorted(moobds)
    assert [record.id for record in representative_failures(store, 4)] == [
        record.id for record in representatives[:4]
    ]


def test_of_many_failures_the_most_severe_are_compared_and_listed(
    store: CampaignStore, capsys: pytest.CaptureFixture[str]
) -> None:
    severe = [record.id for record in store.tests(Outcome.FAIL, "moobd", limit=8)]
    clusters = distinct_failures(store, limit=8)
    assert sorted(i for cluster in clusters for i in cluster.ids) == sorted(severe)
    listed = len(clusters) - 1
    assert listed > 0
    print_failures(clusters, Counts(failed=30), listed, 4.0)
    title, heading, *rows = capsys.readouterr().out.splitlines()
    assert title == f"{len(clusters)} distinct failures, the {listed} most severe"
    assert heading.split()[:2] == ["test", "outside"]
    assert rows[0].split()[0] == str(severe[0])
    assert len(rows) == listed


def test_every_failure_gets_a_road_file_that_can_be_read(store: CampaignStore) -> None:
    failures = list(store.tests(Outcome.FAIL))
    assert 4 < len(failures) < 40
    write_failures(store, failures, [])
    files = sorted((store.folder / "failures").glob("*.json"))
    for path, record in zip(files, failures, strict=True):
        road = read_road(path).road()
        assert np.array_equal(road.curvatures, record.candidate.curvatures)
        assert road.pose == record.pose
        assert json.loads(path.read_text())["test_outcome"] == "FAIL"
    (refused,) = store.tests(Outcome.INVALID, limit=1)
    document = road_document(refused, store.config, None)
    assert document["is_valid"] is False
    assert document["validation_message"] == refused.reason


def test_listed_failures_share_a_picture_and_stale_files_are_replaced(
    store: CampaignStore,
) -> None:
    folder, listed = store.folder / "failures", representative_failures(store, 3)
    write_failures(store, listed, listed)
    assert [path.name for path in folder.glob("*.png")] == ["gallery.png"]
    first, second, third = sorted(folder.glob("test-*.json"))
    third.write_text("of another test")
    times = [path.stat().st_mtime_ns for path in (first, second)]
    write_failures(store, listed, listed)
    assert [path.stat().st_mtime_ns for path in (first, second)] == times
    assert read_road(third).road().length > 0.0


def test_a_folder_that_cannot_be_made_is_a_one_line_error(store: CampaignStore) -> None:
    (store.folder / "failures").write_text("in the way")
    with pytest.raises(CampaignError, match="all results are safe in"):
        write_failures(store, [], [])
