"""A repeated road counts once: repeats do not change the measures of a campaign."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sample_campaigns import search

from frenetic._support.arrays import FloatArray
from frenetic.analysis import features_of, segments_of
from frenetic.analysis.campaign_measures import measure_campaign
from frenetic.analysis.caution import caution
from frenetic.analysis.clusters import (
    Clusters,
    distinct_failures,
    nearest_misses,
    representative_failures,
)
from frenetic.analysis.criteria import criteria_text
from frenetic.analysis.measures import MEASURES
from frenetic.campaign import CampaignStore
from frenetic.campaign.counts import Counts, FirstTests
from frenetic.criteria.criterion import criteria_sets
from frenetic.drivers import Planner
from frenetic.oracle.drive import Rules
from frenetic.oracle.outcome import Outcome
from frenetic.report.html.campaign import campaign_report
from frenetic.report.html.reading import Reading
from frenetic.report.html.timeline import timeline_of
from frenetic.rerun.rerun import rerun
from frenetic.search import Candidate, Evaluation, Frenetic, Origin, Strategy
from frenetic.search.strategy import Ledger
from frenetic.simulators import EmbeddedSimulator

SIMULATIONS = 70
OVER_DRIVES = ("mean_failures", "mean_distinct_failures", "strategy_seconds", "failing_repeats")
"""Measures that repeats change."""


class Listed(Strategy):
    """Proposes the roads of a list."""

    def __init__(self, roads: Sequence[FloatArray]) -> None:
        self.roads, self.ledger = iter(roads), Ledger()

    def ask(self) -> Candidate:
        return self.ledger.issue(next(self.roads), 10.0, Origin("random"))

    def tell(self, evaluation: Evaluation) -> None:
        self.ledger.settle(evaluation)


def drive(folder: Path, roads: Sequence[FloatArray]) -> Path:
    return search(folder, Listed(roads), len(roads))


@pytest.fixture(scope="module")
def roads(tmp_path_factory: pytest.TempPathFactory) -> list[FloatArray]:
    """Different roads of a search, of which many fail."""
    folder = search(tmp_path_factory.mktemp("searched") / "c", Frenetic(seed=4), SIMULATIONS)
    with CampaignStore.open(folder) as store:
        return [test.candidate.curvatures for test in store.tests()]


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory, roads: list[FloatArray]) -> Path:
    return drive(tmp_path_factory.mktemp("plain") / "c", roads)


@pytest.fixture(scope="module")
def repeated(tmp_path_factory: pytest.TempPathFactory, roads: list[FloatArray]) -> Path:
    """A campaign of the roads, then every second of them again, then every tenth."""
    repeated_roads = [*roads, *roads[::2], *roads[::10]]
    return drive(tmp_path_factory.mktemp("repeated") / "c", repeated_roads)


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory, roads: list[FloatArray]) -> Path:
    """A campaign of the roads, with an earlier road behind every third."""
    mixed_roads = [
        road
        for i, now in enumerate(roads)
        for road in ((now, roads[i // 2]) if i % 3 == 0 else (now,))
    ]
    return drive(tmp_path_factory.mktemp("mixed") / "c", mixed_roads)


def sizes(clusters: Clusters) -> list[tuple[Any, ...]]:
    """Return the attributes of distinct failures, without the ids of their tests."""
    return [
        (
            len(cluster),
            cluster.moobd,
            cluster.side,
            cluster.spread,
            cluster.description,
            cluster.cause,
        )
        for cluster in clusters
    ]


@pytest.mark.heavy
def test_repeats_do_not_change_the_measures_of_a_campaign(
    plain: Path, repeated: Path, mixed: Path
) -> None:
    expected = measure_campaign(plain)
    assert expected.failures > 20
    assert expected.distinct_failures > 10
    for folder in (repeated, mixed):
        measured = measure_campaign(folder)
        assert measured.simulations > SIMULATIONS
        assert measured.counts.failed > measured.failures
        assert MEASURES["failing_repeats"].of(measured) == measured.counts.failing_repeats > 0
        for name, measure in MEASURES.items():
            is_over_drives = name.endswith("_to_failure") and folder is mixed
            if not (is_over_drives or name in OVER_DRIVES):  # a repeat is a drive
                assert measure.of(measured) == measure.of(expected), name


def test_repeats_do_not_change_distinct_failures_causes_and_near_misses(
    plain: Path, repeated: Path, mixed: Path
) -> None:
    with CampaignStore.open(plain) as store:
        clusters, misses = distinct_failures(store), nearest_misses(store)
        examples = [test.id for test in representative_failures(store)]
    causes = [(cause.words, cause.failures, len(cause.clusters)) for cause in clusters.causes]
    for folder in (repeated, mixed):
        with CampaignStore.open(folder) as store:
            distinct = distinct_failures(store)
            assert sizes(distinct) == sizes(clusters)
            assert sizes(nearest_misses(store)) == sizes(misses)
            assert causes == [
                (cause.words, cause.failures, len(cause.clusters)) for cause in distinct.causes
            ]
            if folder is repeated:
                assert distinct == clusters
                assert [test.id for test in representative_failures(store)] == examples


def test_repeats_do_not_change_cautions_and_feature_maps(
    plain: Path, repeated: Path, mixed: Path
) -> None:
    def words(folder: Path) -> tuple[Any, ...]:
        with CampaignStore.open(folder) as store:
            segments = segments_of(store, Outcome.FAIL, with_repeats=False)
            features = [features_of(segment) for _, segment in segments]
            return caution(store), features

    assert words(plain) == words(repeated) == words(mixed)


def test_repeats_do_not_change_the_driven_time_of_criteria(
    tmp_path: Path, roads: list[FloatArray]
) -> None:
    simulator = EmbeddedSimulator(rules=Rules(criteria=criteria_sets()["after-un-r157"]))
    texts = []
    for name, driven in (("plain", roads[:2]), ("repeated", roads[:2] * 20)):
        slow = Planner(lateral_acceleration=2.0)
        folder = search(
            tmp_path / name, Listed(driven), len(driven), simulator=simulator, driver=slow
        )
        with CampaignStore.open(folder) as store:
            texts.append((criteria_text(store), caution(store)))
    assert "asks for 300 s" in texts[0][1]
    assert texts[0] == texts[1]


def test_repeats_do_not_change_the_report(plain: Path, repeated: Path) -> None:
    readings, sections, titles = [], [], []
    for folder in (plain, repeated):
        with CampaignStore.open(folder) as store:
            reading = Reading.of(store)
            report = campaign_report(store, reading=reading)
        readings.append(reading)
        sections.append({section.id: section for section in report.sections})
        titles.append(report.title.partition(" in ")[0])
    first, second = readings
    assert first.mapped.keys() == second.mapped.keys()
    assert [test.id for test in first.failures] == [test.id for test in second.failures]
    assert first.counts.failures == second.counts.failures
    assert titles[0] == titles[1]
    for name in ("failures", "map"):
        assert sections[0][name].lead == sections[1][name].lead
        assert sections[0][name].blocks == sections[1][name].blocks
    curves = [timeline_of(reading.tests, reading.clusters) for reading in readings]
    assert curves[0] is not None
    assert curves[1] is not None
    for line, repeated_line in zip(curves[0].series[:2], curves[1].series[:2], strict=True):
        assert line.y[-1] == repeated_line.y[-1]
        assert repeated_line.x[-1] > line.x[-1]  # repeats count as simulations
    assert "random roads that were driven failed" in curves[0].caption
    assert curves[0].caption == curves[1].caption


def test_a_rerun_drives_each_failing_road_once(plain: Path, repeated: Path) -> None:
    driven = [
        [test.id for test in rerun(folder, EmbeddedSimulator(), Planner()).tests]
        for folder in (plain, repeated)
    ]
    assert driven[0] == driven[1]


def test_counts_of_tests_name_the_repeats(
    plain: Path, repeated: Path, roads: list[FloatArray]
) -> None:
    with CampaignStore.open(plain) as store:
        assert (store.repeats(), store.counts().repeats) == (frozenset(), 0)
        assert "repeat" not in store.counts().as_text()
        failed = {test.id for test in store.tests(Outcome.FAIL)}
    repeated_ids = [*range(1, len(roads) + 1, 2), *range(1, len(roads) + 1, 10)]
    failing = sum(number in failed for number in repeated_ids)
    with CampaignStore.open(repeated) as store:
        counts, first = store.counts(), len(roads) + 1
        assert store.repeats() == set(range(first, first + len(repeated_ids)))
        assert [test.id for test in store.tests(with_repeats=False)] == [*range(1, first)]
        assert [t.id for t in store.tests(limit=3, with_repeats=False)] == [1, 2, 3]
        added = Counts()
        for test in store.tests():
            added.add(test.candidate, test.result)
    assert added == counts
    assert (counts.repeats, counts.failing_repeats) == (len(repeated_ids), failing)
    assert counts.failures == len(failed)
    assert f"{counts.failed} failed ({failing} repeats)" in counts.as_text()


def candidate(**other: Any) -> Candidate:
    return Candidate(1, np.array([0.0, 0.01, 0.0]), 10.0, Origin("random"), **other)


def test_a_repeat_has_the_road_the_conditions_and_the_outcome_of_an_earlier_test() -> None:
    first, flat = FirstTests(), np.array([[0.0, 0.0]])
    assert first.add(candidate(), Outcome.PASS)
    assert not first.add(candidate(), Outcome.PASS)
    assert not first.add(candidate(repeat=1), Outcome.PASS)
    # Where drives do not repeat, no failure is hidden.
    assert first.add(candidate(), Outcome.FAIL)
    assert first.add(candidate(conditions={"friction": 0.5, "noise": 0.1}), Outcome.PASS)
    assert not first.add(candidate(conditions={"noise": 0.1, "friction": 0.5}), Outcome.PASS)
    assert first.add(candidate(grade=flat), Outcome.PASS)
    assert first.add(candidate(superelevation=flat), Outcome.PASS)
    mirrored = Candidate(9, -candidate().curvatures, 10.0, Origin("F4"))
    assert first.add(mirrored, Outcome.PASS)
    straight = Candidate(1, np.zeros(3), 10.0, Origin("random"))
    assert first.add(straight, Outcome.PASS)
    assert not first.add(Candidate(2, -np.zeros(3), 10.0, Origin("F4")), Outcome.PASS)
    assert first.add(Candidate(2, np.zeros(3), 5.0, Origin("random")), Outcome.PASS)
    assert [first.add(candidate(), Outcome.DROPPED) for _ in range(2)] == [True, True]
